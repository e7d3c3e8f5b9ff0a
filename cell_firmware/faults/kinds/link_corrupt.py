"""Fault ``link_corrupt``: links that flip bits of messages."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, final

import numpy as np
from pydantic import Field

from bus.fault import FaultInstance, LinkTarget
from cell_firmware.effects.sensor import Probability
from cell_firmware.faults.base import CellFault
from cell_firmware.faults.links import AffectedLinks, Changed, LinkFault, LinkFilter
from cell_firmware.firmware import Bools, Messages


@final
class LinkCorruptFault(LinkTarget, LinkFault):
    """Bits of messages are flipped, in their bytes on the wire.

    On serial lines these are the bytes of a tick, and the check byte detects all but one change in 256. Whole messages
    have no check byte: a receiver can only refuse floats that are no numbers (``faults.words.refused``), and accepts
    any other value.
    """

    kind_name: ClassVar[str] = "link_corrupt"
    corrupts_messages: ClassVar[bool] = True
    kind: Literal["link_corrupt"] = "link_corrupt"
    probability: Probability
    """Probability, for each message, that it is corrupted."""
    bits: Annotated[int, Field(ge=1, le=64)] = 1
    """Number of different bits that are flipped in a corrupted message, all equally likely."""

    def make_filter(self, links: AffectedLinks, injected: FaultInstance[CellFault]) -> LinkFilter:
        """Return a filter that flips bits."""
        return _Changed(self, links, injected)


@final
class _Changed(LinkFilter):
    def __init__(
        self, fault: LinkCorruptFault, links: AffectedLinks, injected: FaultInstance[CellFault]
    ) -> None:
        from cell_firmware.faults.payload_bytes import PayloadView

        super().__init__(links, injected, "corrupted")
        self._probability, self._bits = fault.probability, fault.bits
        self._draws = links.draws(injected)
        self._which = links.draws(injected, ".bits", self._bits)
        self._wire = PayloadView.of(links.message, links.site.said or links.message)

    def transform(self, tick: int, came: Bools, words: Messages) -> Changed:
        """Flip bits of messages at random."""
        from cell_firmware.faults.payload_bytes import flipped

        hit = came & (self._draws.uniform(tick) < self._probability)
        rows = np.flatnonzero(hit)
        if len(rows):
            words_hit = words[rows].view(self._links.message)
            data, count = self._wire.read(words_hit)
            chance = self._which.uniform(tick).reshape(len(words), -1)[rows]
            words_hit = self._wire.write(words_hit, flipped(data, count, self._bits, chance))
            words[rows] = words_hit.view(words.dtype)
        return came, words, {"corrupted": hit}
