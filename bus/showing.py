"""Registers of cells on their way: shown by a shard where somebody wants to see them, seen by the plant."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from bus.counts import Counts
from bus.errors import WireError
from bus.partition import Partition
from bus.registers import (
    RegisterFrame,
    Shown,
    Wanted,
    decode_registers,
    due,
    encode_registers,
    joined,
    shown,
)
from bus.transport import Publisher

_SHOW_S: Final = 0.2
"""How often to look whether somebody wants to see the cells' registers, and how often they are shown then."""

Own = tuple[NDArray[np.int64], Mapping[str, NDArray[Any]]]
"""Who some cells are, ``(n, 2)`` row and column, and their registers by name, arrays with a row for each."""


@final
class Showing:
    """A shard's side: shows the registers of its cells.

    Args:
        publisher: Of the shard's registers.
        wanted: What the plant wants to see.
        counts: Where to count.
        clock: Monotonic wall seconds.
    """

    def __init__(
        self, publisher: Publisher, wanted: Sequence[Wanted], counts: Counts, clock: Callable[[], float]
    ) -> None:
        self.publisher = publisher
        self.wanted = tuple(wanted)
        self._counts = counts
        self._clock = clock
        self._next_look = 0.0

    def show(self, tick: int, read: Callable[[], Own]) -> None:
        """Puts the registers after ``tick``, if the plant or somebody else wants to see them.

        Args:
            tick: That the cells have computed.
            read: Gives them; asked only where somebody wants to see.
        """
        wanted = due(self.wanted, tick)
        if (wanted is None or wanted.names is not None) and self._watched():
            wanted = Wanted(1)
        if wanted is None:
            return
        cells, registers = read()
        if wanted.names is not None:
            registers = {name: array for name, array in registers.items() if name in wanted.names}
        self.publisher.put(encode_registers(RegisterFrame(tick, cells, shown(registers))))
        self._counts.sent += 1

    def _watched(self) -> bool:
        """Whether somebody may want to see all registers now: looked up a few times a second."""
        now = self._clock()
        if now < self._next_look:
            return False
        self._next_look = now + _SHOW_S
        return self.publisher.matched()


@final
class Seen:
    """The plant's side: takes in what shards show.

    Args:
        partition: How the cells are cut into shards.
        wanted: What the plant wants to see.
        counts: Where to count.
        now: Gives the tick that is under way.
    """

    def __init__(
        self,
        partition: Partition,
        wanted: Sequence[Wanted],
        counts: Counts,
        now: Callable[[], int],
    ) -> None:
        self._partition = partition
        self._wanted = tuple(wanted)
        self._counts = counts
        self._now = now
        self._frames: dict[tuple[int, int], RegisterFrame] = {}
        """By tick and shard."""

    def take(self, shard: int, payload: bytes) -> None:
        """Takes in what a shard shows.

        Raises:
            WireError: Not such a payload, of cells that are not its own, or not of this tick, or the second of it.
        """
        frame = decode_registers(payload, len(self._partition.cells(shard)))
        rows = self._partition.lattice.find(*frame.cells.T.astype(np.int64))
        if (rows < 0).any() or (self._partition.shard_of[rows] != shard).any():
            raise WireError("registers", "cells", f"must be cells of shard {shard}")
        # They come between the senses of their tick and its drives.
        now = self._now()
        if frame.tick > now:
            raise WireError("registers", "ahead", f"tick {frame.tick}: must be at most {now}")
        if frame.tick < now:
            self._counts.late += 1
            return
        if (frame.tick, shard) in self._frames:
            raise WireError("registers", "duplicate", f"tick {frame.tick} came already")
        self._counts.delivered += 1
        if due(self._wanted, frame.tick) is not None:
            self._frames[frame.tick, shard] = frame  # others are for those who watch

    def take_all(self) -> list[Shown]:
        """What cells have shown since the last call; a tick's is there when its drives are."""
        frames, self._frames = self._frames, {}
        return joined(list(frames.values()), self._partition.lattice)
