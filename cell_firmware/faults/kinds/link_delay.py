"""Fault ``link_delay``: links on which messages take longer."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import ClassVar, Literal, final

import numpy as np
from numpy.typing import NDArray

from bus.fault import Injected, LinkTarget
from bus.lattice import Lattice
from bus.state import Remembers
from cell_firmware.effects.base import Site, Stage
from cell_firmware.effects.link_delay import Delays
from cell_firmware.faults.base import CellFault, FaultStage, purpose
from cell_firmware.faults.links import Links, OnLinks
from cell_firmware.firmware import Inbox, Inputs, solid


@final
class LinkDelayFault(Delays, LinkTarget, OnLinks):
    """Messages wait at their receiver, as with the effect of that name.

    What is under way when the fault ends still comes when it is due, unless a newer message comes in that tick.
    """

    called: ClassVar[str] = "link_delay"
    kind: Literal["link_delay"] = "link_delay"

    def stages(self, site: Site, lattice: Lattice, injected: Injected[CellFault]) -> Iterator[FaultStage]:
        """One, where the delay is more than none."""
        if self.bounds_ticks[1]:
            yield from super().stages(site, lattice, injected)

    def acting(self, links: Links, injected: Injected[CellFault]) -> FaultStage:
        """Delays."""
        (waiting,) = self.delaying(links.site, purpose(injected))
        return _Delayed(waiting, self.bounds_ticks[1], links, injected)


@final
class _Delayed(FaultStage):
    """Hands the messages of its links to the effect's stage, and takes from there what is due.

    Args:
        waiting: The effect's stage.
        greatest: Its longest delay, ticks.
        links: The links.
        injected: The fault.
    """

    remembers: ClassVar[Remembers] = Remembers("_waiting", "_struck")

    def __init__(self, waiting: Stage, greatest: int, links: Links, injected: Injected[CellFault]) -> None:
        super().__init__(injected, "delayed", "overtaken", lingers=greatest)
        self._waiting = waiting
        self._struck = np.zeros(4 * len(links.site.cells), dtype=np.bool_)
        self._struck[links.slot] = True

    def strike(self, tick: int, inputs: Inputs, alive: NDArray[np.int64] | slice) -> Inputs:
        """What the cells hear instead, while the fault acts or messages are under way."""
        inbox = inputs.inbox
        assert inbox is not None, "this is a bug: no inbox, but messages to delay"
        delayed = inbox.received & self._struck.reshape(-1, 4) & self._injected.acts(tick)
        direct = inbox.received & ~delayed
        waits = replace(inputs, inbox=Inbox(delayed, inbox.message.copy()))
        due = self._waiting.apply(tick, waits, alive).inbox
        assert due is not None
        overtaken, heard = due.received & direct, due.received & ~direct
        self.count("delayed", delayed, alive)
        self.count("overtaken", overtaken, alive)
        self.counted[self._named("overtaken")] += self._waiting.counted.pop("overtaken", 0)
        message = np.zeros(heard.shape, dtype=inbox.message.dtype)
        whole = solid(message)
        whole[direct] = solid(np.ascontiguousarray(inbox.message))[direct]
        whole[heard] = solid(np.ascontiguousarray(due.message))[heard]
        return replace(inputs, inbox=Inbox(direct | heard, message))
