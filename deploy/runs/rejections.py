"""Rejections of a run: malformed and denied messages, with one warning for each peer and kind."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, final

if TYPE_CHECKING:
    from bus.lockstep.counters import MessageCounters
    from bus.transports.zenoh.access_log import AccessLogMonitor

MALFORMED = "malformed"
DENIED = "denied"
MESSAGE = "message"
"""Kind of a denied message from an accepted peer; denied connections have other kinds."""


@final
class RejectionMonitor:
    """Monitor of malformed payloads, and of messages and connections that Zenoh denies.

    Args:
        watch: Monitor of Zenoh's denials; None without access control.
        warn: Called with one line for each new peer and kind.
    """

    def __init__(self, watch: AccessLogMonitor | None, warn: Callable[[str], None]) -> None:
        self._watch = watch
        self._warn = warn
        self._reported: set[tuple[str, str]] = set()
        self._read = 0

    def poll(self, counts: MessageCounters) -> None:
        """Warn of new peers and kinds; cheap enough to call in every tick.

        Args:
            counts: Counters of the plant's side.
        """
        if len(counts.refused) != self._read:
            self._read = len(counts.refused)
            for whose, what in counts.refused:
                self._report(whose, f"{what} malformed", "refused")
        if self._watch is not None and self._watch.fresh:
            for whose, what in self._watch.counted():
                self._report(whose, what, DENIED)

    def summary_rows(self, counts: MessageCounters) -> list[Mapping[str, Any]]:
        """Return all rejections as rows of ``why``, ``whose``, ``what`` and ``number``.

        Args:
            counts: Counters of all sides.
        """
        found = [(MALFORMED, *key, number) for key, number in sorted(counts.refused.items())]
        if self._watch is not None:
            found += [(DENIED, *key, number) for key, number in sorted(self._watch.counted().items())]
        return [dict(zip(("why", "whose", "what", "number"), row, strict=True)) for row in found]

    def _report(self, whose: str, what: str, done: str) -> None:
        if (whose, what) not in self._reported:
            self._reported.add((whose, what))
            self._warn(f"{done}: {whose}: {what} (the summary has the number)")


def total(rows: Iterable[Mapping[str, Any]], why: str, what: str | None = None) -> int:
    """Return the number of rejections for a reason, of one kind or of all."""
    return sum(row["number"] for row in rows if row["why"] == why and what in (None, row["what"]))
