"""How a lattice is cut into shards."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.errors import PartitionError
from bus.lattice import OPPOSITE, Lattice
from bus.partition import Links, Partition
from tests.bus.support import grid

CELLS = st.sets(st.tuples(st.integers(0, 5), st.integers(0, 5)), min_size=1, max_size=20)


@st.composite
def partitions(draw: st.DrawFn) -> Partition:
    """An irregular lattice cut at random, not only into runs."""
    lattice = Lattice(draw(CELLS))
    wanted = draw(st.lists(st.integers(0, 4), min_size=len(lattice), max_size=len(lattice)))
    shards = [[i for i, shard in enumerate(wanted) if shard == name] for name in sorted(set(wanted))]
    return Partition(lattice, shards)


def as_set(links: Links) -> set[tuple[int, int, int, int]]:
    return set(
        zip(
            links.source.tolist(),
            links.source_side.tolist(),
            links.target.tolist(),
            links.target_side.tolist(),
            strict=True,
        )
    )


@given(partitions())
def test_every_cell_is_in_one_shard_at_the_place_that_the_partition_says(partition: Partition) -> None:
    found = np.concatenate([partition.cells(s) for s in range(partition.count)])
    assert sorted(found.tolist()) == list(range(len(partition.lattice)))
    for shard in range(partition.count):
        cells = partition.cells(shard)
        assert (partition.shard_of[cells] == shard).all()
        assert (partition.position[cells] == np.arange(len(cells))).all()


@given(partitions())
def test_every_link_is_inside_one_shard_or_goes_out_of_one_and_into_another(partition: Partition) -> None:
    lattice = partition.lattice
    expected = {
        (i, side, int(lattice.neighbours[i, side]), OPPOSITE[side])
        for i in range(len(lattice))
        for side in range(4)
        if lattice.neighbours[i, side] >= 0
    }
    shards = range(partition.count)
    inside = [as_set(partition.inside(s)) for s in shards]
    outgoing = [as_set(partition.outgoing(s)) for s in shards]
    incoming = [as_set(partition.incoming(s)) for s in shards]
    assert set().union(*inside, *outgoing) == expected
    assert set().union(*inside, *incoming) == expected
    assert sum(map(len, inside)) + sum(map(len, outgoing)) == len(expected)


@given(partitions())
def test_both_ends_of_a_border_order_its_links_alike(partition: Partition) -> None:
    for source in range(partition.count):
        outgoing = partition.outgoing(source)
        for border in partition.outgoing_borders(source):
            incoming = partition.incoming(border.shard)
            (other,) = [b for b in partition.incoming_borders(border.shard) if b.shard == source]
            for name in ("source", "source_side", "target", "target_side"):
                mine = getattr(outgoing, name)[border.start : border.stop]
                theirs = getattr(incoming, name)[other.start : other.stop]
                assert mine.tolist() == theirs.tolist()


@given(partitions())
def test_links_ascend_by_the_other_shard_then_the_sending_cell_then_its_side(partition: Partition) -> None:
    for shard in range(partition.count):
        for links, other in (
            (partition.outgoing(shard), partition.outgoing(shard).target),
            (partition.incoming(shard), partition.incoming(shard).source),
        ):
            shards = partition.shard_of[other].tolist()
            found = list(zip(shards, links.source.tolist(), links.source_side.tolist(), strict=True))
            assert found == sorted(found)


@given(partitions())
def test_borders_cover_the_links_without_gaps(partition: Partition) -> None:
    for shard in range(partition.count):
        for borders, links in (
            (partition.outgoing_borders(shard), partition.outgoing(shard)),
            (partition.incoming_borders(shard), partition.incoming(shard)),
        ):
            stops = [0, *(b.stop for b in borders)]
            assert [b.start for b in borders] == stops[:-1]
            assert stops[-1] == len(links)


def test_an_even_cut_gives_consecutive_runs_within_one_of_each_other() -> None:
    partition = Partition.even(grid(3, 6), 4)
    sizes = [len(partition.cells(s)) for s in range(4)]
    assert sizes == [5, 5, 4, 4]
    assert np.concatenate([partition.cells(s) for s in range(4)]).tolist() == list(range(18))


def test_one_shard_a_cell_has_no_links_inside() -> None:
    partition = Partition.each(grid(2, 2))
    assert partition.count == 4
    assert all(len(partition.inside(s)) == 0 for s in range(4))
    assert as_set(partition.outgoing(0)) == {(0, 0, 2, 2), (0, 1, 1, 3)}


@pytest.mark.parametrize(
    ("shards", "said"),
    [
        ([[0, 1], [1, 2, 3]], "another shard holds already"),
        ([[0, 1], [3]], "cell 1,0 is in no shard"),
        ([[0, 1, 2, 3], []], "shard 1 has no cells"),
        ([[1, 0], [2, 3]], "must ascend"),
        ([[0, 1], [2, 3, 4]], "within 0..3"),
    ],
)
def test_a_cut_that_is_none_is_refused(shards: list[list[int]], said: str) -> None:
    with pytest.raises(PartitionError, match=said):
        Partition(grid(2, 2), shards)


@pytest.mark.parametrize("count", [0, 5])
def test_there_are_at_least_one_and_at_most_as_many_shards_as_cells(count: int) -> None:
    with pytest.raises(PartitionError, match=r"must be 1\.\.4"):
        Partition.even(grid(2, 2), count)
