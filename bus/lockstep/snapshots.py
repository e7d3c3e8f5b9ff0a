"""Distributed snapshots: the state of all shards at a tick boundary, collected by the plant."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final, NamedTuple, cast, final

from bus.errors import WireError
from bus.lockstep.counters import MessageCounters
from bus.transports.base import Publisher
from bus.wire.format import RelayedLinks
from bus.wire.frames import LinkFrame
from bus.wire.msgpack_codec import TICK_LIMIT, VERSION, layout, packer, reader

_LAYOUT: Final = layout("counts", "links", "state")
CELL_LIMIT: Final = 64 * 1024
"""Most bytes that one cell's memory may take, and a shard's own beside its cells'."""


MessageBytes = tuple[bytes, bytes]
"""Messages of a tick: a byte a link, 1 where a message was sent, and the messages as they are declared."""


class ShardSnapshot(NamedTuple):
    """State of one shard before a tick, after all earlier ticks are complete.

    Attributes:
        tick: Tick before which the state was saved.
        counts: Payloads that the shard has sent, received, lost and found late.
        links: Messages over the shard's incoming links that had been sent and not read, a tick each, oldest first;
            none where the coordinator relays them.
        state: State of the cells, from ``bus.state.save_state``.
    """

    tick: int
    counts: tuple[int, int, int, int]
    links: tuple[MessageBytes, ...]
    state: bytes


def encode_snapshot(snapshot: ShardSnapshot) -> bytes:
    """Encode the snapshot of a shard."""
    return packer()({"v": VERSION, **snapshot._asdict()})


def decode_snapshot(payload: bytes, cells: int) -> ShardSnapshot:
    """Decode the snapshot of a shard of ``cells`` cells; the state itself is not decoded.

    Raises:
        WireError: Anything else.
    """
    tick, fields = reader("snapshot", (cells + 1) * CELL_LIMIT, _LAYOUT)(payload)
    counts, links, state = fields["counts"], fields["links"], fields["state"]
    if (
        not isinstance(counts, list)
        or len(cast("Any", counts)) != 4
        or not all(map(_is_count, cast("Any", counts)))
    ):
        raise WireError("snapshot", "type", "counts must be four integers")
    if type(state) is not bytes:
        raise WireError("snapshot", "type", "state must be bytes")
    if not isinstance(links, list) or not all(map(_is_pair, cast("Any", links))):
        raise WireError("snapshot", "type", "links must be a list of two bytes each")
    a, b, c, d = cast("list[int]", counts)
    return ShardSnapshot(tick, (a, b, c, d), tuple((one[0], one[1]) for one in cast("Any", links)), state)


def _is_count(value: object) -> bool:
    return type(value) is int and 0 <= value < TICK_LIMIT


def _is_pair(value: object) -> bool:
    pair = cast("list[object]", value)
    return type(value) is list and len(pair) == 2 and all(type(part) is bytes for part in pair)


class GlobalSnapshot(NamedTuple):
    """State of all sides of a run before a tick.

    Attributes:
        tick: Tick before which the state was saved.
        counts: Counters of all sides; messages that had been sent and not read count as delivered.
        states: By shard, state of the cells; only shards with a live cell in the previous tick.
        links: By shard, ``ShardSnapshot.links``; the same shards.
        relayed: Messages that the coordinator had not passed on, by the tick in which they were sent.
    """

    tick: int
    counts: MessageCounters
    states: dict[int, bytes]
    links: dict[int, tuple[MessageBytes, ...]]
    relayed: dict[int, MessageBytes]


