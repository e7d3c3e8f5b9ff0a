"""Fault ``link_loss``: links on which messages get lost, each by itself or many in a row."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, Self, final

import numpy as np
from pydantic import Field, model_validator

from bus.fault import FaultInstance, LinkTarget
from bus.state import StateFields
from cell_firmware.effects.sensor import Probability
from cell_firmware.faults.base import CellFault
from cell_firmware.faults.links import AffectedLinks, Changed, LinkFault, LinkFilter
from cell_firmware.firmware import Bools, Messages


@final
class LinkLossFault(LinkTarget, LinkFault):
    """Messages are lost independently, or in bursts by Gilbert's model.

    In Gilbert's model each link is independently good or bad: a good link loses no message, a bad link every message.
    From tick to tick a bad link turns good with probability ``1 / burst_ticks``, and a good link bad with probability
    ``probability / ((1 - probability) burst_ticks)``. A link begins bad with ``probability``. Hence links are bad in a
    share ``probability`` of the ticks, and bursts last ``burst_ticks`` on average.

    Source: Gilbert, "Capacity of a burst-noise channel", Bell System Technical Journal 39 (1960), with h = 0.
    """

    kind_name: ClassVar[str] = "link_loss"
    kind: Literal["link_loss"] = "link_loss"
    probability: Probability
    """Share of the messages that are lost."""
    burst_ticks: Annotated[float, Field(ge=1, le=1e9, allow_inf_nan=False)] | None = None
    """Mean number of consecutive ticks in which a link is bad; None: messages are lost independently."""

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.burst_ticks is None:
            return self
        if self.probability == 1.0:
            raise ValueError("burst_ticks needs a probability below 1: at 1 a single burst never ends")
        if self.turns_bad > 1.0:
            least = self.probability / (1.0 - self.probability)
            raise ValueError(
                f"burst_ticks must be at least probability / (1 - probability), {least:g}, not {self.burst_ticks:g}"
            )
        return self

    @property
    def turns_bad(self) -> float:
        """Probability, a tick, that a good link turns bad; with bursts only."""
        assert self.burst_ticks is not None
        return self.probability / ((1.0 - self.probability) * self.burst_ticks)

    def make_filter(self, links: AffectedLinks, injected: FaultInstance[CellFault]) -> LinkFilter:
        """Return a filter that drops messages."""
        if self.burst_ticks is None:
            return _Independent(self.probability, links, injected)
        return _Bursts(self, links, injected)


@final
class _Independent(LinkFilter):
    def __init__(self, probability: float, links: AffectedLinks, injected: FaultInstance[CellFault]) -> None:
        super().__init__(links, injected, "lost")
        self._probability = probability
        self._draws = links.draws(injected)

    def transform(self, tick: int, came: Bools, words: Messages) -> Changed:
        """Drop messages at random."""
        lost = came & (self._draws.uniform(tick) < self._probability)
        return came & ~lost, words, {"lost": lost}


@final
class _Bursts(LinkFilter):
    """Filter with a state, good or bad, for each link; one draw a tick and link decides the next state."""

    state_fields: ClassVar[StateFields] = StateFields("_bad")

    def __init__(
        self, fault: LinkLossFault, links: AffectedLinks, injected: FaultInstance[CellFault]
    ) -> None:
        super().__init__(links, injected, "lost")
        assert fault.burst_ticks is not None
        self._share, self._turns_bad, self._stays_bad = (
            fault.probability,
            fault.turns_bad,
            1.0 - 1.0 / fault.burst_ticks,
        )
        self._draws = links.draws(injected)
        self._bad: Bools | None = None

    def transform(self, tick: int, came: Bools, words: Messages) -> Changed:
        """Drop messages of bad links."""
        chance = self._draws.uniform(tick)
        if self._bad is None:
            self._bad = chance < self._share
        else:
            self._bad = chance < np.where(self._bad, self._stays_bad, self._turns_bad)
        lost = came & self._bad
        return came & ~lost, words, {"lost": lost}
