"""Base class and common types of all scene specifications."""

from __future__ import annotations

from typing import Annotated, Literal, final

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Vector = tuple[Finite, Finite]
CellName = tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=0)]]
"""``[row, column]``."""


class Spec(BaseModel):
    """Base of every part of a scene and of every firmware's parameters: frozen, unknown keys refused.

    pydantic builds a part's validator at its first use. Most parts are validated within the scene alone.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True, defer_build=True)


MOST_TICKS = 64
"""Longest latency of a run's messages, ticks."""


@final
class BusSpec(Spec):
    """Latency of the messages as part of the model: with it, plant and cells may run ahead of each other.

    The results depend on these numbers alone, not on how long messages really take.
    """

    sense_to_drive_ticks: Annotated[int, Field(ge=0, le=MOST_TICKS)] = 0
    """Ticks after which a drive acts: the one computed from the senses of tick k acts in k plus this many."""
    link_ticks: Annotated[int, Field(ge=1, le=MOST_TICKS)] = 1
    """Ticks after which neighbours read a message: one sent in tick k is read in k plus this many."""

    def lookahead(self, *, talks: bool) -> int:
        """Return how many ticks the plant runs ahead of the drives that it has.

        No more than ``link_ticks - 1``: then no cell has read a message of the tick in which a loss is found, and all
        neighbours of the lost cell agree on the last tick whose messages count.

        Args:
            talks: Whether cells send messages.
        """
        return min(self.sense_to_drive_ticks, self.link_ticks - 1) if talks else self.sense_to_drive_ticks


NO_LATENCY = BusSpec()
"""A drive acts in the tick of its senses, and a message is read in the next."""


Seconds = Annotated[float, Field(gt=0, le=86_400, allow_inf_nan=False)]


@final
class StallSpec(Spec):
    """Handling of cells that disconnect or stall: deadlines, and the policy for their wheels.

    The deadlines are wall time: a run that meets one is recorded as such and its digest promises nothing.
    """

    policy: Literal["coast", "brake", "hold", "abort"] = "coast"
    """Behaviour of a dropped cell's wheels; or ``abort``: end the run."""
    deadline_s: Seconds = 5.0
    """Wall seconds a tick may wait for a cell before the cell counts as stalled."""
    lease_s: Annotated[float, Field(ge=0.1, le=86_400, allow_inf_nan=False)] = 2.0
    """Wall seconds of silence after which a process counts as lost, because it is stopped or its link is cut."""
    start_s: Seconds = 30.0
    """Wall seconds within which every cell must be ready."""
