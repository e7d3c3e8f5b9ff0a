"""Corner that grazes a cell for milliseconds, and the errors of integrators that check at step ends only."""

# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Protocol, final

import numpy as np

from deploy.plots.map_view import INK, LOST
from deploy.plots.theme import write_picture
from deploy.runs.field_simulation import field_speeds
from deploy.studies.accuracy.experiments.markdown import (
    Section,
    error,
    milliseconds,
    panels,
    picture,
    power,
    prose,
    table,
)
from deploy.studies.accuracy.experiments.runs import ExperimentTrace, max_displacement_m, run, scene_with
from deploy.util.colours import colour
from plant.analysis.static_supports import StaticSupports
from plant.array import CellArray
from plant.friction.viscous import viscous_of
from plant.geometry import edges
from plant.loads import share_matrix

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from deploy.scenes.scene import Scene
    from plant.wheels import Floats


TOLERANCES = (1e-6, 1e-9, 1e-12)
_LONG_S = 0.7
"""Far enough that no first step ends there."""


@final
@dataclass(frozen=True, slots=True)
class Steps:
    """Motion on one support set, as if no cell came or went, in steps of DOP853's.

    Attributes:
        trace: ``(2, k)`` times, s, and how deep the cell then lies inside the footprint, m; negative outside.
        ends: ``(2, n)`` likewise at the ends of the steps, by tolerance.
    """

    trace: Floats
    ends: dict[float, Floats]


def steps_through(cell: tuple[int, int], since_s: float, until_s: float) -> Steps:
    """Integrate the scene ``elliptic`` with the supports of a given time held fixed.

    Args:
        cell: row and column of the observed cell.
        since_s: time just after a change of supports, s.
        until_s: end of the trajectory, s; step sizes are not limited.
    """
    begun = scene_with("elliptic", f"duration_s={np.ceil(since_s * 1e9) * 1e-9:.9f}")
    last = run(begun, {"name": "exact", "tolerance": 1e-14})
    rate = _rate(begun, last)
    depth = _depth(begun, last, cell)
    integrate: Any = import_module("scipy.integrate").solve_ivp
    start = float(last.time_s[-1])
    ends: dict[float, Floats] = {}
    trace: Floats = np.zeros((2, 0))
    for tolerance in TOLERANCES:
        found = integrate(
            rate,
            (start, start + _LONG_S),
            last.state[-1],
            method="DOP853",
            rtol=tolerance,
            atol=tolerance,
            dense_output=True,
        )
        ends[tolerance] = np.stack([found.t, depth(found.y)])
        fine = np.linspace(start, until_s, 200)
        trace = np.stack([fine, depth(found.sol(fine))])
    return Steps(trace, ends)


def _rate(scene: Scene, last: ExperimentTrace) -> Callable[[float, Floats], Floats]:
    """Eqs. 2, 14 and 15 on the cells that carry the parcel where the run ends."""
    spec = scene.plant_spec()
    array = CellArray(spec.array)
    x, y, angle = last.state[-1, :3].tolist()
    parcel = spec.parcels[0].model_copy(update={"position_m": (x, y), "angle_rad": angle})
    footing = StaticSupports(array, parcel)
    cells = footing.supports()
    places, speeds = array.positions_m[cells], field_speeds(scene, array.positions_m)[cells]
    centroid = places.mean(axis=0)
    share = share_matrix(places - centroid)
    kappa = viscous_of(spec.friction, "the graze").rate(spec.gravity_m_s2)
    turn = parcel.mass_kg / footing.inertia_kg_m2

    def rate(_: float, y: Floats) -> Floats:
        lever = places - y[:2]
        slip = speeds - y[3:5] - y[5] * np.stack([-lever[:, 1], lever[:, 0]], axis=1)
        pull = kappa * (share @ np.array([1.0, *(y[:2] - centroid)]))[:, None] * slip
        torque = np.sum(lever[:, 0] * pull[:, 1] - lever[:, 1] * pull[:, 0])
        return np.concatenate([y[3:], pull.sum(axis=0), [turn * torque]])

    return rate


def _depth(scene: Scene, last: ExperimentTrace, cell: tuple[int, int]) -> Callable[[Floats], Floats]:
    """How deep the cell lies inside the footprint in states ``(6, k)``, m; negative outside."""
    array = CellArray(scene.array)
    place = array.positions_m[array.lattice.index(cell)]
    normal, reach = edges(last.footprint_m)

    def depth(states: Floats) -> Floats:
        dx, dy = place[:, None] - states[:2]
        c, s = np.cos(states[2]), np.sin(states[2])
        body = np.stack([c * dx + s * dy, c * dy - s * dx], axis=1)
        return np.asarray((reach - body @ normal.T).min(axis=1), dtype=np.float64)

    return depth


_DEEPEST, _HIGHEST = -3.4, 7.0
"""What the view of the depth shows, over the greatest depth."""


