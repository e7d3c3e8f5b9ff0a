"""Results of a campaign: statistics, JSON and CSV."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

from deploy.util.files import write_text

if TYPE_CHECKING:
    from deploy.studies.campaign.cases import Case, Cases
    from deploy.studies.campaign.result import CaseOutcome
    from deploy.studies.campaign.spec import CampaignSpec


_LEAST = 2
"""Runs, for there to be an interval."""


@final
@dataclass(frozen=True, slots=True)
class Share:
    """Share of runs with its confidence interval.

    Attributes:
        share: In [0, 1]; None of no runs.
        low: Of the interval; None of fewer than two runs.
        high: The same.
    """

    share: float | None
    low: float | None
    high: float | None


@final
@dataclass(frozen=True, slots=True)
class Mean:
    """Mean over runs with its confidence interval.

    Attributes:
        mean: None of no runs.
        low: Of the interval, >= 0; None of fewer than two runs.
        high: The same.
        runs: Over how many.
    """

    mean: float | None
    low: float | None
    high: float | None
    runs: int


def share_of(successes: int, runs: int, confidence: float) -> Share:
    """The share of successes and its Wilson score interval.

    Args:
        successes: How many of the runs.
        runs: How many there were.
        confidence: In (0, 1).

    Source: Wilson, "Probable inference, the law of succession, and statistical inference", JASA 22 (1927).
    """
    if runs < _LEAST:
        return Share(successes / runs if runs else None, None, None)
    stats: Any = import_module("scipy.stats")  # it has no types
    found = stats.binomtest(successes, runs).proportion_ci(confidence, "wilson")
    return Share(successes / runs, float(found.low), float(found.high))


def mean_of(values: Sequence[float], confidence: float) -> Mean:
    """The mean of what can't be negative, and its Student t interval, cut off at 0.

    Args:
        values: Finite, >= 0.
        confidence: In (0, 1).
    """
    runs = len(values)
    if not runs:
        return Mean(None, None, None, 0)
    mean = math.fsum(values) / runs
    if runs < _LEAST:
        return Mean(mean, None, None, runs)
    variance = math.fsum((value - mean) ** 2 for value in values) / (runs - 1)
    special: Any = import_module("scipy.special")
    half = float(special.stdtrit(runs - 1, 0.5 + 0.5 * confidence)) * math.sqrt(variance / runs)
    return Mean(mean, max(0.0, mean - half), mean + half, runs)


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignRow:
    """Aggregated results of one case.

    Attributes:
        values: What is varied, by key.
        runs: That are over.
        failed: Runs whose status isn't ``ok``.
        cells_lost: In all runs together, of cells without a fault.
        succeeded: See ``deploy.studies.campaign.result.judged``.
        success: Share of the runs.
        time_s: Mean over the runs that have one.
        error_m: The same.
    """

    values: Mapping[str, Any]
    runs: int
    failed: int
    cells_lost: int
    succeeded: int
    success: Share
    time_s: Mean
    error_m: Mean

    def as_json(self) -> dict[str, Any]:
        """In JSON's types."""
        return asdict(self)


def aggregate(
    cases: Cases, outcomes: Mapping[tuple[int, int], CaseOutcome], confidence: float
) -> Iterator[CampaignRow]:
    """A row a case, in the order of the grid.

    Args:
        cases: The campaign's.
        outcomes: Of the runs that are over, by the case's number and the seed.
        confidence: Of the intervals.
    """
    for case in cases.cases:
        found = [outcomes[case.number, seed] for seed in cases.seeds if (case.number, seed) in outcomes]
        yield _row(case, found, confidence)


def _row(case: Case, outcomes: Sequence[CaseOutcome], confidence: float) -> CampaignRow:
    succeeded = sum(one.succeeded for one in outcomes)
    return CampaignRow(
        values=case.values,
        runs=len(outcomes),
        failed=sum(one.status != "ok" for one in outcomes),
        cells_lost=sum(one.cells_lost for one in outcomes),
        succeeded=succeeded,
        success=share_of(succeeded, len(outcomes), confidence),
        time_s=mean_of([one.time_s for one in outcomes if one.time_s is not None], confidence),
        error_m=mean_of([one.error_m for one in outcomes if one.error_m is not None], confidence),
    )


