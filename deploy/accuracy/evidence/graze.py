"""A corner that clips a cell for milliseconds, and what an integrator loses that looks at the ends of its steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from typing import Any, final

import numpy as np

from deploy.accuracy.evidence.graze_picture import draw_graze
from deploy.accuracy.evidence.graze_steps import Steps, steps_past
from deploy.accuracy.evidence.runs import Run, apart_m, run, scene_with
from deploy.accuracy.evidence.section import Section, error, milliseconds, picture, power, prose, table
from deploy.picture import write_picture

CELL = (12, 16)
"""Row and column of the cell that is clipped."""
SECONDS = 2.0
_AFTER_S = 0.75
"""The cell is met again later: what is told here is its first stay after this."""
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
class Row:
    """One solver at one tolerance.

    Attributes:
        solver: ``exact``, or the method of ``solve_ivp``.
        tolerance: asked for.
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
    """What was measured.

    Attributes:
        reference: which run errors are told against.
        agreement_m: how far the exact solver at 1e-14 is from it.
        enters_s: when the corner reaches the cell.
        leaves_s: when it is past.
        rows: all solvers and tolerances.
        steps: of DOP853, from the last change of supports before, past the cell.
    """

    reference: str
    agreement_m: float
    enters_s: float
    leaves_s: float
    rows: Sequence[Row]
    steps: Steps


def measure(repeats: int) -> Graze:
    """Run the scene ``elliptic`` past the graze with every solver and tolerance."""
    scene = scene_with("elliptic", f"duration_s={SECONDS}")
    exact = run(scene, {"name": "exact", "tolerance": 1e-14})
    known, name = exact, "`exact` at 1e-14, for heyoka is not installed"
    if find_spec("heyoka") is not None:
        known, name = run(scene, {"name": "heyoka", "tolerance": 1e-16}), "heyoka at 1e-16"
    enters, leaves = stay(exact)
    rows = [
        _row(solver, tolerance, run(scene, settings(solver, tolerance), repeats=repeats), known, enters)
        for solver, tolerances in SETTINGS.items()
        for tolerance in tolerances
    ]
    since = max(event.time_s for event in exact.events if event.time_s < enters)
    steps = steps_past(CELL, since, leaves + 0.017)
    return Graze(name, float(apart_m(exact, known).max()), enters, leaves, rows, steps)


def settings(solver: str, tolerance: float) -> dict[str, Any]:
    """The solver's table in a scene."""
    if solver == "exact":
        return {"name": solver, "tolerance": tolerance}
    return {"name": "scipy", "method": solver, "tolerance": tolerance}


def stay(one: Run) -> tuple[float, float]:
    """When the cell is found to come under the parcel and when to leave; NaN where it isn't."""
    found = [event for event in one.events if CELL in event.cells and _AFTER_S < event.time_s < 1.0]
    times = {event.kind: event.time_s for event in reversed(found)}
    return times.get("support_gained", np.nan), times.get("support_lost", np.nan)


def _row(solver: str, tolerance: float, one: Run, known: Run, enters_s: float) -> Row:
    apart, found = apart_m(one, known), stay(one)[0]
    late = None if np.isnan(found) else found - enters_s
    return Row(solver, tolerance, late, float(apart[-1]), float(apart.max()), one.spent_s)


def section(repeats: int) -> Section:
    """The section of the page."""
    return describe(measure(repeats), repeats)


def describe(found: Graze, repeats: int) -> Section:
    """What was measured, in words."""
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


def _line(row: Row) -> tuple[str, ...]:
    name = "`exact`" if row.solver == "exact" else f"`scipy`, {row.solver}"
    if row.late_s is None:
        late = "never"
    else:
        late = error(row.late_s) if row.late_s > _ROUNDING_S else "0"
    times = milliseconds(row.spent_s)
    return (name, power(row.tolerance), late, error(row.end_m), error(row.most_m), times)
