"""What shards remember at a boundary of ticks, handed to the plant so that it can be kept."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final, NamedTuple, cast, final

from bus.errors import WireError
from bus.lockstep.counters import MessageCounters
from bus.transports.base import Publisher
from bus.wire.msgpack_codec import TICK_LIMIT, VERSION, layout, packer, reader

_LAYOUT: Final = layout("counts", "state")
CELL_LIMIT: Final = 64 * 1024
"""Most bytes that one cell's memory may take, and a shard's own beside its cells'."""


class ShardSnapshot(NamedTuple):
    """What one shard remembers before a tick, all before it being over.

    Attributes:
        tick: That tick.
        counts: Payloads that the shard's side has sent, taken in, lost and found late.
        state: Its cells, as ``bus.state`` has it.
    """

    tick: int
    counts: tuple[int, int, int, int]
    state: bytes


def encode_snapshot(kept: ShardSnapshot) -> bytes:
    """The payload of what a shard remembers."""
    return packer()({"v": VERSION, "tick": kept.tick, "counts": kept.counts, "state": kept.state})


def decode_snapshot(payload: bytes, cells: int) -> ShardSnapshot:
    """What a shard of ``cells`` cells remembers; the state itself is not looked at.

    Raises:
        WireError: Anything else.
    """
    tick, fields = reader("memory", (cells + 1) * CELL_LIMIT, _LAYOUT)(payload)
    counts, state = fields["counts"], fields["state"]
    if (
        not isinstance(counts, list)
        or len(cast("Any", counts)) != 4
        or not all(map(_is_count, cast("Any", counts)))
    ):
        raise WireError("memory", "type", "counts must be four integers")
    if type(state) is not bytes:
        raise WireError("memory", "type", "state must be bytes")
    a, b, c, d = cast("list[int]", counts)
    return ShardSnapshot(tick, (a, b, c, d), state)


def _is_count(value: object) -> bool:
    return type(value) is int and 0 <= value < TICK_LIMIT


class GlobalSnapshot(NamedTuple):
    """What all sides of a run remember before a tick.

    Attributes:
        tick: That tick.
        counts: Of all sides.
        states: By shard, what its cells remember; of those that had cells left to step the tick before.
    """

    tick: int
    counts: MessageCounters
    states: dict[int, bytes]


@final
class SnapshotPublisher:
    """A shard's side: tells what it remembers before the tick for which it was asked.

    Args:
        publisher: Of the shard's memory.
        counts: What its side has counted.
    """

    def __init__(self, publisher: Publisher, counts: MessageCounters) -> None:
        self.publisher = publisher
        self._counts = counts
        self._taken_in = 0

    def record_counters(self, taken_in: int) -> None:
        """Note how many payloads had been taken in when all of the tick before was there."""
        self._taken_in = taken_in

    def publish(self, tick: int, state: bytes) -> None:
        """Tell it.

        Args:
            tick: Before which it is remembered.
            state: As ``bus.state`` has it.
        """
        counts = self._counts
        numbers = (counts.sent, self._taken_in, counts.lost, counts.late)
        self.publisher.put(encode_snapshot(ShardSnapshot(tick, numbers, state)))


@final
class SnapshotCollector:
    """The plant's side: takes in what the shards remember before one tick.

    Args:
        tick: Which.
        shards: Who is asked.
    """

    def __init__(self, tick: int, shards: Iterable[int]) -> None:
        self.tick = tick
        self._shards = frozenset(shards)
        self._kept: dict[int, ShardSnapshot] = {}
        self._counts: MessageCounters | None = None

    def record_counters(self, own: MessageCounters) -> None:
        """Note what the plant's side has counted by then."""
        self._counts = own + MessageCounters()

    def handle(self, shard: int, kept: ShardSnapshot) -> None:
        """Take one in.

        Raises:
            WireError: It was not asked for.
        """
        if kept.tick != self.tick or shard not in self._shards:
            raise WireError("memory", "tick", "was not asked for")
        self._kept[shard] = kept

    @property
    def missing(self) -> list[int]:
        """Shards that have not answered."""
        return sorted(self._shards - self._kept.keys())

    def combined(self, left: dict[int, MessageCounters]) -> GlobalSnapshot | None:
        """All of it, once it is there.

        Args:
            left: What shards counted that have left the run.
        """
        if self._counts is None or self.missing:
            return None
        own = [counts for shard, counts in left.items() if shard not in self._shards]
        asked = [MessageCounters(*kept.counts) for kept in self._kept.values()]
        states = {shard: self._kept[shard].state for shard in sorted(self._kept)}
        return GlobalSnapshot(self.tick, sum((*own, *asked), self._counts), states)