JSON_NAME = "campaign.json"
CSV_NAME = "campaign.csv"


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignReport:
    """Report of a completed or interrupted campaign.

    Attributes:
        status: ``ok``, ``failed`` (no run came to its end) or ``interrupted``.
        reason: Why not ``ok``; empty where it is.
        spec: Specification of the campaign.
        cases: What was run.
        outcomes: Of the runs that are over, by the case's number and the seed.
        rows: Of these, in the order of the grid.
        folder: With everything that the campaign leaves behind.
    """

    status: str
    reason: str
    spec: CampaignSpec
    cases: Cases
    outcomes: dict[tuple[int, int], CaseOutcome]
    rows: Sequence[CampaignRow]
    folder: Path

    def failed(self) -> Iterator[tuple[dict[str, Any], int, CaseOutcome]]:
        """Values, seed and outcome of every run whose status isn't ``ok``, in the order of the grid."""
        for case in self.cases.cases:
            for seed in self.cases.seeds:
                outcome = self.outcomes.get((case.number, seed))
                if outcome is not None and outcome.status != "ok":
                    yield case.values, seed, outcome

    def to_json(self, indent: int | None = None) -> str:
        """The JSON object as text; nothing in it depends on how fast, where or in how many goes the runs were done."""
        failed = [
            {"values": values, "seed": seed, "status": one.status, "reason": one.reason}
            for values, seed, one in self.failed()
        ]
        content = {
            "status": self.status,
            "reason": self.reason or None,
            "scene": self.spec.scene,
            "fault": self.spec.fault,
            "varied": {axis.key: axis.values for axis in self.cases.axes},
            "seeds": self.cases.seeds,
            "against": _against(self.spec),
            "criterion": criterion_words(self.cases),
            "within_m": self.cases.cases[0].criterion.within_m,
            "confidence": self.spec.confidence,
            "runs": len(self.outcomes),
            "failed": failed,
            "rows": [row.as_json() for row in self.rows],
        }
        return json.dumps(content, indent=indent, allow_nan=False, default=str)

    def to_csv(self) -> str:
        """A line a case."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        spans = [
            f"{name}_{part}" for name in ("success", "time_s", "error_m") for part in ("", "low", "high")
        ]
        names = [name.rstrip("_") for name in spans]
        counts = ["runs", "failed", "succeeded"]
        writer.writerow([*(axis.key for axis in self.cases.axes), *counts, *names])
        for row in self.rows:
            share, time, error = row.success, row.time_s, row.error_m
            writer.writerow(
                [
                    *row.values.values(),
                    *(row.runs, row.failed, row.succeeded),
                    *(share.share, share.low, share.high),
                    *(time.mean, time.low, time.high),
                    *(error.mean, error.low, error.high),
                ]
            )
        return text.getvalue()

    def write(self) -> None:
        """Write ``campaign.json`` and ``campaign.csv``, each whole or not at all.

        Raises:
            DeployError: One can't be written.
        """
        write_text(self.folder / JSON_NAME, self.to_json(indent=2) + "\n")
        write_text(self.folder / CSV_NAME, self.to_csv())


def criterion_words(cases: Cases) -> str:
    """Demands on a success, in one line; those of the first case where a varied value changes them."""
    descriptions = [case.criterion.words() for case in cases.cases]
    return descriptions[0] if len(set(descriptions)) == 1 else f"{descriptions[0]}; varied from case to case"


def _against(spec: CampaignSpec) -> str | None:
    """Describe the baseline that runs are compared with; None without a baseline."""
    parts = ["without the fault"] if spec.fault else []
    parts += [f"with {one}" for one in spec.against]
    return ", ".join(parts) or None