@final
class SnapshotPublisher:
    """Publisher of a shard's snapshot before the requested tick.

    The snapshot holds the messages that are on their way to the shard at that time. They are recorded as the shard
    reads them in the ticks after, and the snapshot is published with the last of them (Chandy and Lamport,
    *Distributed Snapshots*, ACM TOCS 3(1), 1985).

    Args:
        publisher: Publisher on the shard's snapshot key.
        counts: Counters of the shard's side.
        link_ticks: Ticks in which messages are read that were sent before; 0: the shard gets none from others, or with
            its senses.
    """

    def __init__(self, publisher: Publisher, counts: MessageCounters, link_ticks: int) -> None:
        self.publisher = publisher
        self._counts = counts
        self._link_ticks = link_ticks
        self._taken_in = 0
        self._draft: ShardSnapshot | None = None

    def record_counters(self, taken_in: int) -> None:
        """Record the number of payloads received when the previous tick was complete."""
        self._taken_in = taken_in

    def begin(self, tick: int, state: bytes) -> None:
        """Begin the snapshot.

        Args:
            tick: Tick before which the state was saved.
            state: Result of ``bus.state.save_state``.
        """
        counts = self._counts
        numbers = (counts.sent, self._taken_in, counts.lost, counts.late)
        self._draft = ShardSnapshot(tick, numbers, (), state)
        if not self._link_ticks:
            self.publish()

    def record_links(self, links: LinkFrame | None, parts: int) -> None:
        """Record the messages read in a tick, which came in so many payloads; publish the snapshot with the last."""
        draft = self._draft
        if draft is None or links is None:
            return
        sent, delivered, lost, late = draft.counts
        self._draft = draft._replace(
            counts=(sent, delivered + parts, lost, late),
            links=(*draft.links, (links.sent.tobytes(), links.message.tobytes())),
        )
        if len(self._draft.links) == self._link_ticks:
            self.publish()

    def publish(self) -> None:
        """Publish the snapshot in progress, if any."""
        if self._draft is not None:
            self.publisher.put(encode_snapshot(self._draft))
            self._draft = None


@final
class SnapshotCollector:
    """Collector of the shards' snapshots before one tick, on the plant's side.

    Args:
        tick: Tick before which the state is saved.
        shards: Shards that are asked.
    """

    def __init__(self, tick: int, shards: Iterable[int]) -> None:
        self.tick = tick
        self._asked = self._awaited = frozenset(shards)
        self._snapshots: dict[int, ShardSnapshot] = {}
        self._counts: MessageCounters | None = None
        self._relayed: dict[int, MessageBytes] = {}

    def record(self, own: MessageCounters, relayed: Mapping[int, RelayedLinks], live: Iterable[int]) -> None:
        """Record the plant's side before the tick.

        Args:
            own: Its counters.
            relayed: Messages still to be passed on, by the tick in which they were sent.
            live: Shards with a live cell in the tick before. No other answers: it ended after the request.
        """
        self._awaited &= frozenset(live)
        self._counts = own + MessageCounters()
        self._relayed = {
            sent_in: (links.sent.tobytes(), links.message.tobytes()) for sent_in, links in relayed.items()
        }

    def handle(self, shard: int, snapshot: ShardSnapshot) -> None:
        """Handle the snapshot of a shard.

        Raises:
            WireError: The snapshot was not requested.
        """
        if snapshot.tick != self.tick or shard not in self._asked:
            raise WireError("snapshot", "tick", "was not requested")
        self._snapshots[shard] = snapshot

    @property
    def missing(self) -> list[int]:
        """Shards that have not answered."""
        return sorted(self._awaited - self._snapshots.keys())

    def combined(self, left: dict[int, MessageCounters]) -> GlobalSnapshot | None:
        """Return the global snapshot once it is complete, else None.

        Args:
            left: Counters of shards that have left the run.
        """
        if self._counts is None or self.missing:
            return None
        own = [counts for shard, counts in left.items() if shard not in self._awaited]
        shards = sorted(self._awaited)
        counters = [MessageCounters(*self._snapshots[shard].counts) for shard in shards]
        return GlobalSnapshot(
            self.tick,
            sum((*own, *counters), self._counts),
            {shard: self._snapshots[shard].state for shard in shards},
            {shard: self._snapshots[shard].links for shard in shards},
            self._relayed,
        )