class Point(Protocol):
    """One solver at one tolerance."""

    @property
    def solver(self) -> str:
        """Name of the solver."""
        ...

    @property
    def tolerance(self) -> float:
        """Requested tolerance."""
        ...

    @property
    def end_m(self) -> float:
        """Got."""
        ...


def draw_graze(steps: Steps, points: Sequence[Point]) -> Figure:
    """Depth of the cell against time with the ends of steps; error against tolerance."""
    figure, (left, right) = panels(
        "A corner clips a cell, and DOP853 steps over it",
        "elliptic  ·  left: on the supports before the graze; right: error after 2 s",
        widths_in=(4.9, 4.3),
        height_in=3.4,
    )
    _draw_depth(left, steps)
    _draw_errors(right, points)
    return figure


def _draw_depth(axes: Axes, steps: Steps) -> None:
    time, depth = steps.trace[0], 1e3 * steps.trace[1]
    top = float(depth.max())
    axes.axhline(0.0, color="#8b95a1", lw=0.8)
    axes.fill_between(time, 0.0, depth, where=depth > 0.0, color=LOST, alpha=0.35, lw=0)
    axes.plot(time, depth, color=INK, lw=1.4)
    axes.annotate(
        "below the parcel: carries load",
        (float(time[np.argmax(depth)]), 0.4 * top),
        xytext=(24, 8),
        textcoords="offset points",
        color=LOST,
        fontsize=8,
        va="center",
        arrowprops={"arrowstyle": "-", "color": LOST, "lw": 0.8},
    )
    axes.set_ylim(_DEEPEST * top, _HIGHEST * top)
    axes.set_yticks([-2.0, -1.0, 0.0, 1.0])
    axes.set_xlim(float(time[0]) - 0.001, float(time[-1]))
    for number, (tolerance, ends) in enumerate(steps.ends.items()):
        _draw_step(axes, tolerance, ends[0, :2], (2.0 + 1.6 * number) * top, colour(number))
    axes.set_xlabel("time (s)")
    axes.set_ylabel("depth of the cell inside the footprint (mm)")


def _draw_step(axes: Axes, tolerance: float, ends: Floats, level: float, shade: str) -> None:
    """One step of DOP853 from end to end; with an arrow where it goes on beyond the view."""
    edge = axes.get_xlim()[1]
    axes.plot(ends[0], level, "|", ms=12, mew=2.0, color=shade)
    head = "-|>" if ends[1] > edge else "-"
    axes.annotate(
        "",
        (min(float(ends[1]), edge), level),
        (float(ends[0]), level),
        arrowprops={"arrowstyle": head, "color": shade, "lw": 1.6, "shrinkA": 0, "shrinkB": 0},
    )
    if ends[1] <= edge:
        axes.plot(ends[1], level, "|", ms=12, mew=2.0, color=shade)
    axes.annotate(
        f"DOP853, {power(tolerance)}: first step ends at {ends[1]:.4f} s",
        (float(ends[0]), level),
        xytext=(5, 6),
        textcoords="offset points",
        color=shade,
        fontsize=8,
    )


def _draw_errors(axes: Axes, points: Sequence[Point]) -> None:
    solvers = list(dict.fromkeys(point.solver for point in points))
    tolerances = np.array(sorted({point.tolerance for point in points}))
    axes.plot(tolerances, tolerances, color="#8fa0b2", lw=1.0, ls=(0, (4, 3)), label="as asked")
    for number, solver in enumerate(solvers):
        own = [point for point in points if point.solver == solver]
        axes.plot(
            [point.tolerance for point in own],
            [point.end_m for point in own],
            "o-",
            ms=4,
            lw=1.4,
            color=INK if solver == "exact" else colour(number - 1),
            label=solver if solver == "exact" else f"SciPy {solver}",
        )
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.invert_xaxis()
    axes.set_xlabel("tolerance")
    axes.set_ylabel("error (m)")
    axes.legend(frameon=False, fontsize=7.5, loc="lower left")


CELL = (12, 16)
"""Row and column of the cell that is clipped."""
SECONDS = 2.0
_AFTER_S = 0.75
"""The cell is met again later: the reported one is its first stay after this."""
SETTINGS: dict[str, tuple[float, ...]] = {
    "exact": (1e-4, 1e-6, 1e-8, 1e-10, 1e-12),
    "DOP853": (1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-13),
    "RK45": (1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-13),
    "LSODA": (1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-13),
}
FILE = "graze.png"
_TITLE = "A graze, and why a smaller tolerance doesn't find it"
_HEADING = ("solver", "tolerance", "cell found late by, s", "error at 2 s, m", "most in 2 s, m", "time")
_SEEN = (
    "Left: depth of the cell inside the footprint against time, and steps of DOP853 that end after it. "
    "Right: error against tolerance; DOP853 stops improving, exact goes on"
)
_ROUNDING_S = 1e-9
"""An event found by less too late is not late: all else that is off moves it, too."""


