"""Fault ``link_down``: links that bring nothing."""

from __future__ import annotations

from typing import ClassVar, Literal, final

import numpy as np

from bus.fault import Injected, LinkTarget
from cell_firmware.faults.base import CellFault
from cell_firmware.faults.links import Changed, Links, LinkStage, OnLinks
from cell_firmware.firmware import Bools, Messages


@final
class LinkDownFault(LinkTarget, OnLinks):
    """Links that are cut: what is said on them is lost."""

    called: ClassVar[str] = "link_down"
    kind: Literal["link_down"] = "link_down"

    def acting(self, links: Links, injected: Injected[CellFault]) -> LinkStage:
        """Loses all."""
        return Cut(links, injected)


@final
class Cut(LinkStage):
    """Loses every message."""

    def __init__(self, links: Links, injected: Injected[CellFault]) -> None:
        super().__init__(links, injected, "lost")

    def change(self, tick: int, came: Bools, words: Messages) -> Changed:
        """Nothing comes."""
        del tick
        return np.zeros_like(came), words, {"lost": came}
