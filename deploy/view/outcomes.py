"""Outcomes of parcels among the events of a run, found once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, final

if TYPE_CHECKING:
    from deploy.view.source import RunSource

_ENDS: Final = {"tipped": "tipped", "off_array": "off the array", "left": "delivered"}
"""Events after which a parcel carries no wheel, and their names."""


@final
class Outcomes:
    """Outcome of each parcel: tipped, off the array, or delivered.

    Args:
        source: The run.
    """

    def __init__(self, source: RunSource) -> None:
        self._source = source
        self._seen = (0, 0)
        self._found: dict[int, tuple[float, str]] = {}

    def at(self, time_s: float, parcel: int) -> str | None:
        """Return the outcome of a parcel at a time; None: it has none yet."""
        events, (count, revision) = self._source.events, self._seen
        if revision != self._source.revision or count > len(events):
            self._found, count = {}, 0
        for event in events[count:]:
            if event["kind"] in _ENDS:
                self._found[int(event["parcel"])] = float(event["time_s"]), _ENDS[event["kind"]]
        self._seen = len(events), self._source.revision
        found = self._found.get(parcel)
        return found[1] if found is not None and found[0] <= time_s + 1e-12 else None
