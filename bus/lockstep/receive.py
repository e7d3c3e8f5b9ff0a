"""Collects the parts of frames, tick by tick: early ones kept, late ones counted, the dead not waited for."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, final

from bus.errors import WaitInterrupted, WireError
from bus.lattice import NO_TICK_LIMIT
from bus.lockstep.counters import MessageCounters
from bus.transports.base import Endpoint, LivelinessChange, Received
from bus.wire.keys import owner_of

EARLY_TICKS: Final = 64
"""How far ahead a frame may be to be kept; in lockstep nobody gets further than one tick."""


@final
class PartialFrame:
    """One tick's frame, as far as it has come.

    Attributes:
        values: A value a part; its blank where none has come.
        have: Nonzero for each part that has come.
        missing: How many live parts have not.
    """

    __slots__ = ("have", "missing", "values")

    def __init__(self, values: list[Any], missing: int) -> None:
        self.values = values
        self.have = bytearray(len(values))
        self.missing = missing


@final
class FrameAssembler:
    """Frames of one kind that come in parts, each part from one sender.

    Args:
        kind: Name for errors.
        blank: What stands for each part that does not come.
        decode: From a part and its payload to its tick and value; raises WireError.
        counts: Where to count.

    Attributes:
        now: The first tick that is not over.
        since: For each part, the tick from which its sender takes part.
        until: For each part, the tick from which it is gone.
        latest: The last tick that a frame can be of yet: a later one is refused.
    """

    def __init__(
        self,
        kind: str,
        blank: Sequence[Any],
        decode: Callable[[int, bytes], tuple[int, Any]],
        counts: MessageCounters,
    ) -> None:
        self.now = 0
        self.first_tick = [0] * len(blank)
        self.end_tick = [NO_TICK_LIMIT] * len(blank)
        self.latest = NO_TICK_LIMIT
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
        """Keeps the value of a part.

        Raises:
            WireError: Not such a payload, too far ahead, or the second of its tick.
        """
        tick, value = self._decode(part, payload)
        if tick > self.latest:
            raise WireError(
                self._kind, "ahead", f"tick {tick}: must be at most {self.latest}, the last begun"
            )
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

    def _handle_departed(self, part: int, tick: int, value: Any) -> None:
        """Keeps the value of a part whose sender is expected back; counts any other as late."""
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
        return WireError(self._kind, "duplicate", f"tick {tick} came already")

    def allow_early(self, parts: Iterable[int]) -> None:
        """The senders of these, who are gone, may take part again: their word may come before the news of it."""
        self._expected.update(parts)

    def accept_any_tick(self) -> None:
        """Keeps whatever tick comes until ``begin`` says which is the first."""
        self._any_tick = True

    def slot(self, tick: int) -> PartialFrame:
        """The frame of ``tick``, not before ``now``; begun if it isn't."""
        if tick == self.now:
            return self._current
        slot = self._early.get(tick)
        if slot is None:
            slot = self._early[tick] = self._begin(tick)
        return slot

    def _begin(self, tick: int) -> PartialFrame:
        lives = zip(self.first_tick, self.end_tick, strict=True)
        return PartialFrame(self._blank.copy(), sum(since <= tick < until for since, until in lives))

    def early(self, tick: int) -> int:
        """How many parts have come of frames from ``tick`` on."""
        slots = {self.now: self._current, **self._early}
        return sum(sum(slot.have) for when, slot in slots.items() if when >= tick)

    def missing(self, tick: int) -> list[int]:
        """Live parts of ``tick`` that have not come."""
        have = self.slot(tick).have
        lives = enumerate(zip(self.first_tick, self.end_tick, strict=True))
        return [part for part, (since, until) in lives if since <= tick < until and not have[part]]

    def update_membership(self, until: list[int]) -> None:
        """Sets the ticks from which the senders are gone: nobody waits for them."""
        self.end_tick = until
        self._recount()

    def admit(self, since: list[int], until: list[int]) -> None:
        """Sets the ticks from which the senders take part, and from which they are gone."""
        self.first_tick, self.end_tick = since, until
        self._recount()

    def start_at(self, tick: int) -> None:
        """``tick`` is the first; what has come for earlier ones is late."""
        self._any_tick = False
        self.now = tick
        self._early = {t: slot for t, slot in self._early.items() if t >= tick}
        self._current = self._early.pop(tick, None) or self._begin(tick)

    def discard(self, parts: Sequence[int], tick: int) -> None:
        """What has come from these for ``tick`` and later ones counts as not sent."""
        for slot in [self.slot(t) for t in (self.now, *self._early) if t >= tick]:
            for part in parts:
                slot.values[part] = self._blank[part]
                slot.have[part] = 0

    def _recount(self) -> None:
        self._deaths = True
        for tick in (self.now, *self._early):
            self.slot(tick).missing = len(self.missing(tick))

    def close(self, tick: int) -> PartialFrame:
        """The frame of ``tick``, which with all before it is over: whatever comes for it now is late."""
        slot = self.slot(tick)
        self.now = now = tick + 1
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
"""What takes the payloads of a key, and which part they are for it."""


@final
class Dispatcher:
    """Reads what comes for one side of a run.

    Args:
        endpoint: Where from.
        counts: Where refused payloads are counted.
        tokens: What takes the coming and going of tokens.

    Attributes:
        routes: For each key, what takes its payloads; may raise WireError.
    """

    def __init__(
        self, endpoint: Endpoint, counts: MessageCounters, tokens: Callable[[LivelinessChange], None]
    ) -> None:
        self.routes: dict[str, Route] = {}
        self._receive = endpoint.receive_all
        self._counts = counts
        self._tokens = tokens

    def poll(self, timeout_s: float | None, enough: int = 1) -> bool:
        """Waits as ``Endpoint.receive`` does, then takes all there is; False if there was nothing in time.

        Raises:
            WokenError: ``Endpoint.wake`` was called; everything else that was there has been taken.
        """
        events = self._receive(timeout_s, min(enough, BATCH))
        woken = False
        for event in events:
            if type(event) is Received:
                take, part = self.routes.get(event.key, _NOWHERE)
                try:
                    take(part, event.payload)
                except WireError as error:
                    # A stranger may invent keys without end; they are one.
                    known = take is not _refuse
                    self._counts.refuse(error, owner_of(event.key) if known else "nobody")
            elif type(event) is LivelinessChange:
                self._tokens(event)
            else:
                woken = True
        if woken:
            raise WaitInterrupted("woken while waiting for the others")
        return bool(events)


def _refuse(part: int, payload: bytes) -> None:  # noqa: ARG001 - as every route
    raise WireError("bus", "key", "no part of this run sends on such a key")


_NOWHERE: Final[Route] = (_refuse, 0)
