"""A model of ticks a second over cells, hosts, round trip and declared latency: fitted here, and checked here.

``python tests/benchmarks/scale.py`` measures, fits, checks, prints its method and draws ``docs/scale.md``'s picture.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
sys.path.insert(0, str(Path(__file__).resolve().parent / "bus"))

from fast_runs import Case
from latency import measure as over_relay

from deploy.runs.backends import Workers
from deploy.runs.simulation import Simulation

METHOD = """\
Method. Packed runs of diffusing heat with one parcel, not recorded, each in a process of its own: processor time of a
tick of the plant's process (p) and of a shard's (c), from the kernel's accounts, and ticks by wall time. Fitted, by
least squares of relative errors, to {fitted} runs of {sizes} cells in {shards} shards:

    p = p0 + p1 N + p2 S        c = c0 + c1 N / S        for N cells in S shards

Model, for shards on processors of their own, round trip T, and lookahead k (from bus.sense_to_drive_ticks and
bus.link_ticks):

    seconds a tick = max(p, c, (p + c + T) / (k + 1), bytes of drives and senses / bandwidth)
"""
BYTES = 16.0 + 1.0 / 8.0
"""Of a cell in a tick: a drive and a bit."""
FITTED = tuple((n, s) for n in (100, 400, 1_600, 6_400, 25_600, 102_400) for s in (1, 2, 4))
CHECKED = ((900, 1), (900, 2), (10_000, 1), (10_000, 2), (250_000, 2))
"""Cells and shards of runs that the model is checked against."""
_LEAST_S = 1e-4
"""Processor time of a tick of which an error counts in full."""


@dataclass(frozen=True)
class Run:
    """A measured run: processor times and wall time of a tick, s."""

    cells: int
    shards: int
    plant_s: float
    shard_s: float
    wall_s: float


@dataclass(frozen=True)
class Model:
    """Fitted processor times of a tick, s."""

    p: tuple[float, float, float]
    c: tuple[float, float]

    def plant_s(self, cells: float, shards: float) -> float:
        """Return the plant's time."""
        return self.p[0] + self.p[1] * cells + self.p[2] * shards

    def shard_s(self, cells: float, shards: float) -> float:
        """Return a shard's time."""
        return self.c[0] + self.c[1] * cells / shards

    def bounds(
        self, cells: float, shards: float, trip_s: float, ahead: int, bytes_per_s: float
    ) -> dict[str, float]:
        """Return what each part allows, s a tick."""
        p, c = self.plant_s(cells, shards), self.shard_s(cells, shards)
        return {
            "plant": p,
            "shards": c,
            "all in turn": (p + c + trip_s) / (ahead + 1),
            "plant's link": BYTES * cells / bytes_per_s,
        }

    def rate(
        self, cells: float, shards: float, trip_s: float = 0.0, ahead: int = 0, bytes_per_s: float = 1.25e9
    ) -> float:
        """Return ticks a second."""
        return 1.0 / max(self.bounds(cells, shards, trip_s, ahead, bytes_per_s).values())


