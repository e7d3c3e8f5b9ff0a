"""Warnings about parcels that tip or fall off the array, while a run goes on."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Final, final

if TYPE_CHECKING:
    from plant.observations import Event

_WORDS: Final = {"tipped": "tipped", "off_array": "fell off the array"}
"""Kinds of events that take a parcel off its wheels."""

_MOST: Final = 10
"""Parcels named one by one."""


@final
class Mishaps:
    """Warns of every parcel that tips or falls, up to a number of parcels.

    Args:
        warn: Takes one line.
    """

    def __init__(self, warn: Callable[[str], None]) -> None:
        self._warn = warn
        self._reported = 0

    def take(self, events: Iterable[Event]) -> None:
        """Warn of the mishaps among the plant's events."""
        for event in events:
            if event.kind not in _WORDS or self._reported > _MOST:
                continue
            self._reported += 1
            if self._reported > _MOST:
                self._warn(
                    "more parcels tipped or fell: see the summary for their number, and the recording for each event"
                )
                return
            x, y = event.position_m
            how = f": {event.detail}" if event.detail else ""
            self._warn(
                f"parcel {event.parcel} {_WORDS[event.kind]} at {event.time_s:.6g} s, x = {x:.4g} m, "
                f"y = {y:.4g} m{how}"
            )
