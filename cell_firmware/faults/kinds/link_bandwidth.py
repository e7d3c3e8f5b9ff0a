"""Fault ``link_bandwidth``: links that carry so many messages a second, and no more."""

from __future__ import annotations

from fractions import Fraction
from typing import Annotated, ClassVar, Final, Literal, final

import numpy as np
from pydantic import Field, field_validator

from bus.fault import FaultInstance, LinkTarget
from bus.state import StateFields
from cell_firmware.faults.base import CellFault
from cell_firmware.faults.links import AffectedLinks, Changed, LinkFault, LinkFilter
from cell_firmware.firmware import Bools, Messages

_PLACES: Final = 1_000
_BILLION: Final = 1_000_000_000


@final
class LinkBandwidthFault(LinkTarget, LinkFault):
    """Links carry at most ``messages_per_s`` messages a second: a token bucket with ``burst`` tokens for each link.

    In every tick, in this order: tokens are added; a message that arrives goes to the end of the queue; if there is a
    token, the first message of the queue is delivered, at most one a tick; of a queue of more than ``queue`` messages
    the oldest is lost. Buckets are full at the start of the fault. Messages that wait at its end are lost. Tokens are
    integers, so that the rate doesn't drift.
    """

    kind_name: ClassVar[str] = "link_bandwidth"
    kind: Literal["link_bandwidth"] = "link_bandwidth"
    messages_per_s: Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)]
    """Tokens added per second; at most three decimal places."""
    burst: Annotated[int, Field(ge=1, le=1_000)] = 1
    """Largest number of tokens in a bucket."""
    queue: Annotated[int, Field(ge=0, le=1_000)] = 0
    """Largest number of waiting messages."""

    @field_validator("messages_per_s")
    @classmethod
    def _few_places(cls, value: float) -> float:
        if (Fraction(repr(value)) * _PLACES).denominator != 1:
            raise ValueError("must have at most three decimal places")
        return value

    def make_filter(self, links: AffectedLinks, injected: FaultInstance[CellFault]) -> LinkFilter:
        """Queues."""
        return _Bucket(self, links, injected)


@final
class _Bucket(LinkFilter):
    """Filter with a token bucket and a queue for each link, oldest message first; tokens are counted in fractions."""

    state_fields: ClassVar[StateFields] = StateFields("_tokens", "_length", "_queue")

    def __init__(
        self, fault: LinkBandwidthFault, links: AffectedLinks, injected: FaultInstance[CellFault]
    ) -> None:
        super().__init__(links, injected, "waited", "lost", lingers=1)
        gain = Fraction(repr(fault.messages_per_s)) * links.site.tick_ns / _BILLION
        self._token = gain.denominator
        self._most = fault.burst * self._token
        self._gain = min(gain.numerator, self._most)
        self._tokens = np.full(len(links), self._most, dtype=np.int64)
        self._length = np.zeros(len(links), dtype=np.int64)
        self._queue = self.blank(fault.queue + 1)

    def transform(self, tick: int, came: Bools, words: Messages) -> Changed:
        """The first of each queue, where there is a token for it."""
        waiting = self._length
        if not self.active_at(tick):
            return came, words, {"lost": waiting}
        self._queue[waiting[came], np.flatnonzero(came)] = words[came]
        self._tokens = np.minimum(self._tokens + self._gain, self._most)
        length = waiting + came
        delivered = (length > 0) & (self._tokens >= self._token)
        self._tokens = self._tokens - self._token * delivered
        first = self._queue[0].copy()
        length = length - delivered
        lost = length == len(self._queue)
        moves = delivered | lost
        self._queue[:-1, moves] = self._queue[1:, moves]
        self._length = length - lost
        return delivered, first, {"waited": delivered & (waiting > 0), "lost": lost}
