"""The exact solver beside the best of other integrators, and beside the least that its own arithmetic could cost.

``python tests/benchmarks/plant/exact_against_taylor.py`` needs the extra ``reference`` (heyoka, scikit-sundae) and
prints its method.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable
from math import cos, sin
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from cvode_adams import integrate
from dop853 import Functions
from exact_against_scipy import TOLERANCE, ExactSide, Problem, several
from heyoka_events import HeyokaSide

from plant.kernels.common import layout
from plant.kernels.common.advance import advance
from plant.kernels.common.series import taylor
from plant.kernels.common.surface import Surface
from plant.plant import Plant

TICK_S = 0.004096
HALFWAY_NS = 1_500_000_000
CALLS = 2000

METHOD = """\
The scene elliptic, 10 s, tolerance 1e-12: medians of processor time over {turns} runs, without building and compiling.
  heyoka: its adaptive Taylor integrator, compiled, the edges of the {cells} cells that come near as terminal events.
  CVODE: SUNDIALS' Adams formulas with root finding, functions compiled, restarted at every event.
Kernels, called from compiled code: one Taylor recurrence at {at:g} s into the run, of the order the solver uses there
(looking as far as it does); the run's time a support change; a tick of {tick:g} ms in which the wheels have new speeds.
"""


def median_s(go: Callable[[], Any], turns: int) -> float:
    """Median processor time of ``go``."""
    go()
    spent: list[float] = []
    for _ in range(turns):
        begun = time.process_time()
        go()
        spent.append(time.process_time() - begun)
    return statistics.median(spent)


@njit(error_model="numpy")
def recurrences(parcel: Any, work: Any, ahead: float, calls: int) -> float:
    """Taylor recurrences, so many of them; returns their mean order."""
    orders = 0
    for _ in range(calls):
        order, _ = taylor(parcel, work, 0.0, cos(parcel.y[2]), sin(parcel.y[2]), ahead)
        orders += order
    return orders / calls


@njit(error_model="numpy")
def ticks(
    surfaces: Any, parcel: Any, work: Any, start: Any, times: Any, out: Any, log: Any, calls: int
) -> None:
    """Advance by one tick from the same state again and again, the wheels' speeds now one set, now the other."""
    for i in range(calls):
        parcel.y[:] = start
        advance(surfaces[i % 2], parcel, work, TICK_S, 1000, times, out, log)


def kernel_costs(problem: Problem, turns: int) -> tuple[float, float, float, float]:
    """(a recurrence, its order, a recurrence of a tick's order, a tick): seconds of processor time."""
    plant: Plant = problem.plant(TOLERANCE)
    plant.advance(problem.speeds, HALFWAY_NS)
    solver = plant._solver
    parcel, work = solver.parcels[0], solver.workspace(0).work
    still, grip = np.zeros_like(problem.speeds), np.ones(len(problem.speeds))
    surfaces = tuple(
        Surface(plant.array.positions_m, plant.array.grid, problem.speeds * factor, still, grip)
        for factor in (1.0, 0.97)
    )
    ahead = 2.0 * float(parcel.par[layout.GAP])
    order = recurrences(parcel, work, ahead, 1)
    long_s = median_s(lambda: recurrences(parcel, work, ahead, CALLS), turns) / CALLS
    short_s = median_s(lambda: recurrences(parcel, work, TICK_S, CALLS), turns) / CALLS
    start: NDArray[np.float64] = parcel.y.copy()
    none, out, log = np.zeros(0), np.zeros((0, 6)), np.zeros((64, 4))
    tick_s = median_s(lambda: ticks(surfaces, parcel, work, start, none, out, log, CALLS), turns) / CALLS
    return long_s, order, short_s, tick_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--turns", type=int, default=9, help="runs of each")
    turns = parser.parse_args().turns
    problem = Problem.bundled()
    spec = problem.scene.plant_spec()
    functions = Functions.of(spec, problem.speeds)
    exact = ExactSide(problem)
    exact.prepare(1)
    changes, states = exact.go(problem.times_s)
    apart = np.hypot(*(functions.positions[:, None] - states[None, :, :2]).transpose(2, 0, 1))
    near = np.flatnonzero((apart < functions.reach).any(axis=1))
    heyoka = HeyokaSide(spec, functions, near, TOLERANCE)
    end_s = problem.scene.duration_s
    parcel = problem.scene.parcels[0]
    start = np.array([*parcel.position_m, parcel.angle_rad, 0.0, 0.0, 0.0])
    exact_s = statistics.median(several(exact, None) + several(exact, None))
    others = {
        "heyoka": lambda: heyoka.run(end_s),
        "CVODE": lambda: integrate(functions, start, end_s, TOLERANCE),
    }
    print(METHOD.format(turns=turns, cells=len(near), at=HALFWAY_NS * 1e-9, tick=TICK_S * 1e3))
    print(f"{'':10}{'time':>12}{'ratio':>8}{'target':>8}{'crossings':>11}{'apart at the end':>18}")
    print(f"{'exact':10}{exact_s * 1e3:9.2f} ms{1.0:8.1f}{'':8}{changes:11}")
    for (title, go), target in zip(others.items(), (12, 50), strict=True):
        spent, (crossings, state) = median_s(go, turns), go()
        far = problem.errors(states[-1:].repeat(len(states), 0), state[None].repeat(len(states), 0))[0]
        print(
            f"{title:10}{spent * 1e3:9.2f} ms{spent / exact_s:8.1f}{f'>= {target}':>8}{crossings:11}{far:16.1e} m"
        )
    long_s, order, short_s, tick_s = kernel_costs(problem, turns)
    change_s = exact_s / changes
    print(
        f"\na recurrence of order {order:.0f}: {long_s * 1e6:.2f} us; a support change: {change_s * 1e6:.2f} us,"
    )
    print(f"{change_s / long_s:.1f} times it (at most 12)")
    print(
        f"a recurrence for a tick: {short_s * 1e6:.2f} us; a tick with new speeds: {tick_s * 1e6:.2f} us,"
        f" {tick_s / short_s:.1f} times it (at most 10)"
    )


if __name__ == "__main__":
    main()
