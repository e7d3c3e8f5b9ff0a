"""Results of an accuracy study as data, for tables, JSON, CSV and plots."""

from __future__ import annotations

import csv
import io
import json
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from importlib.metadata import PackageNotFoundError, version
from typing import Any, final

from deploy.studies.accuracy.reference import Reference
from deploy.studies.accuracy.reference import as_json as reference_json

TARGETS_M = (1e-3, 1e-6, 1e-9, 1e-12)
"""Targets of the verdict."""
FEWEST_REPEATS = 3
"""Runs that show the noise of a wall time."""
UNKNOWN_NOISE = 0.2
"""Noise of a wall time of fewer runs, as a share of it."""
MANY_REPEATS = 5
"""Runs of which the longest is taken for disturbed."""
LEAST_NOISE = 0.05
"""Share by which wall times of equal runs differ at least."""
_PACKAGES = ("mdms-emulator", "numpy", "numba", "scipy", "heyoka")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class AccuracyRow:
    """Result of a solver at one setting; unavailable values are None.

    Attributes:
        solver: its name.
        line: the solver, and which of its sweeps where it has several.
        setting: in words.
        key: what is swept: ``tolerance`` or ``step_s``.
        value: of it.
        status: ``ok``; ``unstable``, ``failed``, ``stopped`` (took longer than it may); ``omitted``.
        reason: why it is not ``ok``.
        note: what a reader of its error must know.
        library: function of a library that the solver's adapter calls between events.
        judged_by: the solver whose trace is the reference of this row.
        error_max: largest displacement of any corner of a footprint over the run, m.
        error_end: at the end, m.
        error_before: over the time before events differ in kind or order, and before chatter, m.
        event_time_error: largest error in time of an event that was found, s.
        events_found: events of the reference that were found.
        events_missed: those that were not.
        events_invented: events that the reference has not.
        order_until: up to when events came in the order of the reference's, s; None: to the end of the comparison.
        speed_distance: from then on, distance of the distributions of corners' speeds (Kolmogorov and Smirnov), 0 to 1.
        wall_s: median wall time of the runs, without building the plant.
        wall_low_s: the shortest.
        wall_high_s: the longest.
        noise_low_s: lower bound of the range in which the wall time is uncertain: see `noise_s`.
        noise_high_s: upper bound.
        relative: ``wall_s`` over that of the fastest row.
        solver_s: median processor time within calls of the solver, without sampling and bookkeeping.
        solver_low_s: the shortest.
        solver_high_s: the longest.
        repeats: how many runs were timed.
        speed: simulated seconds a wall second.
        effort: steps, or right-hand sides with ``scipy``.
    """

    solver: str
    line: str
    setting: str
    key: str
    value: float | None
    status: str
    reason: str | None = None
    note: str | None = None
    library: str | None = None
    judged_by: str | None = None
    error_max: float | None = None
    error_end: float | None = None
    error_before: float | None = None
    event_time_error: float | None = None
    events_found: int | None = None
    events_missed: int | None = None
    events_invented: int | None = None
    order_until: float | None = None
    speed_distance: float | None = None
    wall_s: float | None = None
    wall_low_s: float | None = None
    wall_high_s: float | None = None
    noise_low_s: float | None = None
    noise_high_s: float | None = None
    relative: float | None = None
    solver_s: float | None = None
    solver_low_s: float | None = None
    solver_high_s: float | None = None
    repeats: int | None = None
    speed: float | None = None
    effort: int | None = None


def noise_s(walls_s: Sequence[float]) -> tuple[float, float]:
    """Range in which a wall time is uncertain, s.

    It reaches from the shortest run to the longest, without the longest of many, and is wider by what the clock rate
    and caches make of equal runs. A time measured too rarely is uncertain by a share of it.
    """
    if len(walls_s) < FEWEST_REPEATS:
        return (1.0 - UNKNOWN_NOISE) * min(walls_s), (1.0 + UNKNOWN_NOISE) * max(walls_s)
    rising = sorted(walls_s)
    longest = rising[-2] if len(rising) >= MANY_REPEATS else rising[-1]
    return (1.0 - LEAST_NOISE) * rising[0], (1.0 + LEAST_NOISE) * longest


def tied(one: AccuracyRow, other: AccuracyRow) -> bool:
    """Whether the wall times of two rows can't be told apart: the ranges in which they are uncertain overlap."""
    if one.noise_low_s is None or one.noise_high_s is None:
        return False
    if other.noise_low_s is None or other.noise_high_s is None:
        return False
    return one.noise_low_s <= other.noise_high_s and other.noise_low_s <= one.noise_high_s


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """Cheapest solver and setting for a target.

    Attributes:
        target_m: Largest error, m.
        row: The row that reaches the target with the least wall time. Of its line's settings whose times can't be told
            apart, the loosest.
        ties: Further rows that reach the target, in times that can't be told apart from the least.
        following: The fastest row of another solver that reaches the target and doesn't tie; None without one.
    """

    target_m: float
    row: AccuracyRow
    ties: Sequence[AccuracyRow]
    following: AccuracyRow | None


