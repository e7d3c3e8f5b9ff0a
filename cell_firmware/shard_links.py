"""Links of a shard's cells, among each other and over its border."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from bus.partition import Partition

Indices = NDArray[np.int64]

NO_SOURCE: Final = -1
"""Source of a side on which no neighbour is."""


@final
@dataclass(frozen=True, slots=True)
class ShardLinks:
    """Links of a shard, by slots: slot ``4 row + side`` is that side of a cell.

    Attributes:
        cells: Number of cells of the shard.
        inner_from: Slots of the outbox, ...
        inner_to: ... and the slots of the inbox that they lead to.
        out_from: Slots of the outbox that lead over the border, in the order of ``partition.outgoing``.
        in_to: Slots of the inbox that links of the border lead to, in the order of ``partition.incoming``.
    """

    cells: int
    inner_from: Indices
    inner_to: Indices
    out_from: Indices
    in_to: Indices

    @staticmethod
    def of(partition: Partition, shard: int) -> ShardLinks:
        """Return the links of a shard of a partition."""
        position = partition.position
        inside, outgoing, incoming = (
            partition.inside(shard),
            partition.outgoing(shard),
            partition.incoming(shard),
        )
        return ShardLinks(
            len(partition.cells(shard)),
            4 * position[inside.source] + inside.source_side,
            4 * position[inside.target] + inside.target_side,
            4 * position[outgoing.source] + outgoing.source_side,
            4 * position[incoming.target] + incoming.target_side,
        )

    def sources(self) -> Indices:
        """Return the source of each slot of the inbox, ``(4 n,)``.

        A slot of the outbox; or ``NO_SOURCE - 1 - k`` for link k of the border, or ``NO_SOURCE``.
        """
        sources = np.full(4 * self.cells, NO_SOURCE, dtype=np.int64)
        sources[self.inner_to] = self.inner_from
        sources[self.in_to] = NO_SOURCE - 1 - np.arange(len(self.in_to))
        return sources
