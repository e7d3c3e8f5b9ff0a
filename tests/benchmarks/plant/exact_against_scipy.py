"""What the exact solver costs beside SciPy's ``solve_ivp``, on the scene ``elliptic`` at tolerance 1e-12.

``python tests/benchmarks/plant/exact_against_scipy.py`` measures both in one process and prints its method.
"""

from __future__ import annotations

import argparse
import gc
import itertools
import json
import statistics
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Protocol

import numba
import numpy as np
import scipy
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from dop853 import Events, Functions, integrate

from deploy.runs.field_simulation import field_speeds
from deploy.scenes.files import load_scene
from deploy.scenes.scene import Scene
from plant.plant import Plant

Floats = NDArray[np.float64]

TOLERANCE = 1e-12
REFERENCE_TOLERANCE = 1e-14
TARGET = 50.0
"""How many times faster than the faster of SciPy's forms the exact solver must be."""
LOOK_EVERY_S = 0.002
"""The longest step that can't jump over the stays of a few milliseconds in this scene."""
LOOK_AT_S = 2.0

METHOD = """\
The scene elliptic, 10 s, tolerance 1e-12. Both sides in one process, warm, in {turns} turns of {runs} runs: medians of
processor time, without building the plant and without compiling. "sampled": with the state at every control period.
  exact: Plant.trajectory with constant wheel speeds.
  SciPy {scipy}: solve_ivp, DOP853, rtol = atol = 1e-12. Right-hand side (from constants computed once a support set)
  and events compiled by numba {numba}; every event is terminal, the integration restarts on its other side.
  "one": a single event function, the least signed distance of all cells to the edge. "each": a function for each
  cell in reach. Both watch the least load too. "every 2 ms": a longest step that no stay slips through, to check
  that both sides solve one problem.
Errors, against the exact solver at 1e-14: largest displacement of a corner of the footprint over the run and at 2 s,
and the angle's at 2 s.
"""


@dataclass(frozen=True)
class Row:
    """One way through the scene.

    Attributes:
        title: what was run.
        plain_s: processor time, the end alone asked for.
        ratio: ``plain_s`` over the exact solver's.
        sampled_s: processor time with the states of every control period.
        sampled_ratio: ``sampled_s`` over the exact solver's.
        crossings: cells that entered or left the footprint.
        error_max_m: largest displacement of a corner over the run.
        error_at_m: the same at ``LOOK_AT_S``.
        error_at_rad: of the angle then.
    """

    title: str
    plain_s: float
    ratio: float
    sampled_s: float
    sampled_ratio: float
    crossings: int
    error_max_m: float
    error_at_m: float
    error_at_rad: float


@dataclass(frozen=True)
class Problem:
    """The scene as both sides need it.

    Attributes:
        scene: ``elliptic``.
        speeds: ``(n, 2)`` of the wheels, m/s.
        times_s: ``(T,)`` ends of the control periods.
        footprint_m: ``(4, 2)`` corners about the centre of mass.
    """

    scene: Scene
    speeds: Floats
    times_s: Floats
    footprint_m: Floats

    @classmethod
    def bundled(cls) -> Problem:
        """The scene that comes with the project."""
        scene = load_scene("elliptic")
        plant = Plant(scene.plant_spec())
        period_ns, end_ns = scene.cells.period_ns, scene.duration_ns
        times_ns = np.append(np.arange(period_ns, end_ns, period_ns), end_ns)
        return cls(
            scene, field_speeds(scene, plant.array.positions_m), times_ns * 1e-9, plant.footprints_m[0]
        )

    def plant(self, tolerance: float) -> Plant:
        """A plant at the start."""
        spec = self.scene.plant_spec()
        solver = spec.solver.model_copy(update={"tolerance": tolerance})
        return Plant(spec.model_copy(update={"solver": solver}))

    def corners(self, states: Floats) -> Floats:
        """Corners ``(T, 4, 2)`` of the footprint in states ``(T, 6)``, m."""
        c, s = np.cos(states[:, 2, None]), np.sin(states[:, 2, None])
        x, y = self.footprint_m.T
        return states[:, None, :2] + np.stack([c * x - s * y, s * x + c * y], axis=-1)

    def errors(self, states: Floats, reference: Floats) -> tuple[float, float, float]:
        """Largest displacement of a corner over the run and at ``LOOK_AT_S``, m; of the angle then, rad."""
        apart = self.corners(states) - self.corners(reference)
        moved = np.hypot(apart[..., 0], apart[..., 1]).max(axis=1)
        k = int(np.searchsorted(self.times_s, LOOK_AT_S))
        return float(moved.max()), float(moved[k]), float(abs(states[k, 2] - reference[k, 2]))


class Side(Protocol):
    """One way through the scene."""

    def prepare(self, runs: int) -> None:
        """What is not measured."""

    def go(self, times_s: Floats | None) -> tuple[int, Floats]:
        """Returns (cells that entered or left, states at ``times_s`` or only the last)."""
        ...


