"""Distributed snapshots: the state of all shards at a tick boundary, collected by the plant."""

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
    """State of one shard before a tick, after all earlier ticks are complete.

    Attributes:
        tick: Tick before which the state was saved.
        counts: Payloads that the shard has sent, received, lost and found late.
        state: State of the cells, from ``bus.state.save_state``.
    """

    tick: int
    counts: tuple[int, int, int, int]
    state: bytes


def encode_snapshot(snapshot: ShardSnapshot) -> bytes:
    """Encode the snapshot of a shard."""
    return packer()({"v": VERSION, "tick": snapshot.tick, "counts": snapshot.counts, "state": snapshot.state})


def decode_snapshot(payload: bytes, cells: int) -> ShardSnapshot:
    """Decode the snapshot of a shard of ``cells`` cells; the state itself is not decoded.

    Raises:
        WireError: Anything else.
    """
    tick, fields = reader("snapshot", (cells + 1) * CELL_LIMIT, _LAYOUT)(payload)
    counts, state = fields["counts"], fields["state"]
    if (
        not isinstance(counts, list)
        or len(cast("Any", counts)) != 4
        or not all(map(_is_count, cast("Any", counts)))
    ):
        raise WireError("snapshot", "type", "counts must be four integers")
    if type(state) is not bytes:
        raise WireError("snapshot", "type", "state must be bytes")
    a, b, c, d = cast("list[int]", counts)
    return ShardSnapshot(tick, (a, b, c, d), state)


def _is_count(value: object) -> bool:
    return type(value) is int and 0 <= value < TICK_LIMIT


class GlobalSnapshot(NamedTuple):
    """State of all sides of a run before a tick.

    Attributes:
        tick: Tick before which the state was saved.
        counts: Counters of all sides.
        states: By shard, state of the cells; only shards with a live cell in the previous tick.
    """

    tick: int
    counts: MessageCounters
    states: dict[int, bytes]


@final
class SnapshotPublisher:
    """Publisher of a shard's snapshot before the requested tick.

    Args:
        publisher: Publisher on the shard's snapshot key.
        counts: Counters of the shard's side.
    """

    def __init__(self, publisher: Publisher, counts: MessageCounters) -> None:
        self.publisher = publisher
        self._counts = counts
        self._taken_in = 0

    def record_counters(self, taken_in: int) -> None:
        """Record the number of payloads received when the previous tick was complete."""
        self._taken_in = taken_in

    def publish(self, tick: int, state: bytes) -> None:
        """Publish the snapshot.

        Args:
            tick: Tick before which the state was saved.
            state: Result of ``bus.state.save_state``.
        """
        counts = self._counts
        numbers = (counts.sent, self._taken_in, counts.lost, counts.late)
        self.publisher.put(encode_snapshot(ShardSnapshot(tick, numbers, state)))


@final
class SnapshotCollector:
    """Collector of the shards' snapshots before one tick, on the plant's side.

    Args:
        tick: Tick before which the state is saved.
        shards: Shards that must answer.
    """

    def __init__(self, tick: int, shards: Iterable[int]) -> None:
        self.tick = tick
        self._shards = frozenset(shards)
        self._snapshots: dict[int, ShardSnapshot] = {}
        self._counts: MessageCounters | None = None

    def record_counters(self, own: MessageCounters) -> None:
        """Record the plant's counters before the tick."""
        self._counts = own + MessageCounters()

    def handle(self, shard: int, snapshot: ShardSnapshot) -> None:
        """Handle the snapshot of a shard.

        Raises:
            WireError: The snapshot was not requested.
        """
        if snapshot.tick != self.tick or shard not in self._shards:
            raise WireError("snapshot", "tick", "was not requested")
        self._snapshots[shard] = snapshot

    @property
    def missing(self) -> list[int]:
        """Shards that have not answered."""
        return sorted(self._shards - self._snapshots.keys())

    def combined(self, left: dict[int, MessageCounters]) -> GlobalSnapshot | None:
        """Return the global snapshot once it is complete, else None.

        Args:
            left: Counters of shards that have left the run.
        """
        if self._counts is None or self.missing:
            return None
        own = [counts for shard, counts in left.items() if shard not in self._shards]
        counters = [MessageCounters(*snapshot.counts) for snapshot in self._snapshots.values()]
        states = {shard: self._snapshots[shard].state for shard in sorted(self._snapshots)}
        return GlobalSnapshot(self.tick, sum((*own, *counters), self._counts), states)
