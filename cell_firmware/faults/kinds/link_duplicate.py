"""Fault ``link_duplicate``: links that deliver messages twice."""

from __future__ import annotations

from typing import ClassVar, Literal, final

import numpy as np

from bus.fault import FaultInstance, LinkTarget
from bus.state import StateFields
from cell_firmware.effects.sensor import Probability
from cell_firmware.faults.base import CellFault
from cell_firmware.faults.links import AffectedLinks, Changed, LinkFault, LinkFilter
from cell_firmware.firmware import Bools, Messages


@final
class LinkDuplicateFault(LinkTarget, LinkFault):
    """Messages are delivered again in the next tick, unless a newer one arrives then.

    A cell reads one message a side and tick: where the neighbour sends in every tick, duplicates are overtaken and
    never received. With silence in between, the message counts as sent twice.
    """

    kind_name: ClassVar[str] = "link_duplicate"
    kind: Literal["link_duplicate"] = "link_duplicate"
    probability: Probability
    """Probability, for each message, that it is delivered twice."""

    def make_filter(self, links: AffectedLinks, injected: FaultInstance[CellFault]) -> LinkFilter:
        """Return a filter that repeats messages."""
        return _Duplicate(self.probability, links, injected)


@final
class _Duplicate(LinkFilter):
    state_fields: ClassVar[StateFields] = StateFields("_again", "_words")

    def __init__(self, probability: float, links: AffectedLinks, injected: FaultInstance[CellFault]) -> None:
        super().__init__(links, injected, "duplicated", "overtaken", lingers=1)
        self._probability = probability
        self._draws = links.draws(injected)
        self._again = np.zeros(len(links), dtype=np.bool_)
        self._words = self.blank()

    def transform(self, tick: int, came: Bools, words: Messages) -> Changed:
        """Return new messages, and repeat messages of the tick before where no new one arrives."""
        again, overtaken = self._again & ~came, self._again & came
        payload = words.copy()
        payload[again] = self._words[again]
        if self.active_at(tick):
            self._again, self._words = came & (self._draws.uniform(tick) < self._probability), words
        return came | again, payload, {"duplicated": again, "overtaken": overtaken}
