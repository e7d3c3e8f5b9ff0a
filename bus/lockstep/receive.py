"""Frame assembly by tick: early parts are stored, late parts are counted, dead senders are not expected."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, final

from bus.errors import WaitInterrupted, WireError
from bus.lattice import NO_TICK_LIMIT
from bus.lockstep.counters import MessageCounters
from bus.partition import Partition
from bus.spec import MOST_TICKS
from bus.transports.base import Endpoint, Event, LivelinessChange, Received
from bus.wire.format import DriveBatch
from bus.wire.keys import owner_of

EARLY_TICKS: Final = 2 * MOST_TICKS
"""Ticks ahead up to which a frame is stored.

A message of a tick is read ``link_ticks`` later, and its sender may be ahead of the reader by as many."""


@final
class PartialFrame:
    """Frame of one tick, complete or not.

    Attributes:
        values: A value a part; its blank where none has arrived.
        have: Nonzero for each part that has arrived.
        missing: Number of live parts that have not arrived.
        undecoded: Number of values that are payloads as they came.
    """

    __slots__ = ("have", "missing", "undecoded", "values")

    def __init__(self, values: list[Any], missing: int) -> None:
        self.values = values
        self.have = bytearray(len(values))
        self.missing = missing
        self.undecoded = 0


@final
class FrameAssembler:
    """Reassembly of frames of one kind from parts, one sender a part.

    Args:
        kind: Name of the frames in errors.
        blank: Substitute for each part that does not arrive.
        decode: From a part and its payload to its tick and value; raises WireError.
        counts: Counters to update.
        batch: Decoder of all parts at once, used while no sender is dead; None: each is decoded as it comes.
        refuse: Called with the part and the error of each payload that ``settle`` refuses.

    Attributes:
        now: First tick that is not closed.
        first_tick: For each part, first live tick of the sender.
        end_tick: For each part, first tick in which the sender is dead.
        latest: Last tick accepted: frames of later ticks are refused.
        newest: Last tick of which a frame has come, of a dead sender too; -1 before the first.
    """

    def __init__(
        self,
        kind: str,
        blank: Sequence[Any],
        decode: Callable[[int, bytes], tuple[int, Any]],
        counts: MessageCounters,
        batch: DriveBatch | None = None,
        refuse: Callable[[int, WireError], None] | None = None,
    ) -> None:
        self.now = 0
        self._batch, self._refuse = batch, refuse
        self._stamp = b"" if batch is None else batch.stamp(0)
        self.first_tick = [0] * len(blank)
        self.end_tick = [NO_TICK_LIMIT] * len(blank)
        self.latest = NO_TICK_LIMIT
        self.newest = -1
        self._deaths = False
        self._expected: set[int] = set()
        self._any_tick = False
        self._kind = kind
        self._blank = list(blank)
        self._decode = decode
        self._counts = counts
        self._current = PartialFrame(self._blank.copy(), len(blank))
        self._early: dict[int, PartialFrame] = {}

    def handle(self, part: int, payload: bytes) -> None:
        """Store the value of a part.

        Raises:
            WireError: Not such a payload, too far ahead, or the second of its tick.
        """
        if self._batch is not None and self._defer(self._batch, part, payload):
            return
        tick, value = self._decode(part, payload)
        if tick > self.latest:
            raise WireError(
                self._kind, "ahead", f"tick {tick}: must be at most {self.latest}, the last begun"
            )
        self.newest = max(self.newest, tick)
        if tick < self.now or not self.first_tick[part] <= tick < self.end_tick[part]:
            self._handle_departed(part, tick, value)
            return
        if tick > self.now + EARLY_TICKS and not (self._any_tick and len(self._early) < EARLY_TICKS):
            raise WireError(
                self._kind, "ahead", f"tick {tick}: must be at most {EARLY_TICKS} ahead of {self.now}"
            )
        slot = self._current if tick == self.now else self.slot(tick)
        if slot.have[part]:
            raise self._duplicate(tick)
        slot.values[part] = value
        slot.have[part] = 1
        slot.missing -= 1
        self._counts.delivered += 1

    def _defer(self, batch: DriveBatch, part: int, payload: bytes) -> bool:
        """Keep a payload of the current tick as it is, to be decoded with the others; return whether it was kept."""
        if (
            payload[batch.tick_at] != self._stamp
            or len(payload) != batch.sizes[part]
            or self._deaths
            or self.now > self.latest
        ):
            return False
        slot = self._current
        if slot.have[part]:
            self.settle()  # an invalid payload is none, and this one not the second
            return False
        slot.values[part] = payload
        slot.have[part] = 1
        slot.missing -= 1
        slot.undecoded += 1
        self._counts.delivered += 1
        return True

    def settle(self) -> bool:
        """Decode what was kept of the current tick, and refuse what is not valid.

        Returns:
            Whether all live parts are there.
        """
        slot = self._current
        if slot.undecoded:
            kept, slot.undecoded = slot.undecoded, 0
            assert self._batch is not None, "this is a bug: payloads were kept for no decoder"
            together = self._batch.decode(slot.values) if kept == len(slot.values) else None
            if together is not None:
                slot.values = together
            else:
                self._decode_each(slot)
        return slot.missing <= 0

    def _decode_each(self, slot: PartialFrame) -> None:
        """Decode the payloads among the values of a frame one by one."""
        for part, payload in enumerate(slot.values):
            if type(payload) is not bytes or not slot.have[part]:
                continue
            try:
                slot.values[part] = self._decode(part, payload)[1]
            except WireError as error:
                slot.values[part], slot.have[part] = self._blank[part], 0
                slot.missing += 1
                self._counts.delivered -= 1
                assert self._refuse is not None, "this is a bug: nobody counts what is refused"
                self._refuse(part, error)

    def _handle_departed(self, part: int, tick: int, value: Any) -> None:
        """Keep the value of a part whose sender may rejoin; count any other as late."""
        if part not in self._expected or not self.now <= tick <= self.now + EARLY_TICKS:
            self._counts.late += 1
            return
        slot = self.slot(tick)
        if slot.have[part]:
            raise self._duplicate(tick)
        slot.values[part] = value  # nobody waits for it: what is missing stays as it is
        slot.have[part] = 1
        self._counts.delivered += 1

    def _duplicate(self, tick: int) -> WireError:
        return WireError(self._kind, "duplicate", f"tick {tick} was received already")

    def allow_early(self, parts: Iterable[int]) -> None:
        """Accept frames of ``parts`` although their senders are dead.

        A rejoining sender's first frame can arrive before the control record that readmits it.
        """
        self._expected.update(parts)

    def accept_any_tick(self) -> None:
        """Accept frames of any tick until ``start_at`` sets the first."""
        self._any_tick = True

    def slot(self, tick: int) -> PartialFrame:
        """Return the frame of ``tick``, which is at least ``now``; create it if there is none."""
        if tick == self.now:
            return self._current
        slot = self._early.get(tick)
        if slot is None:
            slot = self._early[tick] = self._begin(tick)
        return slot

    def _begin(self, tick: int) -> PartialFrame:
        intervals = zip(self.first_tick, self.end_tick, strict=True)
        return PartialFrame(self._blank.copy(), sum(since <= tick < until for since, until in intervals))

    def early(self, tick: int) -> int:
        """Return the number of parts received of frames from ``tick`` on."""
        slots = {self.now: self._current, **self._early}
        return sum(sum(slot.have) for when, slot in slots.items() if when >= tick)

    def awaited(self) -> list[int]:
        """Return the live parts of the frame of ``now`` that have not arrived; from any thread."""
        now, have = self.now, self._current.have
        intervals = enumerate(zip(self.first_tick, self.end_tick, strict=True))
        return [part for part, (since, until) in intervals if since <= now < until and not have[part]]

    def missing(self, tick: int) -> list[int]:
        """Return the live parts of ``tick`` that have not arrived."""
        slot = self._current if tick == self.now else self._early.get(tick)
        have = bytes(len(self.end_tick)) if slot is None else slot.have
        intervals = enumerate(zip(self.first_tick, self.end_tick, strict=True))
        return [part for part, (since, until) in intervals if since <= tick < until and not have[part]]

    def update_membership(self, until: list[int]) -> None:
        """Set the end ticks of the senders: no part is expected from then on."""
        self.end_tick = until
        self._recount()

    def admit(self, since: list[int], until: list[int]) -> None:
        """Set the first ticks and end ticks of the senders."""
        self.first_tick, self.end_tick = since, until
        self._recount()

    def start_at(self, tick: int) -> None:
        """Start at ``tick``; parts of earlier ticks are late."""
        self._any_tick = False
        self.settle()
        self._begin_at(tick)
        self._early = {t: slot for t, slot in self._early.items() if t >= tick}
        self._current = self._early.pop(tick, None) or self._begin(tick)

    def _begin_at(self, tick: int) -> None:
        self.now = tick
        if self._batch is not None:
            self._stamp = self._batch.stamp(tick)

    def discard(self, parts: Sequence[int], tick: int) -> None:
        """Discard the received values of ``parts`` for ``tick`` and later ticks, as if they had not been sent."""
        for slot in [self.slot(t) for t in (self.now, *self._early) if t >= tick]:
            for part in parts:
                slot.values[part] = self._blank[part]
                slot.have[part] = 0

    @property
    def untouched(self) -> bool:
        """Whether nothing has arrived of the frame of ``now`` or of later ones."""
        return not self._early and not any(self._current.have)

    def skip(self, parts: int) -> None:
        """Close the frame of ``now``, whose ``parts`` the caller has received by itself.

        The frame was ``untouched``, and the same senders are live in the next tick.
        """
        self.now += 1
        self._counts.delivered += parts

    def _recount(self) -> None:
        self._deaths = True
        for tick in (self.now, *self._early):
            self.slot(tick).missing = len(self.missing(tick))

    def close(self, tick: int) -> PartialFrame:
        """Return the frame of ``tick`` and close all ticks up to it: parts that arrive from now on are late."""
        self.settle()
        slot = self.slot(tick)
        now = tick + 1
        self._begin_at(now)
        if not self._early and not self._deaths:  # nearly always, and every tick
            self._current = PartialFrame(self._blank.copy(), len(self.end_tick))
            return slot
        self._current = self._early.pop(now, None) or self._begin(now)
        for over in [t for t in self._early if t < now]:
            del self._early[over]
        return slot


BATCH: Final = 64
"""Payloads for which a side sleeps at most before it begins to read them."""

Route = tuple[Callable[[int, bytes], None], int]
"""Handler of the payloads of a key, and the part that the key stands for."""


@final
class Dispatcher:
    """Router of received payloads and token changes to the handlers of one side of a run.

    Args:
        endpoint: Endpoint to receive from.
        partition: Partition of the cells into shards.
        counts: Counters of refused payloads.
        tokens: Handler of token changes.

    Attributes:
        routes: For each key, the handler of its payloads, which may raise WireError.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        partition: Partition,
        counts: MessageCounters,
        tokens: Callable[[LivelinessChange], None],
    ) -> None:
        self._partition = partition
        self.routes: dict[str, Route] = {}
        self._receive = endpoint.receive_all
        self._counts = counts
        self._tokens = tokens

    def poll(self, timeout_s: float | None, enough: int = 1, quiet_key: str | None = None) -> bool:
        """Wait for events as ``Endpoint.receive_all`` does, and handle all of them; return whether there were any.

        Raises:
            WaitInterrupted: ``Endpoint.wake`` was called; all other events have been handled.
        """
        events = self._receive(timeout_s, min(enough, BATCH), quiet_key)
        self.handle(events)
        return bool(events)

    def handle(self, events: Iterable[Event]) -> None:
        """Handle events.

        Raises:
            WaitInterrupted: There was a wakeup; all other events have been handled.
        """
        wakeups = 0
        for event in events:
            if type(event) is Received:
                take, part = self.routes.get(event.key, _NOWHERE)
                try:
                    take(part, event.payload)
                except WireError as error:
                    # A stranger may invent keys without end; they are one.
                    known = take is not _refuse
                    self._counts.refuse(error, owner_of(event.key, self._partition) if known else "nobody")
            elif type(event) is LivelinessChange:
                self._tokens(event)
            else:
                wakeups += 1
        if wakeups:
            raise WaitInterrupted("woken while waiting for the others", wakeups)


def _refuse(part: int, payload: bytes) -> None:  # noqa: ARG001 - as every route
    raise WireError("bus", "key", "no participant of this run sends on this key")


_NOWHERE: Final[Route] = (_refuse, 0)
