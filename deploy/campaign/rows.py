"""What the runs of each case come to, taken together."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, final

from deploy.campaign.statistics import Mean, Share, mean_of, share_of

if TYPE_CHECKING:
    from deploy.campaign.cases import Case, Cases
    from deploy.campaign.outcome import Outcome


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One case.

    Attributes:
        values: What is varied, by key.
        runs: That are over.
        failed: Runs whose status isn't ``ok``.
        cells_lost: In all runs together, though no fault struck them.
        succeeded: See ``deploy.campaign.outcome.judged``.
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


def rows_of(cases: Cases, outcomes: Mapping[tuple[int, int], Outcome], confidence: float) -> Iterator[Row]:
    """A row a case, in the order of the grid.

    Args:
        cases: The campaign's.
        outcomes: Of the runs that are over, by the case's number and the seed.
        confidence: Of the intervals.
    """
    for case in cases.cases:
        found = [outcomes[case.number, seed] for seed in cases.seeds if (case.number, seed) in outcomes]
        yield _row(case, found, confidence)


def _row(case: Case, outcomes: Sequence[Outcome], confidence: float) -> Row:
    succeeded = sum(one.succeeded for one in outcomes)
    return Row(
        values=case.values,
        runs=len(outcomes),
        failed=sum(one.status != "ok" for one in outcomes),
        cells_lost=sum(one.cells_lost for one in outcomes),
        succeeded=succeeded,
        success=share_of(succeeded, len(outcomes), confidence),
        time_s=mean_of([one.time_s for one in outcomes if one.time_s is not None], confidence),
        error_m=mean_of([one.error_m for one in outcomes if one.error_m is not None], confidence),
    )
