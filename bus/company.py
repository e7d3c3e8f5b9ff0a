"""Who takes part in a run, as one shard has it: whom it waits for, and to whom it sends."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import final

from bus.counts import Counts
from bus.incoming import Incoming
from bus.lives import Lives
from bus.outgoing import Outgoing
from bus.partition import Index
from bus.wire import Mask


@final
class Company:
    """Keeps a shard's books of the living; all cells are indices in the lattice.

    Args:
        cells: The shard's own.
        lives: Of the run's cells.
        incoming: What the shard takes in.
        outgoing: What it sends.
        counts: Where to count.
    """

    def __init__(
        self, cells: Index, lives: Lives, incoming: Incoming, outgoing: Outgoing, counts: Counts
    ) -> None:
        self._cells = cells
        self._lives = lives
        self._incoming = incoming
        self._outgoing = outgoing
        self._counts = counts

    def live(self, tick: int) -> Mask:
        """``(n,)``: the shard's cells that take part in ``tick``."""
        return self._lives.live(tick)[self._cells]

    def none_live(self, tick: int) -> bool:
        """Whether no cell of the shard takes part in ``tick``."""
        return not self._lives.all and not self.live(tick).any()

    def plan(self, cells: Iterable[int], tick: int) -> None:
        """``cells`` will be gone for good from ``tick`` on: a scheduled death."""
        self._lives.plan(cells, tick)
        self._bury()

    def retire(self, cells: Iterable[int], tick: int) -> None:
        """``cells`` are gone from ``tick`` on."""
        self._lives.retire(cells, tick)
        self._bury()

    def lose(self, cells: Iterable[int], tick: int) -> None:
        """``cells`` were lost in ``tick``: what they have not said yet, they won't say."""
        waited = self._incoming.awaited
        self.retire(cells, tick)
        self._counts.lost += waited - self._incoming.awaited
        self._incoming.void(tick)

    def expect(self, cells: Iterable[int]) -> None:
        """``cells``, which are gone, may come back."""
        self._incoming.expect(cells)

    def admit(self, cells: Collection[int], tick: int) -> bool:
        """``cells`` take part again from ``tick`` on, which is the next; whether any is the shard's own."""
        self._lives.admit(cells, tick)
        own = self.owns(cells)
        if own:
            self._incoming.enter(tick)
        self._incoming.admit()
        self._outgoing.bury()
        return own

    def owns(self, cells: Iterable[int]) -> bool:
        """Whether any of ``cells`` is the shard's own."""
        return not set(cells).isdisjoint(self._cells.tolist())

    def _bury(self) -> None:
        self._incoming.bury()
        self._outgoing.bury()
