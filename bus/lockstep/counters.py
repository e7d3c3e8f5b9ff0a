"""What the lockstep counts, and whom it lost."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final, Literal, final

from bus.errors import WireError
from bus.wire.frames import TALLY_LIMIT

_REFUSED: Final = "malformed "
"""Begins the names of what was refused, in a report's tally."""

Reason = Literal["token lost", "stalled", "failed"]


@final
@dataclass(slots=True)
class MessageCounters:
    """Payloads of one side of a run, or of all sides together.

    Attributes:
        sent: Put, once for every shard that it is for.
        delivered: Taken in, each once.
        lost: Waited for and given up.
        late: Of a tick that was over, or of a cell given up before.
        refused: Refused because they couldn't be read, by whose key they were put on and name of the error.
        tally: What the cells counted themselves, by name.
    """

    sent: int = 0
    delivered: int = 0
    lost: int = 0
    late: int = 0
    refused: Counter[tuple[str, str]] = field(default_factory=Counter[tuple[str, str]])
    cell_counters: Counter[str] = field(default_factory=Counter[str])

    @property
    def malformed(self) -> Counter[str]:
        """Those refused, by name of the error."""
        found: Counter[str] = Counter()
        for (_, name), number in self.refused.items():
            found[name] += number
        return found

    def refuse(self, error: WireError, whose: str) -> None:
        """Counts a payload that couldn't be read."""
        self.refused[whose, error.name] += 1

    def to_report(self, tally: Mapping[str, int]) -> tuple[tuple[str, int], ...]:
        """What a report's tally says: what the cells counted, and what was refused as far as there is room."""
        refused = [(f"{_REFUSED}{whose}: {name}", number) for (whose, name), number in self.refused.items()]
        fitting = [pair for pair in refused if len(pair[0]) <= TALLY_LIMIT]
        return (*tally.items(), *fitting)[:TALLY_LIMIT]

    @classmethod
    def from_report(
        cls, counts: tuple[int, int, int, int], tally: Iterable[tuple[str, int]]
    ) -> MessageCounters:
        """From a report: the other way round."""
        own, refused = Counter[str](), Counter[tuple[str, str]]()
        for name, number in tally:
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
