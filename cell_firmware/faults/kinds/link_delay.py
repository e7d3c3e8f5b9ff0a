"""Fault ``link_delay``: links on which messages take longer."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import ClassVar, Literal, final

import numpy as np
from numpy.typing import NDArray

from bus.fault import FaultInstance, LinkTarget
from bus.lattice import Lattice
from bus.state import StateFields
from cell_firmware.effects.base import InputFilter, ShardContext
from cell_firmware.effects.link_delay import Delays
from cell_firmware.faults.base import CellFault, FaultFilter, stream_name
from cell_firmware.faults.links import AffectedLinks, LinkFault
from cell_firmware.firmware import Inbox, Inputs, opaque_view


@final
class LinkDelayFault(Delays, LinkTarget, LinkFault):
    """Messages wait at their receiver, as with the effect of the same name.

    Messages that wait when the fault ends are still delivered when due, unless a newer message arrives in that tick.
    """

    kind_name: ClassVar[str] = "link_delay"
    kind: Literal["link_delay"] = "link_delay"

    def input_filters(
        self, site: ShardContext, lattice: Lattice, injected: FaultInstance[CellFault]
    ) -> Iterator[FaultFilter]:
        """Yield one filter, where the delay is not zero."""
        if self.bounds_ticks[1]:
            yield from super().input_filters(site, lattice, injected)

    def make_filter(self, links: AffectedLinks, injected: FaultInstance[CellFault]) -> FaultFilter:
        """Return a filter that delays messages."""
        (waiting,) = self.delaying(links.site, stream_name(injected))
        return _Delayed(waiting, self.bounds_ticks[1], links, injected)


@final
class _Delayed(FaultFilter):
    """Filter that passes the messages of affected links through the effect's filter.

    Args:
        waiting: The effect's filter.
        greatest: Its longest delay, ticks.
        links: The links.
        injected: The fault.
    """

    state_fields: ClassVar[StateFields] = StateFields("_waiting", "_affected")

    def __init__(
        self, waiting: InputFilter, greatest: int, links: AffectedLinks, injected: FaultInstance[CellFault]
    ) -> None:
        super().__init__(injected, "delayed", "overtaken", lingers=greatest)
        self._waiting = waiting
        self._affected = np.zeros(4 * len(links.site.cells), dtype=np.bool_)
        self._affected[links.slot] = True

    def apply_active(self, tick: int, inputs: Inputs, alive: NDArray[np.int64] | slice) -> Inputs:
        """Delay messages while the fault is active, and deliver due messages."""
        inbox = inputs.inbox
        assert inbox is not None, "this is a bug: no inbox, but messages to delay"
        delayed = inbox.received & self._affected.reshape(-1, 4) & self._injected.active_at(tick)
        direct = inbox.received & ~delayed
        waits = replace(inputs, inbox=Inbox(delayed, inbox.message.copy()))
        due = self._waiting.apply(tick, waits, alive).inbox
        assert due is not None
        overtaken, late = due.received & direct, due.received & ~direct
        self.count("delayed", delayed, alive)
        self.count("overtaken", overtaken, alive)
        self.counters[self._named("overtaken")] += self._waiting.counters.pop("overtaken", 0)
        message = np.zeros(late.shape, dtype=inbox.message.dtype)
        whole = opaque_view(message)
        whole[direct] = opaque_view(np.ascontiguousarray(inbox.message))[direct]
        whole[late] = opaque_view(np.ascontiguousarray(due.message))[late]
        return replace(inputs, inbox=Inbox(direct | late, message))
