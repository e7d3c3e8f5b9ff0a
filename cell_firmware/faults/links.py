"""Base classes of link faults: affected links of a shard, and filters of messages on these links."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from bus.fault import FaultInstance
from bus.lattice import SIDES, Lattice
from bus.random_streams import CounterStream
from cell_firmware.effects.base import ShardContext, stream_ids
from cell_firmware.faults.base import CellFault, FaultFilter, stream_name
from cell_firmware.firmware import Bools, Inbox, Inputs, Messages, opaque_view

Ints = NDArray[np.int64]
Changed = tuple[Bools, Messages, dict[str, Bools | Ints]]
"""Result of a link filter: whether links deliver a message, the messages, and counted events by name."""


class LinkFault(CellFault):
    """A fault of links, which acts on messages at the receiver.

    A message is what a link carries in a tick: of the program's, or with the effect ``serial`` the bytes of a tick.
    """

    @abstractmethod
    def affected_links(self, lattice: Lattice, seed: int, number: int) -> Ints:
        """Return the affected links, ``(m, 2)``: index of the receiving cell and side; ascending, each once."""

    def input_filters(
        self, site: ShardContext, lattice: Lattice, injected: FaultInstance[CellFault]
    ) -> Iterator[FaultFilter]:
        """Yield one filter, where cells of the shard receive on an affected link."""
        if site.message is None:
            return
        links = self.affected_links(lattice, site.seed, injected.number)
        links = links[np.isin(links[:, 0], site.cells)]
        if len(links):
            yield self.make_filter(AffectedLinks.of(site, links, site.message), injected)

    @abstractmethod
    def make_filter(self, links: AffectedLinks, injected: FaultInstance[CellFault]) -> FaultFilter:
        """Return the filter of a shard's affected links."""


@final
@dataclass(frozen=True, slots=True, eq=False)
class AffectedLinks:
    """Affected links on which cells of a shard receive.

    Attributes:
        site: The shard.
        slot: ``(m,)``, position of each link among the ``4 n`` slots of the shard's inbox.
        place: ``(m,)``, identifier of each link, unique in the whole array.
        message: Type of the links' payload.
    """

    site: ShardContext
    slot: Ints
    place: Ints
    message: np.dtype[Any]

    @staticmethod
    def of(site: ShardContext, links: Ints, message: np.dtype[Any]) -> AffectedLinks:
        """Return the affected links of a shard, given receiving cell and side, ``(m, 2)``."""
        order = np.argsort(site.cells)
        row = order[np.searchsorted(site.cells, links[:, 0], sorter=order)]
        sides = len(SIDES)
        return AffectedLinks(site, sides * row + links[:, 1], sides * links[:, 0] + links[:, 1], message)

    def __len__(self) -> int:
        return len(self.slot)

    def draws(self, injected: FaultInstance[CellFault], what: str = "", each: int = 1) -> CounterStream:
        """``each`` numbers for each of these links and every tick, ``(each m,)``."""
        return CounterStream(self.site.seed, stream_name(injected, what), stream_ids(self.place, each))


class LinkFilter(FaultFilter):
    """A filter of messages on the affected links.

    Args:
        links: The links.
        injected: The fault.
        counts: Names of what it counts.
        lingers: See ``FaultFilter``.
    """

    def __init__(
        self, links: AffectedLinks, injected: FaultInstance[CellFault], *counts: str, lingers: int = 0
    ) -> None:
        super().__init__(injected, *counts, lingers=lingers)
        self._links = links
        self._nothing = np.zeros((), dtype=opaque_view(np.zeros((), dtype=links.message)).dtype)

    def apply_active(self, tick: int, inputs: Inputs, alive: NDArray[np.int64] | slice) -> Inputs:
        """Filter the messages of the affected links."""
        inbox, slot = inputs.inbox, self._links.slot
        assert inbox is not None, "this is a bug: no inbox, but links"
        received, message = inbox.received.copy(), np.ascontiguousarray(inbox.message)
        flat, whole = received.reshape(-1), opaque_view(message).reshape(-1)
        came, words, happened = self.transform(tick, flat[slot], whole[slot])
        flat[slot], whole[slot] = came, words
        whole[slot[~came]] = self._nothing
        for name, links in happened.items():
            numbers = np.zeros(received.shape, dtype=np.int64)
            numbers.reshape(-1)[slot] = links
            self.counters[self._named(name)] += int(numbers[alive].sum())
        return replace(inputs, inbox=Inbox(received, message))

    @abstractmethod
    def transform(self, tick: int, came: Bools, words: Messages) -> Changed:
        """Change the messages of the affected links.

        Args:
            tick: The tick; the fault may be over, if it lingers.
            came: ``(m,)``, whether a message arrives.
            words: ``(m,)``, the messages, as opaque items of the message's size; may be written to.

        Returns:
            Whether a message is delivered, the messages (arbitrary where none is), and counted events by name, ``(m,)``
            each.
        """

    def blank(self, *shape: int) -> Messages:
        """Room for messages of these links, ``(*shape, m)``."""
        return np.zeros((*shape, len(self._links)), dtype=self._nothing.dtype)

    def active_at(self, tick: int) -> bool:
        """Whether the fault is active, and not only delivering remaining messages."""
        return self._injected.active_at(tick)
