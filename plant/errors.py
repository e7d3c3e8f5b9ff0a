"""Errors of the plant."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from plant.observations import Event, Trajectory


class PlantError(Exception):
    """The plant refuses what it was given; the text names the field, the rule and the value."""


class PlantHalted(PlantError):
    """A call of the plant ended early. The plant is where all parcels were last known; it can't go on.

    Args:
        text: why.
        time_s: simulated time at which it ended, s.

    Attributes:
        time_s: as given.
        events: what happened on the way of the call, of parcels that came farther too.
        reached: the trajectory up to the last sample before the end, of a call that samples; None of any other.
    """

    def __init__(self, text: str, time_s: float = 0.0) -> None:
        super().__init__(text)
        self.time_s = time_s
        self.events: Sequence[Event] = ()
        self.reached: Trajectory | None = None


class PlantUnstable(PlantHalted):
    """The motion can't be followed any further; the text says which parcel, where, when and why."""


class PlantStopped(PlantHalted):
    """The end of the call was requested; see ``plant.stop``."""
