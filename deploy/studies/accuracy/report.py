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
    repeats: int | None = None
    speed: float | None = None
    effort: int | None = None


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

    def cheapest(self, target_m: float) -> AccuracyRow | None:
        """The row of least wall time whose error over the run is no larger than a target."""
        good = [row for row in self.rows if row.error_max is not None and row.error_max <= target_m]
        return min(good, key=lambda row: row.wall_s or 0.0, default=None)

    def most_accurate(self) -> AccuracyRow | None:
        """The row of least error."""
        judged = [row for row in self.rows if row.error_max is not None]
        return min(judged, key=lambda row: row.error_max or 0.0, default=None)

    def as_json(self) -> dict[str, Any]:
        """Everything, in JSON's types."""
        return {
            "scene": self.scene,
            "duration_s": self.duration_s,
            "cells": self.cells,
            "parcels": self.parcels,
            "period_s": self.period_s,
            "quick": self.quick,
            "versions": versions(),
            "reference": reference_json(self.reference),
            "rows": [asdict(row) for row in self.rows],
            "sampling": [asdict(one) for one in self.sampling],
        }

    def to_json(self) -> str:
        """`as_json` as text."""
        return json.dumps(self.as_json(), indent=2, allow_nan=False)

    def to_csv(self) -> str:
        """The rows as CSV, a header first; what there is none of is empty."""
        text = io.StringIO()
        names = [field.name for field in fields(AccuracyRow)]
        table = csv.DictWriter(text, names, lineterminator="\n")
        table.writeheader()
        table.writerows(asdict(row) for row in self.rows)
        return text.getvalue()


def versions() -> dict[str, str]:
    """Return the versions of Python and of the installed numerical packages."""
    found = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
