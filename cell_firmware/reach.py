"""How far cells of an array are from some of them, step by step from neighbour to neighbour."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bus.lattice import Lattice

Ints = NDArray[np.int64]


def steps_from(lattice: Lattice, cells: Ints) -> Ints:
    """``(n,)``: steps from each cell to the nearest of ``cells`` (indices); -1 where no way leads there."""
    steps = np.full(len(lattice), -1)
    front, count = np.unique(cells), 0
    while len(front):
        steps[front] = count
        near = lattice.neighbours[front]
        front = np.unique(near[(near >= 0) & (steps[near] < 0)])
        count += 1
    return steps


def leaders(lattice: Lattice, key: Ints) -> Ints:
    """``(n,)``: for each cell the index of the one with the greatest key that it can reach; keys differ."""
    leader = np.full(len(lattice), -1)
    for cell in np.argsort(-key):
        if leader[cell] < 0:
            leader[steps_from(lattice, np.array([cell])) >= 0] = cell
    return leader


def parts(lattice: Lattice) -> Ints:
    """``(n,)``: the number of the part of the array that a cell is in, from 0, of cells that can reach each other."""
    return np.unique(leaders(lattice, np.arange(len(lattice))), return_inverse=True)[1]
