"""What a run refused: told once for each peer and kind, counted for the summary."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, final

if TYPE_CHECKING:
    from bus.lockstep.counters import MessageCounters
    from bus.transports.zenoh.access_log import AccessLogMonitor

MALFORMED = "malformed"
DENIED = "denied"
MESSAGE = "message"
"""What is refused of those who were let in; connections have names of their own."""


@final
class RejectionMonitor:
    """Watches what the plant refuses: payloads that it can't read, and what Zenoh turns away where there are keys.

    Args:
        watch: What Zenoh refuses; None where it lets anybody in.
        warn: Told of each new peer and kind, one line.
    """

    def __init__(self, watch: AccessLogMonitor | None, warn: Callable[[str], None]) -> None:
        self._watch = watch
        self._warn = warn
        self._told: set[tuple[str, str]] = set()
        self._read = 0

    def poll(self, counts: MessageCounters) -> None:
        """Tells what is new; cheap, call it every tick.

        Args:
            counts: The plant's own.
        """
        if len(counts.refused) != self._read:
            self._read = len(counts.refused)
            for whose, what in counts.refused:
                self._tell(whose, f"{what} malformed", "refused")
        if self._watch is not None and self._watch.fresh:
            for whose, what in self._watch.counted():
                self._tell(whose, what, DENIED)

    def summary_rows(self, counts: MessageCounters) -> list[Mapping[str, Any]]:
        """Everything that was refused: ``why``, ``whose``, ``what`` and ``number``.

        Args:
            counts: Those of all sides.
        """
        found = [(MALFORMED, *key, number) for key, number in sorted(counts.refused.items())]
        if self._watch is not None:
            found += [(DENIED, *key, number) for key, number in sorted(self._watch.counted().items())]
        return [dict(zip(("why", "whose", "what", "number"), row, strict=True)) for row in found]

    def _tell(self, whose: str, what: str, done: str) -> None:
        if (whose, what) not in self._told:
            self._told.add((whose, what))
            self._warn(f"{done}: {whose}: {what} (the summary has how many)")


def total(rows: Iterable[Mapping[str, Any]], why: str, what: str | None = None) -> int:
    """How many were refused for this reason, of one kind or of all."""
    return sum(row["number"] for row in rows if row["why"] == why and what in (None, row["what"]))
