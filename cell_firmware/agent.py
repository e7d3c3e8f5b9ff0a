"""Asyncio agent of a shard: awaits the inputs of a tick, steps the shard, publishes its outputs."""

from __future__ import annotations

import asyncio
import sys
import traceback
from collections.abc import Callable, Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Final, Protocol, final

import numpy as np

from bus.errors import WireError
from bus.lattice import Lattice
from bus.lockstep import Participant, TickInputs
from bus.state import save_state
from bus.transports.event_loop import TransportEventLoop
from bus.wire.frames import TEXT_LIMIT, Control, DriveFrame, LinkFrame
from cell_firmware.effects.base import ShardContext
from cell_firmware.errors import FirmwareFailed
from cell_firmware.shard import BoundaryMessages, Shard, ShardOutputs

if TYPE_CHECKING:
    from cell_firmware.payload_codec import PayloadCodec


@final
@dataclass(frozen=True, slots=True)
class ShardResult:
    """Result of a shard's run.

    Attributes:
        ticks: Ticks that were stepped.
        detail: Reason for the end, from the stop record.
        failures: Cells whose firmware failed during the run.
        stopped: Whether the plant's stop record ended the shard; False: its cells died, or a program did not return.
    """

    ticks: int
    detail: str
    failures: tuple[FirmwareFailed, ...]
    stopped: bool


Inject = Callable[[Control], None]
"""Applies a control record of kind ``fault`` to the shard, before the tick in which it acts; may raise WireError."""


Hopeless = Callable[[tuple[int, int], str, str], None]
"""Called with the cell, the problem and the stack of a program that does not return and could not be interrupted."""


Held = Callable[[tuple[int, int]], None]
"""Called with the cell whose program a debugger holds, again and again."""


def injector(shard: Shard, site: ShardContext, lattice: Lattice) -> Inject:
    """Return the callback that begins and repairs faults in a shard.

    Args:
        shard: The shard.
        site: The shard's cells.
        lattice: Lattice of the array.
    """

    def inject(control: Control) -> None:
        from cell_firmware.faults.attach import decode_fault_control

        fault = decode_fault_control(control, lattice, site.seed)
        if isinstance(fault, tuple):
            shard.repair(*fault)
        else:
            shard.inject(fault, site, lattice)

    return inject


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


Watched = Callable[[Callable[[], None], Hopeless, Held], Watch]
"""Makes the watch of an agent. The watch calls the first now and then while a step takes long, the second where it
can't bring a program to an end, and the third while a debugger holds a program. The calls come from another thread."""


async def run(
    shard: Shard,
    member: Participant,
    inject: Inject | None = None,
    records: tuple[type, ...] = (),
    first: int = 0,
    watched: Watched | None = None,
) -> ShardResult:
    """Run a shard tick by tick until a stop record arrives. Runs in a ``TransportEventLoop``.

    The caller calls ``member.ready()`` before, and closes the member and the endpoint after. Cells with a scheduled
    death stop at their tick. A cell whose firmware fails is reported to the plant, with its traceback, and the others
    continue; the plant decides whether the run does. An error in the step itself is a failure of all cells of the
    shard, and ends the shard's run.

    Args:
        shard: The cells, before tick 0 or restored from a snapshot.
        member: The shard's participant, ready; on the endpoint of the event loop.
        inject: Applies fault records received during the run; None: they are ignored.
        records: Record types in the cells' states, beyond plain values.
        first: The shard's first tick.
        watched: Makes the watch that ends programs which do not return; None: no watch.

    Raises:
        CoordinatorLostError: The plant went away.
        WaitInterrupted: The endpoint was woken, which ends a run without a stop record.
        BusError: Any other error of the participant.
        TypeError: The event loop is of another class.
        asyncio.CancelledError: Cancelled.
    """
    loop = asyncio.get_running_loop()
    if not isinstance(loop, TransportEventLoop):
        raise TypeError(
            f"the event loop of an agent is a {type(loop).__name__}: must be a TransportEventLoop"
        )
    agent = _Agent(shard, member, inject, records)
    watch = None if watched is None else watched(agent.busy, agent.abandon, agent.hold)
    with nullcontext() if watch is None else closing(watch):
        return await agent.run(loop, first, watch)


