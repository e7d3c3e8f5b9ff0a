"""What every solver's settings come to on the scene ``elliptic``, and how far off motion without inertia is.

``python tests/benchmarks/plant/solvers_compared.py`` prints its method; heyoka's rows need the extra ``accuracy``.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from deploy.runs.field_simulation import field_speeds
from deploy.scenes.files import load_scene
from plant.plant import Plant
from plant.specs import PlantSpec

SECOND = 1_000_000_000
ROWS: tuple[dict[str, Any], ...] = (
    *({"name": "exact", "tolerance": t} for t in (1e-6, 1e-9, 1e-12)),
    *({"name": "implicit", "tolerance": t} for t in (1e-5, 1e-7, 1e-9)),
    *({"name": "implicit", "step_s": h} for h in (4e-3, 1e-3, 2.5e-4)),
    *({"name": "fixed_step", "method": m, "step_s": h} for m in ("euler", "rk4") for h in (4e-3, 1e-3, 2.5e-4)),
    *({"name": "scipy", "method": m, "tolerance": t} for m in ("RK45", "DOP853", "LSODA") for t in (1e-6, 1e-9, 1e-12)),
    *({"name": "scipy", "method": "Radau", "tolerance": t} for t in (1e-6, 1e-9)),
    *({"name": "heyoka", "tolerance": t} for t in (1e-6, 1e-9, 1e-12)),
)  # fmt: skip

METHOD = """\
The scene elliptic, 2 s, in one call. Off: largest entry of the difference of the states at the end from exact at 1e-14
(m, rad, m/s, rad/s). Changes of supports: {changes} by exact. Time: median of {runs} runs, processor time, without
building and compiling.
"""
SLOW = """
Without inertia: the field of elliptic slowed down, the same way through it (half a second of the field as it is), from
rest. Off: largest entry of the difference of the poses at the end, quasi_static at 1e-8 from exact at 1e-9.
"""


def run(
    spec: PlantSpec, solver: dict[str, Any], speeds: NDArray[np.float64], span_s: float
) -> tuple[Plant, float]:
    """A plant of the scene under a solver, ``span_s`` later, and what that took, s."""
    plant = Plant(PlantSpec.model_validate(dict(spec) | {"solver": solver}))
    begun = time.process_time()
    plant.advance(speeds, round(span_s * SECOND))
    return plant, time.process_time() - begun


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=5, help="for each time")
    runs: int = parser.parse_args().runs
    scene = load_scene("elliptic")
    spec = scene.plant_spec()
    speeds = field_speeds(scene, Plant(spec).array.positions_m)
    known, _ = run(spec, {"name": "exact", "tolerance": 1e-14}, speeds, 2.0)
    print(METHOD.format(changes=known.support_changes, runs=runs))
    print(f"{'':40}{'off':>10}{'changes':>9}{'time':>12}")
    for settings in ROWS:
        if settings["name"] == "heyoka" and find_spec("heyoka") is None:
            continue
        run(spec, settings, speeds, 0.01)
        plants, spent = zip(*(run(spec, settings, speeds, 2.0) for _ in range(runs)), strict=True)
        title = " ".join(str(value) for value in settings.values())
        off = float(np.abs(plants[0].state - known.state).max())
        print(f"{title:40}{off:10.1e}{plants[0].support_changes:9}{statistics.median(spent) * 1e3:9.2f} ms")
    print(SLOW)
    print(f"{'times as fast':>14}{'off':>10}")
    for slow in (0.4, 0.2, 0.1, 0.05, 0.025):
        ends = [
            run(spec, solver, slow * speeds, 0.5 / slow)[0].state[0, :3]
            for solver in ({"name": "exact"}, {"name": "quasi_static", "tolerance": 1e-8})
        ]
        print(f"{slow:14}{np.abs(ends[1] - ends[0]).max():10.1e}")


if __name__ == "__main__":
    main()
