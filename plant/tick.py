"""Arguments and results of the tick loop: clock, deaths, hooks, the record of a tick, the end of the loop."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple, Protocol, final

import numpy as np
from numpy.typing import NDArray

from bus.lockstep.counters import Loss
from bus.wire.frames import DriveFrame, SenseFrame
from plant.observations import Sense

if TYPE_CHECKING:
    from bus.spec import StallSpec
    from plant.observations import Event
    from plant.sampling import Timing
    from plant.wheels import LossPolicy


Floats = NDArray[np.float64]
Status = Literal["ok", "failed", "stalled"]


class TickRecord(NamedTuple):
    """Record of one complete tick.

    Attributes:
        tick: Number of the tick, from 0.
        start_ns: Simulated time of its start, ns.
        until_ns: Simulated time of its end, ns.
        sense: What the cells sensed at its start.
        wheel_speed: ``(n, 2)`` m/s at its start.
        before: ``(m, 6)`` parcel states at its start.
        drives: ``(n, 2)`` that acted during it, a dead cell's as the stall policy has it; read-only.
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
class LoopResult:
    """Result of the tick loop.

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


class LockstepPort(Protocol):
    """Side of the lockstep that the plant uses; ``bus.lockstep.Coordinator`` is one."""

    @property
    def lookahead(self) -> int:
        """Ticks by which senses may be published ahead of the drives that are gathered; at most ``drive_ticks``."""
        ...

    def publish(self, frame: SenseFrame) -> None:
        """Send every cell its senses."""
        ...

    def gather(self, tick: int) -> tuple[DriveFrame, Sequence[Loss]]:
        """Return the drives of all cells, in an array that is the caller's own, and the losses found in ``tick``."""
        ...

    def mark_dead(self, cells: Sequence[int], tick: int) -> None:
        """Expect no drives of these cells from ``tick`` on."""
        ...


@final
@dataclass(frozen=True, slots=True)
class TickHooks:
    """Callables around every tick of a run, in the order in which they are called.

    An exception in a hook ends the run between two ticks.

    Attributes:
        before_tick: Called with the next tick, before anything of it happens. The time to inject faults.
        after_tick: Called with the record of a tick that is over, before the drives of the next one are awaited.
    """

    before_tick: tuple[Callable[[int], None], ...] = ()
    after_tick: tuple[Callable[[TickRecord], None], ...] = ()

    def __add__(self, other: TickHooks) -> TickHooks:
        return TickHooks(self.before_tick + other.before_tick, self.after_tick + other.after_tick)


@final
@dataclass(frozen=True, slots=True)
class RunClock:
    """Simulated time of a run, and its pace.

    Attributes:
        tick_ns: Length of a tick, ns: the cells' control period, or the window that an exchange serves.
        duration_ns: Length of the run, ns.
        timing: Asked in the order of ticks where cells have clocks of their own: when in a tick the drives act, and
            when cells read the senses that the next tick sends. An instant may lie beyond the end of the run.
        pace: Called with a tick's start, ns, before the tick begins; may wait.
        drive_ticks: Ticks after which a drive acts, counted from the senses of which it was computed.
    """

    tick_ns: int
    duration_ns: int
    timing: Callable[[int], Timing] | None = None
    pace: Callable[[int], None] | None = None
    drive_ticks: int = 0


@final
@dataclass(frozen=True, slots=True)
class DeathPolicy:
    """Scheduled deaths, and the consequences of deaths of any kind.

    Attributes:
        schedule: Indices of the cells that die for good at the start of a tick, by tick.
        stall: Policy for the wheels of dead cells.
        wheel_policies: Policy of a cell that dies as scheduled, by index, where it is not ``stall``'s.
        stops_on_failure: Whether a program that fails ends the run, whatever ``stall`` says.
    """

    schedule: Mapping[int, tuple[int, ...]]
    stall: StallSpec
    wheel_policies: Mapping[int, LossPolicy] | None = None
    stops_on_failure: bool = False
