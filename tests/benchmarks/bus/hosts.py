"""What namespaces cost a run: ticks a second over three hosts with a router, and with the same processes on one.

    python tests/benchmarks/bus/hosts.py [--side 16] [--duration 8] [--turns 3]

The router and the first half of the cells are on host a, the plant on host b, the other half on host c, in the wire
format packed. The namespaces need the superuser. The figures are of the runs alone, without their start.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

import pytest

from bus.transports.zenoh.endpoint import free_port
from tests.system.hosts import ROOT, Hosts
from tests.system.joining import command

Start = Callable[[str, list[str]], "subprocess.Popen[str]"]
"""Starts a command on a host."""
MDMS = [sys.executable, "-m", "deploy.cli"]


def rate(start: Start, address: str, scene: Path, folder: Path) -> float:
    """Ticks a second of one run."""
    router = f"tcp/{address}:{free_port()}"
    options = ["--shards", "2", "--connect", router, "--run", "hosts", "--no-picture", "--json"]
    running = start("a", [*MDMS, "router", "--listen", router, "--insecure"])
    cells = [start(host, command(scene, router, 2, "hosts", [i])) for i, host in enumerate("ac")]
    plant = start("b", [*MDMS, "plant", str(scene), *options, "--output", str(folder)])
    try:
        stdout, stderr = plant.communicate(timeout=300.0)
        if plant.returncode != 0:
            raise SystemExit(stderr)
        return float(json.loads(stdout)["ticks_per_s"])
    finally:
        running.terminate()
        for process in (running, *cells):
            process.communicate()


def here(host: str, words: list[str]) -> subprocess.Popen[str]:
    """Start a command on this host."""
    del host
    return subprocess.Popen(
        words,
        cwd=ROOT,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--side", type=int, default=16, help="rows and columns")
    parser.add_argument("--duration", type=float, default=8.0, help="simulated seconds")
    parser.add_argument("--turns", type=int, default=3)
    asked = parser.parse_args()
    apart: list[float] = []
    together: list[float] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scene = folder / "scene.toml"
        scene.write_text(
            f"duration_s = {asked.duration}\n[array]\nrows = {asked.side}\ncolumns = {asked.side}\n"
            '[cells]\nfirmware = "heat_diffusion"\n[[parcels]]\nsize_m = [0.3, 0.2]\nmass_kg = 1.0\n'
            'position_m = [0.0, 0.0]\n[friction]\nlaw = "viscous"\ncoefficient_s_per_m = 0.2\n'
        )
        try:
            with Hosts("abc") as hosts:
                for turn in range(asked.turns):
                    print(f"turn {turn + 1}, {time.strftime('%H:%M:%S')}", file=sys.stderr)
                    together.append(rate(here, "127.0.0.1", scene, folder / f"near{turn}"))
                    apart.append(rate(hosts.start, hosts.address["a"], scene, folder / f"far{turn}"))
        except pytest.skip.Exception as reason:
            print(f"not measured: {reason}")
            return
    ratio = median(far / near for far, near in zip(apart, together, strict=True))
    print(
        f"{asked.side**2} cells, one host: {median(together):.0f} ticks/s; three: {median(apart):.0f} ticks/s; "
        f"ratio {ratio:.2f}"
    )


if __name__ == "__main__":
    main()
