"""What a campaign came to: for programs as JSON and CSV."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

from deploy.files import write_text

if TYPE_CHECKING:
    from deploy.campaign.asked import Asked
    from deploy.campaign.cases import Cases
    from deploy.campaign.outcome import Outcome
    from deploy.campaign.rows import Row

JSON_NAME = "campaign.json"
CSV_NAME = "campaign.csv"


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """A campaign that is over, or was interrupted.

    Attributes:
        status: ``ok``, ``failed`` (no run came to its end) or ``interrupted``.
        reason: Why not ``ok``; empty where it is.
        asked: What was asked for.
        cases: What was run.
        outcomes: Of the runs that are over, by the case's number and the seed.
        rows: Of these, in the order of the grid.
        folder: With everything that the campaign leaves behind.
    """

    status: str
    reason: str
    asked: Asked
    cases: Cases
    outcomes: dict[tuple[int, int], Outcome]
    rows: Sequence[Row]
    folder: Path

    def failed(self) -> Iterator[tuple[dict[str, Any], int, Outcome]]:
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
            "scene": self.asked.scene,
            "fault": self.asked.fault,
            "varied": {axis.key: axis.values for axis in self.cases.axes},
            "seeds": self.cases.seeds,
            "against": _against(self.asked),
            "criterion": criterion_words(self.cases),
            "within_m": self.cases.cases[0].criterion.within_m,
            "confidence": self.asked.confidence,
            "runs": len(self.outcomes),
            "failed": failed,
            "rows": [row.as_json() for row in self.rows],
        }
        return json.dumps(content, indent=indent, allow_nan=False, ensure_ascii=False, default=str)

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
    told = [case.criterion.words() for case in cases.cases]
    return told[0] if len(set(told)) == 1 else f"{told[0]}; varied from case to case"


def _against(asked: Asked) -> str | None:
    """What runs are compared with, in words; None: with nothing."""
    parts = ["without the fault"] if asked.fault else []
    parts += [f"with {one}" for one in asked.against]
    return ", ".join(parts) or None
