"""Cells that find each other, tick by tick, on an array without sensors of its own: who is covered is given."""

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from bus.lattice import OPPOSITE, Lattice
from cell_firmware.estimation import election as group

HALO, HOLD = 2, 8


class Cells:
    """All cells of a lattice, which send their neighbours what they found in the round before."""

    def __init__(self, lattice: Lattice) -> None:
        n = len(lattice)
        self.lattice = lattice
        nothing = np.zeros(n, dtype=np.int64)
        nobody = np.full(n, group.NOBODY)
        self.place = group.ElectionState(nothing, nobody, nothing, np.full(n, group.ROOT), nobody, nothing)
        self.kids = np.zeros((n, 4), dtype=np.bool_)
        self.dead: set[int] = set()

    def round(self, covered: Iterable[tuple[int, int]]) -> group.ElectionState:
        over = np.zeros(len(self.lattice), dtype=np.bool_)
        over[[self.lattice.index(cell) for cell in covered]] = True
        said = np.zeros(len(self.lattice), dtype=np.dtype(group.FIELDS))
        for name in ("level", "leader", "hops", "parent"):
            said[name] = getattr(self.place, name)
        there = self.lattice.neighbours
        alive = np.array([i not in self.dead for i in range(len(self.lattice))])
        valid = (there >= 0) & alive[there]
        neighbour = said[there]
        leads = (self.place.parent == group.ROOT) & (self.place.leader != group.NOBODY)
        own = group.keys(self.lattice.rows, self.lattice.columns, leads)
        level = group.levels(over, neighbour, valid, HALO)
        self.place = group.elect(own, over, level, neighbour, valid, self.place, HOLD)
        self.kids = group.children(self.place, neighbour, valid)
        return self.place

    def leaders(self) -> list[tuple[int, int]]:
        leads = (self.place.parent == group.ROOT) & (self.place.leader != group.NOBODY)
        return [self.lattice.cells[int(i)] for i in np.flatnonzero(leads) if int(i) not in self.dead]


def block(row: int, column: int, rows: int = 3, columns: int = 4) -> list[tuple[int, int]]:
    return [(row + r, column + c) for r in range(rows) for c in range(columns)]


def below(cells: Cells) -> NDArray[np.int64]:
    """How many cells each has under it in the tree that the children make, itself included."""
    found = np.ones(len(cells.lattice), dtype=np.int64)
    for i in np.argsort(-cells.place.hops):
        for side in range(4):
            if cells.kids[i, side]:
                child = int(cells.lattice.neighbours[i, side])
                assert cells.place.parent[child] == OPPOSITE[side]
                found[i] += found[child]
    return found


def test_cells_under_a_parcel_and_around_it_form_one_tree_under_the_least_of_them(
    grid: Callable[..., Lattice],
) -> None:
    cells = Cells(grid(12, 12))
    for _ in range(15):
        cells.round(block(4, 5))
    place = cells.round(block(4, 5))
    assert cells.leaders() == [(4, 5)]
    member = place.level > 0
    apart = [min(abs(r - s) + abs(c - d) for s, d in block(4, 5)) for r, c in cells.lattice.cells]
    assert np.array_equal(member, np.array(apart) <= HALO)
    steps = abs(cells.lattice.rows - 4) + abs(cells.lattice.columns - 5)
    assert np.array_equal(place.hops[member], steps[member])
    assert below(cells)[cells.lattice.index((4, 5))] == member.sum()


def test_a_leader_stays_while_it_senses_the_parcel_though_lesser_cells_join(
    grid: Callable[..., Lattice],
) -> None:
    cells = Cells(grid(12, 12))
    for _ in range(16):
        cells.round(block(4, 5))
    for row in (3, 2):
        for _ in range(6):
            cells.round(block(row, 5))
            assert cells.leaders() == [(4, 5)]


def test_when_the_leader_is_gone_its_name_dies_within_the_width_of_the_group_and_another_leads(
    grid: Callable[..., Lattice],
) -> None:
    cells = Cells(grid(12, 12))
    for _ in range(16):
        cells.round(block(4, 5))
    name = int(cells.place.leader[cells.lattice.index((4, 5))])
    widest = int(cells.place.hops.max())
    cells.dead.add(cells.lattice.index((4, 5)))
    living = [cell for cell in block(4, 5) if cell != (4, 5)]
    for _ in range(widest + 2):
        cells.round(living)
    alive = np.array([i not in cells.dead for i in range(len(cells.lattice))])
    assert not (cells.place.leader == name)[alive].any()
    for _ in range(HOLD + 16):
        cells.round(living)
    assert len(cells.leaders()) == 1


def test_two_parcels_apart_have_two_leaders_and_when_they_come_near_one(
    grid: Callable[..., Lattice],
) -> None:
    cells = Cells(grid(8, 24))
    far, near = [*block(2, 2), *block(2, 14)], [*block(2, 2), *block(2, 9)]
    for _ in range(20):
        cells.round(far)
    assert cells.leaders() == [(2, 2), (2, 14)]
    for _ in range(40):
        cells.round(near)
    assert len(cells.leaders()) == 1
