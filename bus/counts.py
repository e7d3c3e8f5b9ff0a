"""What the lockstep counts, and whom it lost."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Literal, final

from bus.errors import WireError

Reason = Literal["token lost", "stalled", "failed"]


@final
@dataclass(slots=True)
class Counts:
    """Payloads of one side of a run, or of all sides together.

    Attributes:
        sent: Put, once for every shard that it is for.
        delivered: Taken in, each once.
        lost: Waited for and given up.
        late: Of a tick that was over, or of a cell given up before.
        malformed: Refused, by name of the error.
        tally: What the cells counted themselves, by name.
    """

    sent: int = 0
    delivered: int = 0
    lost: int = 0
    late: int = 0
    malformed: Counter[str] = field(default_factory=Counter[str])
    tally: Counter[str] = field(default_factory=Counter[str])

    def refuse(self, error: WireError) -> None:
        """Counts a payload that couldn't be read."""
        self.malformed[error.name] += 1

    def __add__(self, other: Counts) -> Counts:
        return Counts(
            self.sent + other.sent,
            self.delivered + other.delivered,
            self.lost + other.lost,
            self.late + other.late,
            self.malformed + other.malformed,
            _together(self.tally, other.tally),
        )


def _together(one: Counter[str], other: Counter[str]) -> Counter[str]:
    """The sums, zeros included, which ``+`` leaves out."""
    total = one.copy()
    total.update(other)
    return total


@final
@dataclass(frozen=True, slots=True)
class Loss:
    """A cell that went without being scheduled to.

    Attributes:
        cell: Index in the lattice.
        tick: The first tick without its drive.
        reason: Its token was lost, its drive did not come in time, or its process said that it failed.
        detail: What the process said.
    """

    cell: int
    tick: int
    reason: Reason
    detail: str = ""
