"""Spanning tree: cells elect a root, carry parcels to it along the tree, and count what there is."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, ClassVar, Final, final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from bus.lattice import STEPS, Lattice
from cell_firmware.array_view import ArrayView
from cell_firmware.errors import ParametersError, Problem
from cell_firmware.firmware import Cells, State
from cell_firmware.kit.convergecast import broadcast, subtotal
from cell_firmware.kit.election import elect
from cell_firmware.kit.gradient import NOBODY
from cell_firmware.kit.silence import aged
from cell_firmware.kit.tree import is_child
from cell_firmware.program import Theory
from cell_firmware.scalar_program import ScalarProgram
from cell_firmware.specs import NotNegative, Spec
from cell_firmware.toolkit.graph import hop_distance, reachable_maximum
from cell_firmware.toolkit.hold import Ttl
from cell_firmware.toolkit.regions import Ints, Region, region_problems

PLACES: Final = 1 << 12
"""Rows and columns that a key has room for."""
LAST: Final = 255
"""Rank of cells that ``roots`` doesn't name."""
MOST: Final = 1 << 31
"""Greatest count."""
AHEAD_X: Final = tuple(float(column) for _, column in STEPS)
AHEAD_Y: Final = tuple(float(row) for row, _ in STEPS)


class SpanningTreeParameters(Spec):
    """Candidates for the root, speed, and limits of distance and silence."""

    roots: Annotated[tuple[Region, ...], Field(max_length=LAST)] = ()
    """Cells that lead before all others, the first region before the second. Among equals the lowest row leads, then
    the lowest column."""
    speed_m_s: NotNegative = 0.0
    """Speed of the wheels towards the parent; at the root they stand."""
    limit: Annotated[int, Field(ge=2, le=65_535)] = 255
    """Distance at which news of a root is dropped; must exceed the distance of any two cells."""
    ttl_periods: Ttl = 1
    """Validity of a neighbour's message, periods; a neighbour that is silent for longer counts as dead."""