@final
class _Agent:
    """Agent of a shard: awaits the inputs of a tick, steps the shard, and publishes the outputs.

    ``busy``, ``hold`` and ``abandon`` are called by the watch's thread while the event loop's thread is in a step. The
    participant is thus used by one thread at a time.
    """

    def __init__(
        self, shard: Shard, member: Participant, inject: Inject | None, records: tuple[type, ...]
    ) -> None:
        self._shard: Final = shard
        self._member: Final = member
        self._records: Final = records
        self._inject: Final = inject
        self._failures: list[FirmwareFailed] = []
        self._reported: set[str] = set()
        self._awaited = 0
        self._held_tick = -1
        self._inputs: TickInputs | Control | None = None
        self._done: ShardOutputs | Exception | None = None
        """Outputs of the tick awaited, where programs failed in a plain one; or the error of the step itself."""
        self._codec: Final = shard.payload_codec(member.layouts)
        member.read_registers_by(shard.registers)

    async def run(self, loop: TransportEventLoop, first: int, watch: Watch | None) -> ShardResult:
        """Run ticks from ``first`` on."""
        tick, live = first, np.ones(len(self._shard), dtype=np.bool_)
        while True:
            inputs = await self._gather(loop, tick)
            tick, done, self._done = self._awaited, self._done, None
            if not isinstance(inputs, tuple):
                break
            self._apply_faults(tick)
            try:
                if not self._member.unchanged:
                    before, live = live, self._member.live(tick)
                    if (live != before).any():
                        cells = zip(self._shard.cells, live, strict=True)
                        self._shard.retire(cell for cell, lives in cells if not lives)
                if isinstance(done, Exception):
                    raise done
                with nullcontext() if watch is None else watch:
                    outputs = self._step(tick, inputs) if done is None else done
            except BaseException as error:  # noqa: BLE001 - whatever comes out of a step is its cells' failure
                self._fail(tick, failures_of(self._shard, tick, error))
            else:
                if watch is not None and watch.given_up:
                    return self._result(tick - first, "a program did not return in time")
                self._publish(tick, outputs)
            tick += 1
        return self._result(tick - first, inputs.detail)

    async def _gather(self, loop: TransportEventLoop, tick: int) -> TickInputs | Control:
        """Return the inputs of the first tick from ``tick`` on that is not a plain one, or a stop record."""
        self._awaited = tick
        await loop.poll_until(self._poll)
        assert self._inputs is not None, "this is a bug: a wait that ended without inputs"
        return self._inputs

    def _poll(self, timeout_s: float | None) -> bool:
        """Answer plain ticks, then gather the inputs of the tick awaited; return whether there are any."""
        if self._codec is not None and timeout_s is None and self._done is None:
            self._answer_plain_ticks(self._codec)
        self._inputs = self._member.gather(self._awaited, timeout_s)
        return self._inputs is not None

    def _answer_plain_ticks(self, codec: PayloadCodec) -> None:
        """Step from payload to payload while ticks need no more, without a turn of the event loop.

        In a process of one cell each call of a tick costs several times its usual time, so that there are few.
        """
        member, step_payload = self._member, self._shard.step_payload
        take, answer, is_direct = member.take_payload, member.answer, member.is_direct

        def step(tick: int, payload: bytes) -> bytes | None:
            try:
                done = step_payload(codec, tick, payload)
            except Exception as error:  # noqa: BLE001 - raised again where it is its cells' failure
                done = error
            if isinstance(done, bytes):
                self._awaited = tick + 1
                return done
            self._done = done
            return None

        while self._done is None and (payload := take(self._awaited)) is not None:
            drives = step(self._awaited, payload)
            if drives is None:
                member.gather_again(payload)
                return
            answer(drives)
            if is_direct:
                member.answer_directly(self._awaited, step)

    def _result(self, ticks: int, detail: str) -> ShardResult:
        return ShardResult(ticks, detail, tuple(self._failures), self._member.stopped)

    def _apply_faults(self, tick: int) -> None:
        for fault in self._member.drain_faults(tick):
            if self._inject is not None:
                try:
                    self._inject(fault)
                except WireError as error:
                    self._member.counters.refuse(error, "the plant")

    def _step(self, tick: int, inputs: TickInputs) -> ShardOutputs:
        sense, links = inputs
        received = None if links is None else BoundaryMessages(links.sent, links.message)
        return self._shard.step(
            tick,
            sense.presence,
            sense.encoder_m,
            received,
            sense.level,
            label=sense.label,
            camera=sense.picture,
        )

    def _publish(self, tick: int, outputs: ShardOutputs) -> None:
        """Report failed and hanging cells, then publish the outputs of the others."""
        self._fail(tick, outputs.failures)
        try:
            for hung in outputs.hung:
                if hung.problem not in self._reported:  # once for all that hang for the same reason
                    self._reported.add(hung.problem)
                    index = int(self._shard.indices[self._shard.cells.index(hung.cell)])
                    self._member.hang(index, hung.tick, report_text(hung))
            links = outputs.links
            frame = None if links is None else LinkFrame(tick, links.sent, links.message)
            self._member.publish_registers(tick, self._shard.registers)
            self._member.publish(DriveFrame(tick, outputs.drive), frame)
            self._member.publish_snapshot(tick + 1, self._saved_state)
        except Exception as error:  # noqa: BLE001 - outputs of a program that can't be sent are its failure
            self._fail(tick, failures_of(self._shard, tick, error))

    def _fail(self, tick: int, failures: Sequence[FirmwareFailed]) -> None:
        """Report failed cells to the plant, one report for all that failed for the same reason."""
        if not failures:
            return
        self._failures += failures
        index = dict(zip(self._shard.cells, self._shard.indices.tolist(), strict=True))
        alike: dict[str, list[int]] = {}
        for failure in failures:
            alike.setdefault(report_text(failure), []).append(index[failure.cell])
        for detail, cells in alike.items():
            self._member.fail(cells, tick, detail)

    def _saved_state(self) -> bytes:
        return save_state(self._shard, self._records)

    # --- in the watch's thread --------------------------------------------------------------------

    def busy(self) -> None:
        """Report that the step still runs."""
        self._member.busy(self._shard.tick)

    def hold(self, cell: tuple[int, int]) -> None:
        """Report that a debugger holds the program of a cell, which suspends the deadlines; say so once a tick."""
        tick = self._shard.tick
        self._member.hold(cell, tick)
        if tick != self._held_tick:
            self._held_tick = tick
            sys.stderr.write(
                f"mdms: cell {cell[0]},{cell[1]} is held in a debugger at tick {tick:,}: deadlines are suspended\n"
            )
            sys.stderr.flush()

    def abandon(self, cell: tuple[int, int], problem: str, trace: str) -> None:
        """Fail a cell whose program does not return; the thread that steps stays in it."""
        tick = self._shard.tick
        self._fail(tick, (FirmwareFailed(cell, tick, problem, trace),))


def failures_of(shard: Shard, tick: int, error: BaseException) -> tuple[FirmwareFailed, ...]:
    """Failures of the cells of a shard whose step raised: of one cell where the error names it, else of all alive."""
    if isinstance(error, FirmwareFailed):
        return (error,)
    trace = "".join(traceback.format_exception(error))
    problem = f"{type(error).__name__}: {error}"
    return tuple(FirmwareFailed(cell, tick, problem, trace) for cell in shard.alive)


def report_text(failure: FirmwareFailed) -> str:
    """Problem and traceback as one text that fits a report; of a long traceback the end is kept."""
    problem = failure.problem[: TEXT_LIMIT // 2]
    return f"{problem}\n{failure.trace[-(TEXT_LIMIT - len(problem) - 1) :]}" if failure.trace else problem
