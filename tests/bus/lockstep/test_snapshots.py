"""What shards remember, on its way to the plant."""

from __future__ import annotations

import pytest

from bus.errors import WireError
from bus.lockstep.counters import MessageCounters
from bus.lockstep.snapshots import ShardSnapshot, SnapshotCollector, decode_snapshot, encode_snapshot
from bus.wire.frames import Control, decode_control, encode_control

SNAPSHOT = ShardSnapshot(7, (4, 3, 2, 1), ((b"\1\0", b"messages"),), b"state")


def test_it_comes_over_as_it_was() -> None:
    assert decode_snapshot(encode_snapshot(SNAPSHOT), 1) == SNAPSHOT


def test_a_snapshot_request_is_encoded_and_decoded() -> None:
    control = Control("snapshot", 7)
    assert decode_control(encode_control(control), 1) == control


def test_a_state_beyond_what_cells_can_have_is_refused() -> None:
    large = encode_snapshot(SNAPSHOT._replace(state=bytes(200_000)))
    assert len(decode_snapshot(large, 3).state) == 200_000
    with pytest.raises(WireError, match="must be at most"):
        decode_snapshot(large, 1)


@pytest.mark.parametrize("counts", [(1, 2, 3), (1, 2, 3, -1), (1, 2, 3, "four"), 4])
def test_counts_that_are_none_are_refused(counts: object) -> None:
    with pytest.raises(WireError, match="counts must be four integers"):
        decode_snapshot(encode_snapshot(SNAPSHOT._replace(counts=counts)), 1)  # type: ignore[arg-type]


def test_a_state_that_is_no_bytes_is_refused() -> None:
    with pytest.raises(WireError, match="state must be bytes"):
        decode_snapshot(encode_snapshot(SNAPSHOT._replace(state="text")), 1)  # type: ignore[arg-type]


@pytest.mark.parametrize("links", [b"", (b"",), ((b"", b"", b""),), (("", ""),)])
def test_messages_that_are_no_pairs_of_bytes_are_refused(links: object) -> None:
    with pytest.raises(WireError, match="links must be a list of two bytes each"):
        decode_snapshot(encode_snapshot(SNAPSHOT._replace(links=links)), 1)  # type: ignore[arg-type]


def test_the_snapshot_is_complete_once_every_shard_has_responded() -> None:
    keeping = SnapshotCollector(7, [0, 2])
    keeping.handle(2, SNAPSHOT)
    keeping.record(MessageCounters(10, 10), {}, [0, 2])
    assert keeping.missing == [0]
    assert keeping.combined({}) is None
    keeping.handle(0, SNAPSHOT._replace(state=b"other"))
    together = keeping.combined({1: MessageCounters(100, 0), 2: MessageCounters(1_000, 0)})
    assert together is not None
    assert together.states == {0: b"other", 2: b"state"}
    assert together.links == dict.fromkeys((0, 2), SNAPSHOT.links)
    # the plant's side, both that answered, and one that had left; not what one that answered said as it left
    assert (together.counts.sent, together.counts.delivered) == (10 + 4 + 4 + 100, 10 + 3 + 3)


def test_a_shard_that_ended_after_the_request_is_not_waited_for() -> None:
    keeping = SnapshotCollector(7, [0, 2])
    keeping.handle(2, SNAPSHOT)
    keeping.record(MessageCounters(), {}, [2])
    together = keeping.combined({0: MessageCounters(100, 0)})
    assert together is not None
    assert together.states.keys() == together.links.keys() == {2}
    assert together.counts.sent == 4 + 100


@pytest.mark.parametrize(("shard", "tick"), [(1, 7), (0, 8)])
def test_an_unrequested_snapshot_is_refused(shard: int, tick: int) -> None:
    with pytest.raises(WireError, match="was not requested"):
        SnapshotCollector(7, [0]).handle(shard, SNAPSHOT._replace(tick=tick))
