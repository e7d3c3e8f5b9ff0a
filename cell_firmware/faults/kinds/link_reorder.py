"""Fault ``link_reorder``: links on which messages come after those that were sent later."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, final

import numpy as np
from pydantic import Field

from bus.fault import FaultInstance, LinkTarget
from bus.state import StateFields
from cell_firmware.effects.link_delay import LONGEST_TICKS
from cell_firmware.effects.sensor import Probability
from cell_firmware.faults.base import CellFault
from cell_firmware.faults.links import AffectedLinks, Changed, LinkFault, LinkFilter
from cell_firmware.firmware import Bools, Messages


@final
class LinkReorderFault(LinkTarget, LinkFault):
    """Messages are held back and delivered after later ones: the last message received is not the latest sent.

    A cell reads one message a side and tick. A held message replaces a message that arrives in the tick of its delivery
    and is not held itself: the other is lost (``replaced``). Messages held when the fault ends are still delivered.
    """

    kind_name: ClassVar[str] = "link_reorder"
    kind: Literal["link_reorder"] = "link_reorder"
    probability: Probability
    """Probability, for each message, that it is held back."""
    ticks: Annotated[int, Field(ge=1, le=LONGEST_TICKS)] = 1
    """Delay of a message that is held back, ticks."""

    def make_filter(self, links: AffectedLinks, injected: FaultInstance[CellFault]) -> LinkFilter:
        """Return a filter that holds messages back."""
        return _Reorder(self, links, injected)


@final
class _Reorder(LinkFilter):
    state_fields: ClassVar[StateFields] = StateFields("_held", "_words")

    def __init__(
        self, fault: LinkReorderFault, links: AffectedLinks, injected: FaultInstance[CellFault]
    ) -> None:
        super().__init__(links, injected, "reordered", "replaced", lingers=fault.ticks)
        self._probability, self._ticks = fault.probability, fault.ticks
        self._draws = links.draws(injected)
        self._held = np.zeros((fault.ticks, len(links)), dtype=np.bool_)
        self._words = self.blank(fault.ticks)

    def transform(self, tick: int, came: Bools, words: Messages) -> Changed:
        """Return held messages that are due, and new messages that are not held."""
        slot = tick % self._ticks
        due, late = self._held[slot].copy(), self._words[slot].copy()
        held = np.zeros_like(came)
        if self.active_at(tick):
            held = came & (self._draws.uniform(tick) < self._probability)
        self._held[slot], self._words[slot] = held, words
        direct = came & ~held
        payload = np.where(due, late, words)
        return direct | due, payload, {"reordered": held, "replaced": direct & due}
