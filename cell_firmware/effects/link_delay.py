"""Effect ``link_delay``: messages between neighbours that take longer than to the next tick."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, ClassVar, Final, Self, final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from bus.lattice import SIDES
from bus.random_streams import CounterStream
from bus.spec import Spec
from bus.state import StateFields
from cell_firmware.effects.base import CellEffectSpec, InputFilter, ShardContext
from cell_firmware.firmware import Inbox, Inputs

LONGEST_TICKS: Final = 1_000
Ticks = Annotated[int, Field(ge=0, le=LONGEST_TICKS)]


class Delays(Spec):
    """Additional delay of messages, ticks."""

    ticks: Ticks | None = None
    """Delay of every message."""
    between_ticks: tuple[Ticks, Ticks] | None = None
    """Least and greatest delay, instead of ``ticks``: each message has a random delay, uniformly distributed."""
    ordered: bool = True
    """Whether messages of a link arrive in the order of sending; else a message may overtake earlier ones."""

    @model_validator(mode="after")
    def _one_of_two(self) -> Self:
        if (self.ticks is None) == (self.between_ticks is None):
            raise ValueError("give ticks or between_ticks, one of the two")
        if self.between_ticks is not None and self.between_ticks[0] > self.between_ticks[1]:
            raise ValueError("between_ticks must be the least delay and then the greatest")
        return self

    @property
    def bounds_ticks(self) -> tuple[int, int]:
        """The least and the greatest delay."""
        if self.between_ticks is not None:
            return self.between_ticks
        ticks = self.ticks or 0
        return ticks, ticks

    def delaying(self, site: ShardContext, purpose: str) -> Iterator[InputFilter]:
        """Yield a filter that holds a shard's messages until due; none where there is nothing to delay.

        Args:
            site: The shard.
            purpose: Name of the random stream.
        """
        least, greatest = self.bounds_ticks
        if site.message is None or greatest == 0:
            return
        if least == greatest:
            yield _AllAlike(greatest, site, site.message)
        else:
            yield _EachItsOwn(self, site, site.message, purpose)


@final
class LinkDelaySpec(Delays, CellEffectSpec):
    """Whole messages arrive some ticks later. Without the effect a message arrives in the next tick.

    A cell reads one message a side and tick. Of several messages that arrive at once, the cell reads the one sent last;
    the others count as overtaken.
    """

    states: ClassVar[tuple[str, ...]] = ("messages under way",)
    messages: ClassVar[tuple[str, ...]] = ("messages between neighbours take longer",)
    fidelity_rank: ClassVar[int | None] = 70

    @classmethod
    def default_settings(cls, pitch_m: float) -> Self:  # noqa: ARG003
        """Up to two ticks."""
        return cls(between_ticks=(0, 2))

    def input_filters(self, site: ShardContext) -> Iterator[InputFilter]:
        """One, where there are messages to delay."""
        yield from self.delaying(site, "link_delay")


@final
class _AllAlike(InputFilter):
    """Filter with a constant delay: stores one inbox for each tick of the delay, so that no message overtakes."""

    state_fields: ClassVar[StateFields] = StateFields("_in_flight", records=(Inbox,))

    def __init__(self, ticks: int, site: ShardContext, message: np.dtype[np.void]) -> None:
        super().__init__()
        shape = (len(site.cells), len(SIDES))
        self._in_flight = [
            Inbox(np.zeros(shape, dtype=np.bool_), np.zeros(shape, dtype=message)) for _ in range(ticks)
        ]

    def apply(self, tick: int, inputs: Inputs, alive: NDArray[np.int64] | slice) -> Inputs:
        """Replace the inbox by the inbox of as many ticks ago as the delay."""
        del alive
        inbox, slot = inputs.inbox, tick % len(self._in_flight)
        assert inbox is not None, "this is a bug: no inbox, but messages to delay"
        due, self._in_flight[slot] = self._in_flight[slot], inbox
        return replace(inputs, inbox=due)


@final
class _EachItsOwn(InputFilter):
    """Filter with a delay for each message: stores one inbox for each tick of the greatest delay."""

    state_fields: ClassVar[StateFields] = StateFields("_last_due", "_received", "_message")

    def __init__(self, spec: Delays, site: ShardContext, message: np.dtype[np.void], purpose: str) -> None:
        super().__init__()
        self._least, greatest = spec.bounds_ticks
        self._choices = greatest - self._least + 1
        self._draws = CounterStream(site.seed, purpose, site.link_stream_ids())
        links = len(SIDES) * len(site.cells)
        self._last_due = np.zeros(links, dtype=np.int64) if spec.ordered else None
        self._received = np.zeros((greatest + 1, links), dtype=np.bool_)
        self._message = np.zeros((greatest + 1, links), dtype=message)
        self.counters["overtaken"] = 0

    def apply(self, tick: int, inputs: Inputs, alive: NDArray[np.int64] | slice) -> Inputs:
        """Store received messages, and deliver due messages."""
        inbox = inputs.inbox
        assert inbox is not None, "this is a bug: no inbox, but messages to delay"
        shape = inbox.received.shape
        came = np.flatnonzero(inbox.received)
        slots = self._due(tick, came) % len(self._received)

        # What is there was sent earlier and would arrive at the same time: it is overtaken.
        overtaken = np.zeros(shape, dtype=np.bool_)
        overtaken.flat[came] = self._received[slots, came]
        self.count("overtaken", overtaken, alive)
        self._received[slots, came] = True
        self._message[slots, came] = inbox.message.ravel()[came]

        now = tick % len(self._received)
        due = Inbox(self._received[now].copy().reshape(shape), self._message[now].copy().reshape(shape))
        self._received[now] = False
        self._message[now] = np.zeros((), dtype=self._message.dtype)
        return replace(inputs, inbox=due)

    def _due(self, tick: int, came: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the delivery tick of each message in ``came``."""
        chance = self._draws.uniform(tick)[came]
        due = tick + self._least + (chance * self._choices).astype(np.int64)
        if self._last_due is not None:
            due = np.maximum(due, self._last_due[came])
            self._last_due[came] = due
        return due
