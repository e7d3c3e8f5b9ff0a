"""What the plant's process tells those who look on: what happened in a tick, and how the run ended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from bus.counts import Loss
    from plant.reports import Event, Sense

Floats = NDArray[np.float64]
Status = Literal["ok", "failed", "stalled"]


class TickRecord(NamedTuple):
    """All that happened in one tick.

    Attributes:
        tick: Which, from 0.
        start_ns: When it began.
        until_ns: When it ended.
        sense: What the cells sensed at its start.
        wheel_speed: ``(n, 2)`` m/s at its start.
        before: ``(m, 6)`` parcel states at its start.
        drives: ``(n, 2)`` that acted during it, a dead cell's as the stall policy has it.
        after: ``(m, 6)`` parcel states at its end.
        events: Of the plant, during it.
        died: Indices of the cells whose scheduled death for good was at its start.
        losses: Cells that were found lost in it.
    """

    tick: int
    start_ns: int
    until_ns: int
    sense: Sense
    wheel_speed: Floats
    before: Floats
    drives: Floats
    after: Floats
    events: Sequence[Event]
    died: tuple[int, ...]
    losses: Sequence[Loss]


@final
@dataclass(frozen=True, slots=True)
class Ended:
    """How the loop ended.

    Attributes:
        status: ``ok`` at the end of the duration; ``failed`` or ``stalled`` where the policy is ``abort``; ``failed``
            where a program failed and that ends the run, and where no cell is left at the end.
        losses: Cells found lost in the tick in which it ended.
        died: Cells whose scheduled death it was aborted for, for good or until they are repaired.
        failed: Of the losses, the cells whose program failed, where that ended it.
        nobody: Whether no cell was left at the end of the duration, though the scene did not order it.
    """

    status: Status
    losses: tuple[Loss, ...] = ()
    died: tuple[int, ...] = ()
    failed: tuple[Loss, ...] = ()
    nobody: bool = False
