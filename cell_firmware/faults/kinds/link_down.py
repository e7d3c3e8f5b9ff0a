"""Fault ``link_down``: links that deliver nothing."""

from __future__ import annotations

from typing import ClassVar, Literal, final

import numpy as np

from bus.fault import FaultInstance, LinkTarget
from cell_firmware.faults.base import CellFault
from cell_firmware.faults.links import AffectedLinks, Changed, LinkFault, LinkFilter
from cell_firmware.firmware import Bools, Messages


@final
class LinkDownFault(LinkTarget, LinkFault):
    """Links are cut: all messages are lost."""

    kind_name: ClassVar[str] = "link_down"
    kind: Literal["link_down"] = "link_down"

    def make_filter(self, links: AffectedLinks, injected: FaultInstance[CellFault]) -> LinkFilter:
        """Return a filter that drops all messages."""
        return Cut(links, injected)


@final
class Cut(LinkFilter):
    """Filter that drops every message."""

    def __init__(self, links: AffectedLinks, injected: FaultInstance[CellFault]) -> None:
        super().__init__(links, injected, "lost")

    def transform(self, tick: int, came: Bools, words: Messages) -> Changed:
        """Drop all messages."""
        del tick
        return np.zeros_like(came), words, {"lost": came}
