"""Message counters of the lockstep, and records of lost cells."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final, Literal, final

from bus.errors import WireError
from bus.wire.frames import COUNTER_LIMIT

_REFUSED: Final = "malformed "
"""Begins the names of what was refused, in a report's counters."""

Reason = Literal["disconnected", "timed_out", "failed"]


@final
@dataclass(slots=True)
class MessageCounters:
    """Payloads of one side of a run, or of all sides together.

    Attributes:
        sent: Put, once for every shard that it is for.
        delivered: Received and accepted, each once.
        lost: Expected and given up.
        late: Received for a finished tick, or from a dropped cell.
        refused: Refused as malformed, by owner of the key and name of the error.
        cell_counters: Counters of the cells, by name.
    """

    sent: int = 0
    delivered: int = 0
    lost: int = 0
    late: int = 0
    refused: Counter[tuple[str, str]] = field(default_factory=Counter[tuple[str, str]])
    cell_counters: Counter[str] = field(default_factory=Counter[str])

    @property
    def malformed(self) -> Counter[str]:
        """Number of refused payloads by name of the error."""
        found: Counter[str] = Counter()
        for (_, name), number in self.refused.items():
            found[name] += number
        return found

    def refuse(self, error: WireError, whose: str) -> None:
        """Count a refused payload."""
        self.refused[whose, error.name] += 1

    def to_report(self, cell_counters: Mapping[str, int]) -> tuple[tuple[str, int], ...]:
        """Return the counters of a report: the cells' counters, then refused payloads as far as there is room."""
        refused = [(f"{_REFUSED}{whose}: {name}", number) for (whose, name), number in self.refused.items()]
        fitting = [pair for pair in refused if len(pair[0]) <= COUNTER_LIMIT]
        return (*cell_counters.items(), *fitting)[:COUNTER_LIMIT]

    @classmethod
    def from_report(
        cls, counts: tuple[int, int, int, int], cell_counters: Iterable[tuple[str, int]]
    ) -> MessageCounters:
        """Return the counters that ``to_report`` encoded."""
        own, refused = Counter[str](), Counter[tuple[str, str]]()
        for name, number in cell_counters:
            whose, colon, error = name.removeprefix(_REFUSED).partition(": ")
            if name.startswith(_REFUSED) and colon:
                refused[whose, error] += number
            else:
                own[name] += number
        return cls(*counts, refused=refused, cell_counters=own)

    def __add__(self, other: MessageCounters) -> MessageCounters:
        return MessageCounters(
            self.sent + other.sent,
            self.delivered + other.delivered,
            self.lost + other.lost,
            self.late + other.late,
            self.refused + other.refused,
            _summed(self.cell_counters, other.cell_counters),
        )


def _summed(one: Counter[str], other: Counter[str]) -> Counter[str]:
    """The sums, zeros included, which ``+`` leaves out."""
    total = one.copy()
    total.update(other)
    return total


@final
@dataclass(frozen=True, slots=True)
class Loss:
    """A cell that was lost without a scheduled death.

    Attributes:
        cell: Index in the lattice.
        tick: The first tick without its drive.
        reason: The token was lost, the drive did not arrive in time, or the process reported a failure.
        detail: Detail of the reported failure.
    """

    cell: int
    tick: int
    reason: Reason
    detail: str = ""
