"""The asyncio agent around a shard: it waits, the shard computes, it sends."""

from __future__ import annotations

import asyncio
import threading
import traceback
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from types import TracebackType
from typing import Final, Protocol, final

import numpy as np

from bus.errors import WaitInterrupted, WireError
from bus.lockstep import Participant, TickInputs
from bus.state import save_state
from bus.transports.base import Endpoint
from bus.wire.frames import TEXT_LIMIT, Control, DriveFrame, LinkFrame, Mask
from cell_firmware.errors import FirmwareFailed
from cell_firmware.shard import BoundaryMessages, Shard, ShardOutputs


@final
@dataclass(frozen=True, slots=True)
class ShardResult:
    """Result of a shard's run.

    Attributes:
        ticks: Ticks that were stepped.
        detail: Why it stopped, in the words of who stopped it.
        failures: Cells whose firmware failed on the way.
    """

    ticks: int
    detail: str
    failures: tuple[FirmwareFailed, ...]


Inject = Callable[[Control], None]
"""Applies a control record of kind ``fault`` to the shard, before the tick in which it acts; may raise WireError."""


Hopeless = Callable[[tuple[int, int], str, str], None]
"""Called with the cell, the problem and the stack of a program that does not return and could not be interrupted."""


class Watch(Protocol):
    """Watch that ends a step of the cells' programs if it takes too long: ``with watch:`` around the step."""

    @property
    def given_up(self) -> bool:
        """Whether the step was abandoned; its result is discarded."""
        ...

    def __enter__(self) -> object:
        """The step begins."""
        ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """The step is over."""
        ...

    def close(self) -> None:
        """Stop watching."""
        ...


Watched = Callable[[Callable[[], None], Hopeless], Watch]
"""Makes the watch of an agent. The watch calls the first now and then while a step takes long, and the second where it
can't bring a program to an end. Both calls come from another thread."""


async def run(
    shard: Shard,
    member: Participant,
    endpoint: Endpoint,
    inject: Inject | None = None,
    records: tuple[type, ...] = (),
    first: int = 0,
    watched: Watched | None = None,
) -> ShardResult:
    """Run a shard tick by tick until a stop record arrives.

    The caller calls ``member.ready()`` before, and closes the member and the endpoint after. Cells with a scheduled
    death stop at their tick. A cell whose firmware fails is reported to the plant, with its traceback, and the others
    continue; the plant decides whether the run does. An error in the step itself is a failure of all cells of the
    shard, and ends the shard's run.

    Args:
        shard: The cells, before tick 0 or restored from a snapshot.
        member: The shard's participant, ready.
        endpoint: The participant's endpoint, used to wake it.
        inject: Applies fault records received during the run; None: they are ignored.
        records: Record types in the cells' states, beyond plain values.
        first: The shard's first tick.
        watched: Makes the watch that ends programs which do not return; None: no watch.

    Raises:
        CoordinatorLostError: The plant went away.
        WaitInterrupted: The endpoint was woken, which ends a run without a stop record.
        BusError: Any other error of the participant.
        asyncio.CancelledError: Cancelled; the gather thread has ended by then.
    """
    agent = _Agent(shard, member, endpoint, asyncio.get_running_loop(), inject, records, first)
    return await agent.run(watched)


@final
@dataclass(frozen=True, slots=True)
class _Trouble:
    """Failed cells of a tick, and the outputs of the other cells; None if there are none."""

    tick: int
    failures: Sequence[FirmwareFailed]
    outputs: ShardOutputs | None


