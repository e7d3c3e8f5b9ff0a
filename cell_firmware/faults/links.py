"""What faults of links have in common: where their links are heard in a shard, and what a stage does to messages."""

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
"""What links bring instead: whether, and what; and by name what is counted."""


class LinkFault(CellFault):
    """A fault of links, which acts on what they bring where it is heard.

    A message is what a link carries in a tick: of the program's, or with the effect ``serial`` the bytes of a tick.
    """

    @abstractmethod
    def affected_links(self, lattice: Lattice, seed: int, number: int) -> Ints:
        """Its links, as ``(m, 2)``: the cell that hears it, by index, and the side on which; ascending, each once."""

    def input_filters(
        self, site: ShardContext, lattice: Lattice, injected: FaultInstance[CellFault]
    ) -> Iterator[FaultFilter]:
        """One, where the shard's cells hear something on a link that is struck."""
        if site.message is None:
            return
        heard = self.affected_links(lattice, site.seed, injected.number)
        heard = heard[np.isin(heard[:, 0], site.cells)]
        if len(heard):
            yield self.make_filter(AffectedLinks.of(site, heard, site.message), injected)

    @abstractmethod
    def make_filter(self, links: AffectedLinks, injected: FaultInstance[CellFault]) -> FaultFilter:
        """The stage, for links of a shard that are struck."""


@final
@dataclass(frozen=True, slots=True, eq=False)
class AffectedLinks:
    """Links on which cells of a shard hear something.

    Attributes:
        site: The shard.
        slot: ``(m,)``, where each is among the ``4 n`` slots of the shard's inbox.
        place: ``(m,)``, a number for each that is its own in the whole array.
        message: Type of what they carry.
    """

    site: ShardContext
    slot: Ints
    place: Ints
    message: np.dtype[Any]

    @staticmethod
    def of(site: ShardContext, heard: Ints, message: np.dtype[Any]) -> AffectedLinks:
        """Those that cells of a shard hear, ``(m, 2)`` cell and side."""
        order = np.argsort(site.cells)
        row = order[np.searchsorted(site.cells, heard[:, 0], sorter=order)]
        sides = len(SIDES)
        return AffectedLinks(site, sides * row + heard[:, 1], sides * heard[:, 0] + heard[:, 1], message)

    def __len__(self) -> int:
        return len(self.slot)

    def draws(self, injected: FaultInstance[CellFault], what: str = "", each: int = 1) -> CounterStream:
        """``each`` numbers for each of these links and every tick, ``(each m,)``."""
        return CounterStream(self.site.seed, stream_name(injected, what), stream_ids(self.place, each))


class LinkFilter(FaultFilter):
    """A stage that changes what the struck links bring.

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
        """What the cells hear instead."""
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
        """What the links bring instead.

        Args:
            tick: When; the fault may be over, if it lingers.
            came: ``(m,)``: did a message come?
            words: ``(m,)``, what came, as bare items of the message's size; may be written to.

        Returns:
            The same of what is heard, what is not being of no matter; and by name what is counted, ``(m,)`` each.
        """

    def blank(self, *shape: int) -> Messages:
        """Room for messages of these links, ``(*shape, m)``."""
        return np.zeros((*shape, len(self._links)), dtype=self._nothing.dtype)

    def active_at(self, tick: int) -> bool:
        """Whether the fault acts, rather than has things left to hand over."""
        return self._injected.active_at(tick)