def run_once(cells: int, shards: int, seconds: float) -> Run:
    """Measure a run in this process, which has run no other."""
    rows = next(r for r in range(int(cells**0.5), 0, -1) if cells % r == 0)
    held = [{"columns": [0, 0], "speed_m_s": [0.05, 0.0]}]
    changes: tuple[tuple[str, Any], ...] = (
        ("cells.parameters", {"diffusion_number": 0.2, "held": held}),
        ("parcels", [{"size_m": [0.2, 0.2], "mass_kg": 1.0, "position_m": [0.0, 0.0]}]),
    )
    scene = Case("", "heat", rows, cells // rows, shards, False, changes).loaded()
    with Simulation.open(scene, Workers(shards)) as simulation:
        for _ in range(5):
            simulation.step()
        workers = _workers()
        before, used, begun = simulation.tick, _used_s(workers), time.perf_counter()
        own = time.process_time()
        while time.perf_counter() < begun + seconds or simulation.tick < before + 3:
            simulation.step()
        ticks, wall_s = simulation.tick - before, time.perf_counter() - begun
        plant_s = time.process_time() - own
        return Run(cells, shards, plant_s / ticks, (_used_s(workers) - used) / ticks / shards, wall_s / ticks)


def _workers() -> list[int]:
    """Return the ids of processes of cells: the grandchildren of this process."""
    parents = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            text = (entry / "stat").read_text() if (entry / "stat").exists() else ""
            if text:
                parents[int(entry.name)] = int(text[text.rindex(")") :].split()[2])
    return [pid for pid, parent in parents.items() if parents.get(parent) == os.getpid()]


def _used_s(pids: Sequence[int]) -> float:
    """Return the processor time that processes have used, s."""
    ticks = 0
    for pid in pids:
        text = Path(f"/proc/{pid}/stat").read_text()
        fields = text[text.rindex(")") :].split()
        ticks += int(fields[12]) + int(fields[13])
    return ticks / os.sysconf("SC_CLK_TCK")


def run_apart(cells: int, shards: int, seconds: float) -> Run:
    """Measure a run in a new process."""
    command = [sys.executable, __file__, "--one", str(cells), str(shards), "--seconds", str(seconds)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return Run(**json.loads(done.stdout.splitlines()[-1]))


def fit(runs: Sequence[Run]) -> Model:
    """Fit the model to runs."""

    def solved(columns: Sequence[Sequence[float]], values: Sequence[float]) -> list[float]:
        weight = 1.0 / np.maximum(np.array(values), _LEAST_S)
        a = np.array(columns).T * weight[:, None]
        from scipy.optimize import nnls

        return nnls(a, np.array(values) * weight)[0].tolist()

    ones = [1.0] * len(runs)
    p = solved(
        [ones, [float(run.cells) for run in runs], [float(run.shards) for run in runs]],
        [run.plant_s for run in runs],
    )
    c = solved([ones, [run.cells / run.shards for run in runs]], [run.shard_s for run in runs])
    return Model((p[0], p[1], p[2]), (c[0], c[1]))


def print_checks(model: Model, seconds: float) -> None:
    """Print the model beside runs to which it was not fitted."""
    print("runs that the model was not fitted to, on this machine; shards share its processors")
    print(f"{'N':>8} {'S':>3} {'T ms':>6} {'k':>3} {'measured':>9} {'model':>8} {'ratio':>6}")
    for cells, shards in CHECKED:
        found = 1.0 / run_apart(cells, shards, seconds).wall_s
        _print_check(cells, shards, 0.0, 0, found, model)
    for drive_ticks, link_ticks in ((0, 1), (4, 5), (9, 10), (19, 20)):
        row = over_relay(0.02, drive_ticks, link_ticks, 200)
        _print_check(256, 2, 0.04, min(drive_ticks, link_ticks - 1), row.ticks_per_s, model)


def _print_check(cells: int, shards: int, trip_s: float, ahead: int, found: float, model: Model) -> None:
    said = model.rate(cells, shards, trip_s, ahead)
    print(f"{cells:8,} {shards:3} {trip_s * 1e3:6.0f} {ahead:3} {found:9.1f} {said:8.1f} {found / said:6.2f}")


def print_outlook(model: Model) -> None:
    """Print what the model says of larger systems, and what binds first."""
    print("outlook: shards on processors of their own, two a host; 10 Gbit/s at the plant")
    print(f"{'N':>10} {'hosts':>6} {'T ms':>6} {'k':>3} {'ticks/s':>8}  binds first")
    for cells in (1_000, 10_000, 100_000, 1_000_000):
        for hosts, trip_s, ahead in (
            (1, 0.0, 0),
            (10, 0.0005, 0),
            (100, 0.0005, 0),
            (100, 0.0005, 9),
            (100, 0.04, 9),
        ):
            bounds = model.bounds(cells, 2 * hosts, trip_s, ahead, 1.25e9)
            first = max(bounds, key=lambda name: bounds[name])
            print(f"{cells:10,} {hosts:6} {trip_s * 1e3:6.1f} {ahead:3} {1.0 / bounds[first]:8.1f}  {first}")


def draw(model: Model, path: Path) -> None:
    """Draw ticks a second over cells."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.5, 4.2), layout="constrained")
    axes = figure.subplots()
    cells = np.logspace(2, 6, 200)
    for hosts, style in ((1, ":"), (10, "--"), (100, "-")):
        for trip_s, ahead, colour in ((0.0005, 0, "C0"), (0.0005, 9, "C2"), (0.04, 0, "C3"), (0.04, 9, "C1")):
            rate = [model.rate(n, 2 * hosts, 0.0 if hosts == 1 else trip_s, ahead) for n in cells]
            if hosts > 1 or colour == "C0":
                label = f"{hosts} hosts, T = {trip_s * 1e3:g} ms, λ = {ahead}" if hosts > 1 else "1 host"
                axes.plot(cells, rate, style, color="0.3" if hosts == 1 else colour, label=label)
    axes.axhline(1.0 / 0.004096, color="0.6", linewidth=0.8)
    axes.text(110, 1.08 / 0.004096, "real time", fontsize=8, color="0.4")
    axes.set(xscale="log", yscale="log", xlabel="cells", ylabel="ticks per second")
    figure.legend(fontsize=7, loc="outside right upper")
    axes.grid(alpha=0.3)
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=2.0, help="length of a measurement")
    parser.add_argument("--quick", action="store_true", help="three sizes, no checks")
    parser.add_argument(
        "--picture", metavar="FILE", default="scale.png", help="picture to write; empty: none"
    )
    parser.add_argument("--one", nargs=2, type=int, metavar=("CELLS", "SHARDS"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(vars(run_once(*options.one, options.seconds))))
        return
    sizes = ((100, 1), (400, 2), (1_600, 1)) if options.quick else FITTED
    runs = [run_apart(*size, options.seconds) for size in sizes]
    model = fit(runs)
    shown = [sorted({size[i] for size in sizes}) for i in range(2)]
    print(METHOD.format(fitted=len(runs), sizes=", ".join(f"{n:,}" for n in shown[0]), shards=shown[1]))
    print(
        f"p0 {model.p[0] * 1e6:.0f} us, p1 {model.p[1] * 1e9:.1f} ns a cell, p2 {model.p[2] * 1e6:.0f} us a shard; "
        f"c0 {model.c[0] * 1e6:.0f} us, c1 {model.c[1] * 1e9:.1f} ns a cell"
    )
    worst = max(runs, key=lambda run: abs(np.log(model.plant_s(run.cells, run.shards) / run.plant_s)))
    print(
        f"worst fit of p: {worst.cells:,} cells, {worst.shards} shards, {worst.plant_s * 1e6:.0f} us, model "
        f"{model.plant_s(worst.cells, worst.shards) * 1e6:.0f} us\n"
    )
    if not options.quick:
        print_checks(model, options.seconds)
        print()
    print_outlook(model)
    if options.picture:
        draw(model, Path(options.picture))


if __name__ == "__main__":
    main()