@final
class _Agent:
    """One thread blocks in ``member.gather`` and hands each whole tick to the event loop with one hop.

    The tick is stepped and published in the very callback that the hop schedules: waking a task for it would
    cost another turn of the loop. The thread goes back to gathering at once; it can't overtake the loop,
    because the next tick begins only after this one's drives. A change of membership (a failure, rare)
    is handed back to the thread instead, so that only one thread changes the participant's membership.
    """

    def __init__(
        self,
        shard: Shard,
        member: Participant,
        endpoint: Endpoint,
        loop: asyncio.AbstractEventLoop,
        inject: Inject | None,
        records: tuple[type, ...],
        first: int,
    ) -> None:
        self._shard: Final = shard
        self._member: Final = member
        self._endpoint: Final = endpoint
        self._records: Final = records
        self._loop: Final = loop
        self._inject: Final = inject
        self._first: Final = first
        self._end: Final[asyncio.Future[str]] = loop.create_future()
        self._thread: Final = threading.Thread(target=self._gather, name="gather", daemon=True)
        self._stopping = False
        self._failed: _Trouble | None = None
        self._watch: Watch | None = None
        self._ticks = 0
        self._failures: list[FirmwareFailed] = []
        self._reported: set[str] = set()

    async def run(self, watched: Watched | None) -> ShardResult:
        if watched is not None:
            self._watch = watched(self._busy, self._hopeless)
        self._thread.start()
        try:
            detail = await self._end
        finally:
            if self._watch is not None:
                self._watch.close()
            self._stopping = True
            if self._thread.is_alive():
                self._endpoint.wake()
            self._thread.join()
        return ShardResult(self._ticks, detail, tuple(self._failures))

    # --- in the gather thread ---------------------------------------------------------------------

    def _gather(self) -> None:
        tick, before = self._first, np.ones(len(self._shard), dtype=np.bool_)
        try:
            while not self._stopping:
                try:
                    gathered = self._member.gather(tick)
                except WaitInterrupted:
                    if not (self._report() or self._stopping):
                        raise  # somebody else woke us, and knows why
                    continue
                if isinstance(gathered, Control):
                    self._call_in_loop(self._finish, gathered.detail)
                    return
                faults = self._member.drain_faults()
                if faults:
                    self._call_in_loop(self._apply_faults, faults)
                live = self._member.live(tick)
                changed = (live != before).any()
                self._call_in_loop(self._step, tick, gathered, live if changed else None)
                tick, before = tick + 1, live
        except Exception as error:  # noqa: BLE001 - raised again where the run is awaited
            self._call_in_loop(self._fail, error)

    def _report(self) -> bool:
        """Report failed cells to the plant, if any, then publish the outputs of the others."""
        failed, self._failed = self._failed, None
        if failed is None:
            return False
        index = dict(zip(self._shard.cells, self._shard.indices.tolist(), strict=True))
        alike: dict[str, list[int]] = {}
        for failure in failed.failures:
            alike.setdefault(_text(failure), []).append(index[failure.cell])
        for detail, cells in alike.items():
            self._member.fail(cells, failed.tick, detail)
        if failed.outputs is not None:
            self._publish(failed.tick, failed.outputs)
        return True

    def _call_in_loop(self, callback: object, *arguments: object) -> None:
        self._loop.call_soon_threadsafe(callback, *arguments)  # pyright: ignore[reportArgumentType]

    # --- in the event loop ------------------------------------------------------------------------

    def _apply_faults(self, faults: list[Control]) -> None:
        if self._end.done() or self._inject is None:
            return
        try:
            for fault in faults:
                try:
                    self._inject(fault)
                except WireError as error:
                    self._member.counters.refuse(error, "the plant")
        except Exception as error:  # noqa: BLE001 - raised again where the run is awaited
            self._fail(error)

    def _step(self, tick: int, gathered: TickInputs, live: Mask | None) -> None:
        if self._end.done():
            return
        try:
            if live is not None:  # changed since the last tick
                self._shard.retire(
                    cell for cell, lives in zip(self._shard.cells, live, strict=True) if not lives
                )
            sense, links = gathered
            heard = None if links is None else BoundaryMessages(links.sent, links.message)
            with nullcontext() if self._watch is None else self._watch:
                outputs = self._shard.step(
                    tick,
                    sense.presence,
                    sense.encoder_m,
                    heard,
                    sense.level,
                    label=sense.label,
                    camera=sense.picture,
                )
        except BaseException as error:  # noqa: BLE001 - whatever comes out of a step is its cells' failure
            self._fail_all(tick, error)
            return
        if self._watch is not None and self._watch.given_up:
            self._end.set_result("a program did not return in time")
            return
        self._ticks += 1
        if outputs.failures:
            self._trouble(_Trouble(tick, outputs.failures, outputs))
            return
        try:
            self._publish(tick, outputs)
        except Exception as error:  # noqa: BLE001 - what a program made can't be sent, shown or kept
            self._fail_all(tick, error)

    def _fail_all(self, tick: int, error: BaseException) -> None:
        """Fail all cells of the shard, as the step itself failed."""
        if isinstance(error, FirmwareFailed):
            failures = (error,)
        else:
            trace = "".join(traceback.format_exception(error))
            problem = f"{type(error).__name__}: {error}"
            failures = tuple(FirmwareFailed(cell, tick, problem, trace) for cell in self._shard.alive)
        self._trouble(_Trouble(tick, failures, None))

    def _trouble(self, trouble: _Trouble) -> None:
        """Hand the failed cells to the gather thread, which owns the participant's membership."""
        self._failures += trouble.failures
        self._failed = trouble
        self._endpoint.wake()

    def _finish(self, detail: str) -> None:
        """Finish after the gather thread has ended: report its remaining failures."""
        if self._end.done():
            return
        try:
            self._report()
        except Exception as error:  # noqa: BLE001 - raised again where the run is awaited
            self._fail(error)
        else:
            self._end.set_result(detail)

    def _fail(self, error: Exception) -> None:
        if not self._end.done():
            self._end.set_exception(error)

    # --- in the watch's thread --------------------------------------------------------------------

    def _busy(self) -> None:
        self._member.busy(self._shard.tick)

    def _hopeless(self, cell: tuple[int, int], problem: str, trace: str) -> None:
        tick = self._shard.tick
        self._trouble(_Trouble(tick, (FirmwareFailed(cell, tick, problem, trace),), None))

    # --- in either --------------------------------------------------------------------------------

    def _publish(self, tick: int, outputs: ShardOutputs) -> None:
        for hung in outputs.hung:
            if hung.problem not in self._reported:  # once for all that hang for the same reason
                self._reported.add(hung.problem)
                index = int(self._shard.indices[self._shard.cells.index(hung.cell)])
                self._member.hang(index, hung.tick, _text(hung))
        links = outputs.links
        frame = None if links is None else LinkFrame(tick, links.sent, links.message)
        self._member.publish_registers(tick, self._shard.registers)
        self._member.publish(DriveFrame(tick, outputs.drive), frame)
        self._member.publish_snapshot(tick + 1, self._saved_state)

    def _saved_state(self) -> bytes:
        return save_state(self._shard, self._records)


def _text(failure: FirmwareFailed) -> str:
    """Problem and traceback as one text that a report can carry; of a long traceback the end is kept."""
    problem = failure.problem[: TEXT_LIMIT // 2]
    return f"{problem}\n{failure.trace[-(TEXT_LIMIT - len(problem) - 1) :]}" if failure.trace else problem
