"""What declared latency gains over a slow network: ticks a second over L and D, with a round trip of 40 ms.

``python tests/benchmarks/bus/latency.py`` measures and prints its method.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from tests.system.joining import command, plant_command
from tests.system.relay import CELLS, PLANT, Relay
from tests.system.small import small_scene

METHOD = """\
Method. 256 cells that diffuse heat, in two shards of one process each, and the plant run in two network namespaces.
A relay in user space delays every packet by {delay_ms:g} ms each way, so that T = {round_trip_ms:g} ms. L is
bus.sense_to_drive_ticks, D is bus.link_ticks. "bound" is min(L + 1, D) / T. Rates are ticks by wall time of the ticks.
"""
SETTINGS = ((0, 1), (1, 2), (4, 5), (9, 10), (10, 10), (19, 20), (0, 10), (9, 1))
"""L and D."""


class Row(NamedTuple):
    """A setting's result."""

    drive_ticks: int
    link_ticks: int
    ticks_per_s: float
    bound: float
    digest: str


def measure(delay_s: float, drive_ticks: int, link_ticks: int, ticks: int) -> Row:
    """Run the scene over the relay."""
    bus = f"\n[bus]\nsense_to_drive_ticks = {drive_ticks}\nlink_ticks = {link_ticks}\n"
    stall = "\n[stall]\nlease_s = 10.0\ndeadline_s = 20.0\n"
    duration_s = round(ticks * 0.004096, 9)
    with tempfile.TemporaryDirectory() as name, Relay(delay_s=delay_s, loss=0.0, seed=1) as relay:
        scene = Path(name) / "scene.toml"
        text = small_scene(columns=16, duration_s=duration_s).replace("rows = 3", "rows = 16")
        scene.write_text(text + bus + stall)
        endpoint = f"tcp/{PLANT}:7447"
        plant = relay.start(PLANT, CELLS, plant_command(scene, endpoint, 2, Path(name) / "out"))
        relay.start(CELLS, PLANT, command(scene, endpoint, 2, "scene"))
        relay.go()
        summary = json.loads(_output(plant))
    return Row(
        drive_ticks,
        link_ticks,
        summary["ticks_per_s"],
        min(drive_ticks + 1, link_ticks) / (2.0 * delay_s),
        summary["digest"],
    )


def _output(plant: subprocess.Popen[str]) -> str:
    stdout, stderr = plant.communicate(timeout=120.0)
    if plant.returncode:
        raise SystemExit(stderr)
    return stdout


def table(rows: Sequence[Row]) -> str:
    """The results, one setting a line."""
    first = rows[0].ticks_per_s
    lines = [f"{'L':>3} {'D':>3} {'ticks/s':>8} {'bound':>7} {'of default':>11}"]
    lines += [
        f"{row.drive_ticks:3} {row.link_ticks:3} {row.ticks_per_s:8.1f} {row.bound:7.1f} "
        f"{row.ticks_per_s / first:10.1f} x"
        for row in rows
    ]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--delay", type=float, default=20.0, help="each way, ms")
    parser.add_argument("--ticks", type=int, default=200, help="ticks of a run")
    parser.add_argument("--settings", type=int, default=len(SETTINGS), help="how many settings of L and D")
    options = parser.parse_args()
    delay_s = options.delay * 1e-3
    print(METHOD.format(delay_ms=options.delay, round_trip_ms=2.0 * options.delay))
    print(table([measure(delay_s, *one, options.ticks) for one in SETTINGS[: options.settings]]))


if __name__ == "__main__":
    main()
