"""Events and faults of a run, as the page lists and marks them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from deploy.faults.records import OUT

if TYPE_CHECKING:
    from deploy.view.channel import PageChannel
    from deploy.view.source import RunSource

_MOST: Final = 2_000
"""Most events of a recording that are listed, the newest; with more the page would become slow."""
_MOST_LIVE: Final = 300
"""Most events of a run in progress that are listed: they are sent again and again."""
_INTERVAL_S: Final = 1.0
"""Interval at which the events of a run in progress are sent, wall seconds."""
_MARKS: Final = 1_000
"""Most marks of events: about one a pixel."""


@final
class EventList:
    """Rows of the event list and marks of the timeline, sent when there are more of them.

    Args:
        source: The run.
    """

    def __init__(self, source: RunSource) -> None:
        self._source = source
        self._sent: tuple[int, int, int] | None = None
        self._sent_s = -np.inf
        self._marks: dict[int, float] = {}
        self._marked = 0
        self._width_s = 0.0

    def send(self, channel: PageChannel, now_s: float) -> None:
        """Send rows and marks, if there are others than before; ``now_s``: wall time."""
        source = self._source
        counts = (len(source.events), len(source.faults), source.revision)
        soon = self._sent is not None and now_s - self._sent_s < _INTERVAL_S
        if counts == self._sent or (soon and self._sent is not None and counts[1] == self._sent[1]):
            return
        self._sent, self._sent_s = counts, now_s
        most = _MOST_LIVE if source.live else _MOST
        rows = [_event_row(event) for event in source.events[-most:]]
        rows += [_fault_row(fault) for fault in source.faults[-most:]]
        rows.sort(key=lambda row: row["time_s"])
        channel.events = {
            "rows": rows,
            "left_out": max(0, counts[0] + counts[1] - len(rows)),
            "marks": {"event": self._event_marks(), "fault": self._fault_marks()},
        }

    def _event_marks(self) -> list[float]:
        """Return the times of the marks of events, s; events close together share a mark."""
        events, times = self._source.events, self._source.times_s
        width_s = 2.0 ** np.ceil(np.log2(max(float(times[-1]) if len(times) else 0.0, 1e-6) / _MARKS))
        if width_s != self._width_s or self._marked > len(events):  # a run grows: marks are made again seldom
            self._marks, self._marked, self._width_s = {}, 0, width_s
        for event in events[self._marked :]:
            self._marks.setdefault(int(event["time_s"] / width_s), float(event["time_s"]))
        self._marked = len(events)
        return list(self._marks.values())

    def _fault_marks(self) -> list[float]:
        return sorted({float(fault["time_s"]) for fault in self._source.faults})[-_MARKS:]


def _event_row(event: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row of the plant's event: time, category, text."""
    parcel = event.get("parcel")
    parts = [str(event["kind"]).replace("_", " ")]
    if parcel is not None and parcel >= 0:
        parts.append(f"parcel {parcel}")
    cells = event.get("cells") or ()
    parts += [f"cell {row},{column}" for row, column in cells[:2]]
    if event.get("detail"):
        parts.append(str(event["detail"]))
    return {"time_s": float(event["time_s"]), "kind": "event", "text": " · ".join(parts)}


def _fault_row(fault: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row of a fault or a loss."""
    cells = fault.get("cells") or ([fault["cell"]] if fault.get("cell") else [])
    named = ", ".join(f"{row},{column}" for row, column in cells[:3]) + (", …" if len(cells) > 3 else "")
    phase = fault.get("phase")
    word = "" if phase in (None, "happens") else " begins" if phase == "begins" else " ends"
    if fault["kind"] in OUT:
        word = " (out)" if phase == "begins" else " (back)"
    text = (
        f"{str(fault['kind']).replace('_', ' ')}{word} · cell {named}" if named else f"{fault['kind']}{word}"
    )
    return {"time_s": float(fault["time_s"]), "kind": "fault", "text": text}
