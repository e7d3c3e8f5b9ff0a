"""How far cells of an array are from some of them, step by step from neighbour to neighbour."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from bus.lattice import Lattice

Ints = NDArray[np.int64]
_FACING: Final = np.array([2, 3, 0, 1])
"""Of each side, the one of the neighbour there that faces it."""


def steps_to(lattice: Lattice, cells: Ints, passes: NDArray[np.bool_] | None = None) -> Ints:
    """Steps from each cell to the nearest of some.

    Args:
        lattice: The cells.
        cells: Indices of those.
        passes: ``(n, 4)``: may the link from a cell on that side be used? None: all may.

    Returns:
        ``(n,)``; -1 where no way leads there.
    """
    steps = np.full(len(lattice), -1)
    front, count = np.unique(cells), 0
    while len(front):
        steps[front] = count
        near = lattice.neighbours[front]
        # the way is walked backwards: from there to here, over the side that faces this one
        way = (near >= 0) & (True if passes is None else passes[near, _FACING])
        front = np.unique(near[way & (steps[near] < 0)])
        count += 1
    return steps


def leaders(lattice: Lattice, key: Ints) -> Ints:
    """``(n,)``: for each cell the index of the one with the greatest key that it can reach; keys differ."""
    leader = np.full(len(lattice), -1)
    for cell in np.argsort(-key):
        if leader[cell] < 0:
            leader[steps_to(lattice, np.array([cell])) >= 0] = cell
    return leader


def parts(lattice: Lattice) -> Ints:
    """``(n,)``: the number of the part of the array that a cell is in, from 0, of cells that can reach each other."""
    return np.unique(leaders(lattice, np.arange(len(lattice))), return_inverse=True)[1]