class ExactSide:
    """``Plant.trajectory``, on a plant of its own every time."""

    def __init__(self, problem: Problem, tolerance: float = TOLERANCE) -> None:
        self.problem, self.tolerance = problem, tolerance
        self.plants: list[Plant] = []

    def prepare(self, runs: int) -> None:
        self.plants = [self.problem.plant(self.tolerance) for _ in range(runs)]

    def go(self, times_s: Floats | None) -> tuple[int, Floats]:
        scene = self.problem.scene
        sample_ns = scene.duration_ns if times_s is None else scene.cells.period_ns
        plant = self.plants.pop()
        course = plant.trajectory(self.problem.speeds, scene.duration_ns, sample_ns)
        return plant.support_changes, course.state[1:, 0]


class SciPySide:
    """DOP853, on functions compiled beforehand."""

    def __init__(
        self, problem: Problem, functions: Functions, events: Events, max_step: float = np.inf
    ) -> None:
        parcel = problem.scene.parcels[0]
        self.start = np.array([*parcel.position_m, parcel.angle_rad, 0.0, 0.0, 0.0])
        self.end_s = problem.scene.duration_s
        self.functions, self.events, self.max_step = functions, events, max_step

    def prepare(self, runs: int) -> None:
        pass

    def go(self, times_s: Floats | None) -> tuple[int, Floats]:
        return integrate(
            self.functions,
            self.start,
            self.end_s,
            times_s,
            tolerance=TOLERANCE,
            events=self.events,
            max_step=self.max_step,
        )


def measure(
    sides: dict[str, Side], times_s: Floats, turns: int, runs_a_turn: int
) -> dict[tuple[str, bool], float]:
    """Median processor time of every side, without and with samples; the sides take turns of several runs."""
    spent: dict[tuple[str, bool], list[float]] = {}
    for turn in range(turns + 1):
        for (title, side), sampled in itertools.product(sides.items(), (False, True)):
            runs = several(side, times_s if sampled else None, runs_a_turn)
            if turn > 0:  # the first turn warms up
                spent.setdefault((title, sampled), []).extend(runs)
    return {key: statistics.median(values) for key, values in spent.items()}


def several(side: Side, times_s: Floats | None, runs: int) -> list[float]:
    """Processor time of each of several runs in a row; no garbage is collected meanwhile, as ``timeit`` has it."""
    side.prepare(runs)
    gc.collect()
    gc.disable()
    spent: list[float] = []
    for _ in range(runs):
        begun = time.process_time()
        side.go(times_s)
        spent.append(time.process_time() - begun)
    gc.enable()
    return spent


def compare(turns: int, runs: int) -> list[Row]:
    """All rows; the exact solver's is the first, then the two forms of SciPy's, then the check."""
    problem = Problem.bundled()
    functions = Functions.of(problem.scene.plant_spec(), problem.speeds)
    forms: dict[str, Side] = {
        "exact": ExactSide(problem),
        "SciPy, one": SciPySide(problem, functions, "one"),
        "SciPy, each": SciPySide(problem, functions, "each"),
    }
    check: dict[str, Side] = {"SciPy, each, every 2 ms": SciPySide(problem, functions, "each", LOOK_EVERY_S)}
    median = measure(forms, problem.times_s, turns, runs) | measure(check, problem.times_s, 1, runs)
    exact = ExactSide(problem, REFERENCE_TOLERANCE)
    exact.prepare(1)
    reference = exact.go(problem.times_s)[1]
    plain_s, sampled_s = median["exact", False], median["exact", True]
    rows: list[Row] = []
    for title, side in (forms | check).items():
        side.prepare(1)
        crossings, states = side.go(problem.times_s)
        plain, sampled = median[title, False], median[title, True]
        errors = problem.errors(states, reference)
        rows.append(Row(title, plain, plain / plain_s, sampled, sampled / sampled_s, crossings, *errors))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--turns", type=int, default=4, help="of several runs, for each side")
    parser.add_argument("--runs", type=int, default=10, help="a turn")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    rows = compare(options.turns, options.runs)
    ratio = min(row.ratio for row in rows[1:3])
    if options.json:
        print(json.dumps({"rows": [asdict(row) for row in rows], "ratio": ratio, "target": TARGET}))
        return
    versions = {"scipy": scipy.__version__, "numba": numba.__version__}
    print(METHOD.format(turns=options.turns, runs=options.runs, **versions))
    head = ("end only", "ratio", "sampled", "ratio", "crossings", "error, m", "at 2 s, m", "at 2 s, rad")
    print(f"{'':24}" + "".join(f"{word:>12}" for word in head))
    for row in rows:
        times = f"{row.plain_s * 1e3:9.2f} ms{row.ratio:12.1f}{row.sampled_s * 1e3:9.2f} ms{row.sampled_ratio:12.1f}"
        errors = f"{row.error_max_m:12.1e}{row.error_at_m:12.1e}{row.error_at_rad:12.1e}"
        print(f"{row.title:24}{times}{row.crossings:12}{errors}")
    print(f"\nexact is {ratio:.1f} times as fast as the faster of SciPy's two forms; target: {TARGET:.0f}")


if __name__ == "__main__":
    main()