@final
class SpanningTree(ScalarProgram):
    """Self-stabilising tree of shortest ways to an elected root, with counts that every cell learns.

    In every tick a cell elects the root of the least key around, at bounded distance, and the neighbour nearest to that
    root as its parent. It adds up the counts of its children: cells, and cells that sense a parcel. The root's sums go
    back down the tree.

    From any registers, and after any deaths: on links that neither lose nor delay, with ``A = ttl_periods`` and D the
    longest of the remaining shortest ways to a root, the tree is right after ``(limit + D + 1) A`` ticks, and all cells
    know the counts after ``2 (D + 1) A`` ticks more.

    Source: A. Arora and M. Gouda, "Distributed reset", IEEE Trans. Computers 43 (1994); A. Segall, "Distributed network
    protocols", IEEE Trans. Information Theory 29 (1983).
    """

    Parameters = SpanningTreeParameters
    message = np.dtype(
        [
            ("root", "<u4"),
            ("distance", "<u2"),
            ("parent", "u1"),
            ("cells", "<u4"),
            ("covered", "<u4"),
            ("all_cells", "<u4"),
            ("all_covered", "<u4"),
        ]
    )
    observable = "distance"
    is_brief = True
    compared_ticks: ClassVar[int] = 0
    constants_type = np.dtype([("limit", "<i8"), ("ttl_periods", "<i8"), ("speed_m_s", "<f8")])
    state_type = np.dtype(
        [
            ("own", "<i8"),  # the cell's key: rank, row, column
            ("root", "<i8"),  # key of the root
            ("distance", "<i8"),
            ("parent", "<i8"),  # side, or NOBODY
            ("cells", "<i8"),  # counted below the cell, itself included
            ("covered", "<i8"),
            ("all_cells", "<i8"),  # counted by the root
            ("all_covered", "<i8"),
            ("child", "u1", (4,)),
            ("counts", "<i8", (4,)),  # for how many periods a neighbour's message is valid
            ("their_root", "<i8", (4,)),
            ("their_distance", "<i8", (4,)),
            ("their_parent", "<i8", (4,)),
            ("their_cells", "<i8", (4,)),
            ("their_covered", "<i8", (4,)),
            ("their_all_cells", "<i8", (4,)),
            ("their_all_covered", "<i8", (4,)),
        ],
        align=True,
    )

    def check(self, lattice: Lattice) -> None:
        """Refuse regions without cells, cells named twice, and arrays too large for the keys."""
        problems = region_problems(lattice, {"roots": self.parameters.roots})
        if max(lattice.rows.max(), lattice.columns.max()) >= PLACES:
            problems += (Problem((), f"rows and columns must be below {PLACES}"),)
        if problems:
            raise ParametersError("spanning_tree", problems)

    def constants(self) -> Mapping[str, float]:
        """Return limits and speed."""
        given: SpanningTreeParameters = self.parameters
        return {"limit": given.limit, "ttl_periods": given.ttl_periods, "speed_m_s": given.speed_m_s}

    def init(self, cells: Cells) -> State:
        """Return the initial state: each cell is its own root."""
        n, own = len(cells), self._keys(cells.row, cells.column)
        nothing, each = np.zeros(n, dtype=np.int64), np.zeros((n, 4), dtype=np.int64)
        theirs = ("root", "distance", "parent", "cells", "covered", "all_cells", "all_covered")
        return {
            "own": own,
            "root": own,
            "distance": nothing,
            "parent": nothing + NOBODY,
            **dict.fromkeys(theirs[3:], nothing),
            "child": np.zeros((n, 4), dtype=np.uint8),
            "counts": each,
            **{f"their_{name}": each for name in theirs},
        }

    @staticmethod
    def cell_step(constants: Any, state: Any, inputs: Any, outputs: Any) -> None:
        """Elect, choose the parent, count, and drive towards the parent."""
        for side in range(4):
            state.counts[side] = aged(inputs.received[side] != 0, state.counts[side], constants.ttl_periods)
            if inputs.received[side]:
                state.their_root[side] = inputs.message[side].root
                state.their_distance[side] = inputs.message[side].distance
                state.their_parent[side] = inputs.message[side].parent
                state.their_cells[side] = inputs.message[side].cells
                state.their_covered[side] = inputs.message[side].covered
                state.their_all_cells[side] = inputs.message[side].all_cells
                state.their_all_covered[side] = inputs.message[side].all_covered
        root, distance, parent = elect(
            state.own, state.counts, state.their_root, state.their_distance, constants.limit
        )
        state.root, state.distance, state.parent = root, distance, parent
        for side in range(4):
            state.child[side] = state.counts[side] > 0 and is_child(
                side,
                root,
                distance,
                state.their_root[side],
                state.their_distance[side],
                state.their_parent[side],
            )
        here = 0
        for sensor in range(inputs.sensors):
            if inputs.presence[sensor]:
                here = 1
        state.cells = subtotal(1, state.child, state.their_cells, MOST)
        state.covered = subtotal(here, state.child, state.their_covered, MOST)
        state.all_cells = broadcast(parent, state.cells, state.their_all_cells)
        state.all_covered = broadcast(parent, state.covered, state.their_all_covered)
        if parent < NOBODY:
            outputs.speed_m_s[0] = constants.speed_m_s * AHEAD_X[parent]
            outputs.speed_m_s[1] = constants.speed_m_s * AHEAD_Y[parent]
        for side in range(4):
            outputs.sent[side] = 1
            outputs.message[side].root = root
            outputs.message[side].distance = distance
            outputs.message[side].parent = parent
            outputs.message[side].cells = state.cells
            outputs.message[side].covered = state.covered
            outputs.message[side].all_cells = state.all_cells
            outputs.message[side].all_covered = state.all_covered

    def eventually(self, view: ArrayView) -> Iterable[tuple[str, Any, int]]:
        """Yield that each cell follows the least key in reach, at its distance, and knows the number of cells.

        The first condition holds for one tree alone: a claim that no living root makes would need an ever nearer one.
        """
        limit, ttl_periods, n = self.parameters.limit, self.parameters.ttl_periods, len(view)
        own, root, distance = view["own"], view["root"], view["distance"]
        there = view.neighbours >= 0
        farther = np.where(there, distance[view.neighbours] + 1, limit)
        offered = np.where(farther < limit, root[view.neighbours], np.iinfo(np.int64).max)
        best = np.minimum(offered.min(axis=1), own)
        nearest = np.where(offered == best[:, None], farther, limit).min(axis=1)
        wanted = np.where(best == own, 0, nearest)
        ticks = (limit + n + 1) * ttl_periods
        yield "a root is the least key around", (root == best) & (distance == wanted), ticks
        _, place, count = np.unique(root, return_inverse=True, return_counts=True)
        yield (
            "every cell knows how many follow its root",
            view["all_cells"] == count[place],
            ticks + 2 * (n + 1) * ttl_periods,
        )

    def accepts(self, messages: NDArray[Any]) -> NDArray[np.bool_]:
        """Return which messages a program may have sent: distances below the limit, sides, and counts in range."""
        good = (messages["distance"] < self.parameters.limit) & (messages["parent"] <= NOBODY)
        for name in ("cells", "covered", "all_cells", "all_covered"):
            good &= messages[name] <= MOST
        return good

    def warnings(self, lattice: Lattice) -> tuple[str, ...]:
        """Warn of cells too far from their root for ``limit``."""
        limit = self.parameters.limit
        away = int(hop_distance(lattice, self._roots(lattice)).max())
        if away < limit:
            return ()
        return (
            f"limit is {limit}, and a cell is {away} links from its root: far cells will follow other roots",
        )

    def theory(self, lattice: Lattice) -> Theory:
        """Predict distances to the root, known after as many ticks as the largest."""
        away = hop_distance(lattice, self._roots(lattice))
        return Theory(
            "a cell knows its distance d from the root from tick d on (distributed Bellman-Ford)",
            ticks=int(away.max()),
            limit=away if away.max() < self.parameters.limit else None,
        )

    def _keys(self, row: Ints, column: Ints) -> Ints:
        rank = np.full(len(row), LAST, dtype=np.int64)
        for number, region in enumerate(self.parameters.roots):
            rank[region.has(row, column)] = number
        return (rank * PLACES + row) * PLACES + column

    def _roots(self, lattice: Lattice) -> Ints:
        """Return the indices of the roots, one in each part of the array."""
        return np.unique(reachable_maximum(lattice, -self._keys(lattice.rows, lattice.columns)))
