"""Memory of processes of one cell each, and how long it takes until all are ready.

``python tests/benchmarks/deploy/cell_memory.py`` starts ``heat`` with a process per cell and prints both.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))
# the server that forks the workers knows no other way to find their modules
os.environ["PYTHONPATH"] = os.pathsep.join(sys.path)

from process_memory import descendants, megabytes

from deploy.runs.backends import Workers
from deploy.runs.simulation import Simulation
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override

METHOD = """\
Method. The scene {scene} with {cells} cells, a process for each. Ready: until the first tick is over,
kernels loaded from disk. Processor time until then: of this process from its start, of the fork server, and of all
processes of cells. Then {ticks} ticks. PSS: of each process of cells (/proc/PID/smaps_rollup), shared pages divided by
those that share them. Private: pages that it wrote to."""

HEAVY = ("scipy/linalg", "matplotlib", "PIL", "mcap", "lz4")
"""Libraries that no process of cells needs, looked for among its mapped files: those of Python alone are missed."""


def _processor_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="heat")
    parser.add_argument("--rows", type=int, help="default: 13 of heat, the scene's own of others")
    parser.add_argument("--columns", type=int, help="default: 20 of heat, the scene's own of others")
    parser.add_argument("--ticks", type=int, default=20)
    given = parser.parse_args()
    if given.scene == "heat":
        given.rows, given.columns = given.rows or 13, given.columns or 20
    sizes = [
        Override(("array", name), value, f"--{name}")
        for name in ("rows", "columns")
        if (value := getattr(given, name)) is not None
    ]
    scene = load_scene(given.scene, [*sizes, Override(("duration_s",), 1e4, "--duration")])
    print(METHOD.format(scene=given.scene, cells=len(scene.lattice()), ticks=given.ticks))
    begun = time.perf_counter()
    with Simulation.open(scene, Workers("each")) as simulation:
        simulation.step()
        ready = time.perf_counter() - begun
        server, *cells = descendants(os.getpid())
        processor = [_processor_s(os.getpid()), _processor_s(server), sum(map(_processor_s, cells))]
        for _ in range(given.ticks):
            simulation.step()
        pss = sorted(megabytes(pid, "Pss") for pid in cells)
        private = statistics.median(megabytes(pid, "Private_Dirty") for pid in cells)
        mapped = Path(f"/proc/{cells[-1]}/maps").read_text()
    print(f"ready after {ready:.1f} s, load {os.getloadavg()[0]:.1f} by then")
    print("processor time: {:.1f} s here, {:.1f} s fork server, {:.1f} s cells".format(*processor))
    print(f"PSS of {len(cells)} processes: median {statistics.median(pss):.1f} MB, largest {pss[-1]:.1f} MB")
    print(f"private: median {private:.1f} MB")
    heavy = [name for name in HEAVY if f"/{name}/" in mapped]
    print(f"mapped libraries that cells don't need: {', '.join(heavy) or 'none'}")


if __name__ == "__main__":
    main()
