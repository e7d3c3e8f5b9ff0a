"""Distances over the links of a lattice, as theory has them: breadth first, all of the lattice at once."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from bus.lattice import Lattice


def hops_to(
    lattice: Lattice, goals: Iterable[int], passes: Callable[[int, int], bool] | None = None
) -> NDArray[np.int64]:
    """Links from every cell to the nearest goal.

    Args:
        lattice: The cells.
        goals: Indices of the goals.
        passes: Whether the link from a cell, by its index, on a side may be used; default: all may.

    Returns:
        ``(n,)``; -1 where no way leads to a goal.
    """
    away = np.full(len(lattice), -1)
    waiting = deque(sorted(set(goals)))
    away[list(waiting)] = 0
    while waiting:
        here = waiting.popleft()
        for side, there in enumerate(lattice.neighbours[here].tolist()):
            # the way is walked backwards: from there to here, over the side that faces this one
            if there >= 0 and away[there] < 0 and (passes is None or passes(there, (side + 2) % 4)):
                away[there] = away[here] + 1
                waiting.append(there)
    return away