@final
@dataclass(frozen=True, slots=True)
class Sampled:
    """Result of the whole system, including cells and messages, at one control period.

    Attributes:
        period_s: of control.
        error_max: largest displacement of any corner at the instants that all periods share, m.
        wall_s: what the run took, without start-up.
        status: of the run.
        reason: why it is not ``ok``.
    """

    period_s: float
    error_max: float | None
    wall_s: float | None
    status: str
    reason: str | None = None


@final
@dataclass(frozen=True, slots=True)
class Sampling:
    """Sampling cost for one kind of wheels.

    Attributes:
        wheels: what turns them, in words.
        against: what errors are measured from, in words.
        rows: from the longest period to the shortest.
    """

    wheels: str
    against: str
    rows: Sequence[Sampled]


@final
@dataclass(frozen=True, slots=True)
class AccuracyReport:
    """Complete results of an accuracy study.

    Attributes:
        scene: its name.
        title: its title.
        duration_s: simulated time.
        cells: how many.
        parcels: how many.
        period_s: between samples.
        quick: whether only some settings were tried.
        reference: what solvers were judged by.
        rows: line by line, coarse to fine.
        sampling: the price of sampling; none where it was not requested.
    """

    scene: str
    title: str
    duration_s: float
    cells: int
    parcels: int
    period_s: float
    quick: bool
    reference: Reference
    rows: Sequence[AccuracyRow]
    sampling: Sequence[Sampling]

    @property
    def lines(self) -> list[str]:
        """The lines that rows belong to, each once, in their order."""
        return list(dict.fromkeys(row.line for row in self.rows))

    @property
    def adapters(self) -> dict[str, str]:
        """Library function that each solver with an adapter calls, by solver."""
        return {row.solver: row.library for row in self.rows if row.library and row.error_max is not None}

    def cheapest(self, target_m: float) -> Choice | None:
        """Choose the cheapest solver and setting whose error over the run is no larger than a target, m.

        Of several settings of a solver whose times can't be told apart, the loosest is chosen: a finer one is not
        cheaper, but only happened to be faster in these runs.
        """
        good = [row for row in self.rows if row.error_max is not None and row.error_max <= target_m]
        fastest = min(good, key=_wall_s, default=None)
        if fastest is None:
            return None
        ties = [row for row in good if row is fastest or tied(row, fastest)]
        chosen = max((row for row in ties if row.line == fastest.line), key=lambda row: row.value or 0.0)
        others = [row for row in good if row.solver != chosen.solver and row not in ties]
        return Choice(
            target_m=target_m,
            row=chosen,
            ties=[row for row in ties if row is not chosen],
            following=min(others, key=_wall_s, default=None),
        )

    def verdict(self) -> list[Choice]:
        """Choices for usual targets, from coarse to fine, as far as one is reached."""
        found = [self.cheapest(target_m) for target_m in TARGETS_M]
        return [choice for choice in found if choice is not None]

    def most_accurate(self) -> AccuracyRow | None:
        """The row of least error."""
        judged = [row for row in self.rows if row.error_max is not None]
        return min(judged, key=lambda row: row.error_max or 0.0, default=None)

    def as_json(self, target_m: float | None = None) -> dict[str, Any]:
        """Convert everything to JSON types, with the choice for a target, m, where there is one."""
        choice = None if target_m is None else self.cheapest(target_m)
        answer = {} if target_m is None else {"target": None if choice is None else _choice_json(choice)}
        return {
            "scene": self.scene,
            "duration_s": self.duration_s,
            "cells": self.cells,
            "parcels": self.parcels,
            "period_s": self.period_s,
            "quick": self.quick,
            "versions": versions(),
            "reference": reference_json(self.reference),
            "cheapest": [_choice_json(choice) for choice in self.verdict()],
            "rows": [asdict(row) for row in self.rows],
            "sampling": [asdict(one) for one in self.sampling],
            **answer,
        }

    def to_json(self, target_m: float | None = None) -> str:
        """`as_json` as text."""
        return json.dumps(self.as_json(target_m), indent=2, allow_nan=False)

    def to_csv(self) -> str:
        """The rows as CSV, a header first; what there is none of is empty."""
        text = io.StringIO()
        names = [field.name for field in fields(AccuracyRow)]
        table = csv.DictWriter(text, names, lineterminator="\n")
        table.writeheader()
        table.writerows(asdict(row) for row in self.rows)
        return text.getvalue()


def _wall_s(row: AccuracyRow) -> float:
    return row.wall_s or 0.0


def _choice_json(choice: Choice) -> dict[str, Any]:
    row = choice.row
    return {
        "target_m": choice.target_m,
        "solver": row.solver,
        "setting": row.setting,
        "error_max": row.error_max,
        "wall_s": row.wall_s,
        "ties": [{"solver": one.solver, "setting": one.setting, "wall_s": one.wall_s} for one in choice.ties],
    }


def versions() -> dict[str, str]:
    """Return the versions of Python and of the installed numerical packages."""
    found = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