@final
@dataclass(frozen=True, slots=True)
class GrazeRow:
    """One solver at one tolerance.

    Attributes:
        solver: ``exact``, or the method of ``solve_ivp``.
        tolerance: requested.
        late_s: after the cell came under the parcel its coming was found; None: never.
        end_m: largest displacement of a corner at the end.
        most_m: the same over the run.
        spent_s: processor time.
    """

    solver: str
    tolerance: float
    late_s: float | None
    end_m: float
    most_m: float
    spent_s: float


@final
@dataclass(frozen=True, slots=True)
class Graze:
    """Measurements of a grazing cell.

    Attributes:
        reference: reference run of the errors.
        agreement_m: difference of the exact solver at 1e-14 from the reference, m.
        enters_s: time at which the corner reaches the cell, s.
        leaves_s: time at which the corner is past the cell, s.
        rows: all solvers and tolerances.
        steps: steps of DOP853 from the last preceding change of supports, past the cell.
    """

    reference: str
    agreement_m: float
    enters_s: float
    leaves_s: float
    rows: Sequence[GrazeRow]
    steps: Steps


def measure(repeats: int) -> Graze:
    """Run the scene ``elliptic`` past the graze with every solver and tolerance."""
    scene = scene_with("elliptic", f"duration_s={SECONDS}")
    exact = run(scene, {"name": "exact", "tolerance": 1e-14})
    known, name = exact, "`exact` at 1e-14, for heyoka is not installed"
    if find_spec("heyoka") is not None:
        known, name = run(scene, {"name": "heyoka", "tolerance": 1e-16}), "heyoka at 1e-16"
    enters, leaves = dwell_interval(exact)
    rows = [
        _row(solver, tolerance, run(scene, settings(solver, tolerance), repeats=repeats), known, enters)
        for solver, tolerances in SETTINGS.items()
        for tolerance in tolerances
    ]
    since = max(event.time_s for event in exact.events if event.time_s < enters)
    steps = steps_through(CELL, since, leaves + 0.017)
    return Graze(name, float(max_displacement_m(exact, known).max()), enters, leaves, rows, steps)


def settings(solver: str, tolerance: float) -> dict[str, Any]:
    """The solver's table in a scene."""
    if solver == "exact":
        return {"name": solver, "tolerance": tolerance}
    return {"name": "scipy", "method": solver, "tolerance": tolerance}


def dwell_interval(one: ExperimentTrace) -> tuple[float, float]:
    """Return the times at which the cell is gained and lost as a support; NaN without such an event."""
    found = [event for event in one.events if CELL in event.cells and _AFTER_S < event.time_s < 1.0]
    times = {event.kind: event.time_s for event in reversed(found)}
    return times.get("support_gained", np.nan), times.get("support_lost", np.nan)


def _row(
    solver: str, tolerance: float, one: ExperimentTrace, known: ExperimentTrace, enters_s: float
) -> GrazeRow:
    apart, found = max_displacement_m(one, known), dwell_interval(one)[0]
    late = None if np.isnan(found) else found - enters_s
    return GrazeRow(solver, tolerance, late, float(apart[-1]), float(apart.max()), one.spent_s)


def section(repeats: int) -> Section:
    """The section of the page."""
    return describe(measure(repeats), repeats)


def describe(found: Graze, repeats: int) -> Section:
    """Describe the measurements in Markdown."""
    ends = {tolerance: f"{steps[0, 1]:.4f}" for tolerance, steps in found.steps.ends.items()}
    late = max(row.late_s or 0.0 for row in found.rows if row.solver == "DOP853")
    text = prose(
        "graze",
        row=str(CELL[0]),
        column=str(CELL[1]),
        enters=f"{found.enters_s:.5f}",
        leaves=f"{found.leaves_s:.5f}",
        stay=f"{(found.leaves_s - found.enters_s) * 1e3:.1f}",
        end_6=ends[1e-6],
        end_9=ends[1e-9],
        end_12=ends[1e-12],
        picture=picture(FILE, _SEEN),
        table=table(_HEADING, [_line(row) for row in found.rows]),
        floor=error(min(row.end_m for row in found.rows if row.solver == "DOP853")),
        late=f"{1e3 * late:.1f}",
        reference=found.reference,
        agreement=error(found.agreement_m),
        repeats=str(repeats),
    )
    return Section(_TITLE, text, {FILE: partial(write_picture, partial(draw_graze, found.steps, found.rows))})


def _line(row: GrazeRow) -> tuple[str, ...]:
    name = "`exact`" if row.solver == "exact" else f"`scipy`, {row.solver}"
    if row.late_s is None:
        late = "never"
    else:
        late = error(row.late_s) if row.late_s > _ROUNDING_S else "0"
    times = milliseconds(row.spent_s)
    return (name, power(row.tolerance), late, error(row.end_m), error(row.most_m), times)
