"""Max consensus: all cells agree on the leader of the highest rank."""

from __future__ import annotations

from typing import Annotated, Final, final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from bus.lattice import Lattice
from cell_firmware.errors import ParametersError, Problem
from cell_firmware.firmware import Cells, Firmware, Inputs, Outbox, Outputs, State
from cell_firmware.program import Theory
from cell_firmware.specs import Spec, Vector
from cell_firmware.toolkit.graph import hop_distance, reachable_maximum
from cell_firmware.toolkit.regions import Region, assign, region_problems

Rank = Annotated[int, Field(ge=-(2**31), lt=2**31)]

_PLACES: Final = 1 << 16
"""Rows and columns that a key has room for."""


class Ranked(Region):
    """Cells, and a rank for each of them."""

    rank: Rank

    @property
    def amount(self) -> int:
        """Rank of each cell."""
        return self.rank


class MaxConsensusParameters(Spec):
    """Ranks of cells, and lifetime of a leader's messages."""

    rank: Rank = 0
    """Rank of cells that ``ranks`` doesn't name. Among equal ranks the highest row leads, then the highest column."""
    ranks: tuple[Ranked, ...] = ()
    """Cells with other ranks."""
    lifetime: Annotated[int, Field(ge=1, le=65_534)] = 1_000
    """Validity of a leader's key, periods: longer than its propagation through the array."""
    speed_m_s: Vector = (0.0, 0.0)
    """Speed of the leader's wheels; all other wheels stand."""


@final
class MaxConsensus(Firmware):
    """Leader election by flooding: the greatest key wins, and keys of a dead leader expire.

    A cell's key is its rank, row and column. In every tick the cell takes the greatest of its own key, of age 0, the
    key that it holds, and the keys received, the latter two a tick older than before; of equal keys the youngest. It
    sends key and age. A key older than ``lifetime`` is dropped.

    A cell at d hops from the leader knows it after d ticks, and nothing changes from then on. A lost message costs a
    tick. When the leader dies, the age of its youngest key grows by 1 a tick: after ``lifetime + 1`` ticks, or that
    times 1 + d where messages take d ticks longer, no cell holds the key, and the next leader's key reaches a cell
    after as many more ticks as the cell is hops away.

    Source: Lynch, *Distributed Algorithms*, Morgan Kaufmann 1996, ch. 4.1 (FloodMax); ages as in the lifetimes of
    link-state routing, RFC 2328.
    """

    Parameters = MaxConsensusParameters
    message = np.dtype([("key", "<i8"), ("age", "<u2")])
    observable = "leader"

    def check(self, lattice: Lattice) -> None:
        """Refuse regions without cells, cells named twice, and arrays too large for the keys."""
        problems = region_problems(lattice, {"ranks": self.parameters.ranks})
        if max(lattice.rows.max(), lattice.columns.max()) >= _PLACES:
            problems += (Problem((), f"rows and columns must be below {_PLACES}"),)
        if problems:
            raise ParametersError("max_consensus", problems)

    def warnings(self, lattice: Lattice) -> tuple[str, ...]:
        """Warn of a lifetime shorter than the propagation of the leader's key."""
        lifetime = self.parameters.lifetime
        if lifetime >= len(lattice):
            return ()
        steps = hop_distance(lattice, self._leaders(lattice))
        beyond = int((steps > lifetime).sum())
        if not beyond:
            return ()
        late = f"lifetime {lifetime} is shorter than the propagation of the leader's key, {steps.max()} ticks"
        return (f"{late}: {beyond} cells that are farther away lose the key, and follow others",)

    def theory(self, lattice: Lattice) -> Theory:
        """Predict the end after as many ticks as the largest distance of a cell from its leader."""
        leader = self._leaders(lattice)
        return Theory(
            "flooding: a cell knows the leader after as many ticks as it is steps away (Lynch 1996, ch. 4.1)",
            ticks=int(hop_distance(lattice, leader).max()),
            limit=np.stack((lattice.rows[leader], lattice.columns[leader]), axis=1),
        )

    def init(self, cells: Cells) -> State:
        """Return the initial state: each cell's own key as the greatest known, with age 0."""
        key = self._keys(cells.row, cells.column)
        leader = np.stack((cells.row, cells.column), axis=1)
        return {"own": key, "key": key, "age": np.zeros(len(cells), dtype=np.int64), "leader": leader}

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        """Select the greatest valid key, with its least age."""
        inbox = inputs.inbox
        assert inbox is not None, "this is a bug: this firmware has messages"
        key, age = state["own"], np.zeros(len(state["own"]), dtype=np.int64)
        candidates = [(state["key"], state["age"] + 1, np.ones(len(key), dtype=np.bool_))]
        for side in range(4):
            message = inbox.message[:, side]
            candidates.append((message["key"], message["age"].astype(np.int64) + 1, inbox.received[:, side]))
        for other, old, received in candidates:
            good = received & (old <= self.parameters.lifetime)
            better = good & ((other > key) | ((other == key) & (old < age)))
            key, age = np.where(better, other, key), np.where(better, old, age)

        place = key % (1 << 32)
        leader = np.stack((place // _PLACES, place % _PLACES), axis=1)
        speed = np.where((key == state["own"])[:, None], np.array(self.parameters.speed_m_s), 0.0)
        outbox = Outbox.to_all(self.message, key=key, age=age)
        return {**state, "key": key, "age": age, "leader": leader}, Outputs(speed, outbox)

    def _keys(self, row: NDArray[np.int64], column: NDArray[np.int64]) -> NDArray[np.int64]:
        rank = np.full(len(row), self.parameters.rank, dtype=np.int64)
        assign(self.parameters.ranks, row, column, rank)
        return (rank << 32) + row * _PLACES + column

    def _leaders(self, lattice: Lattice) -> NDArray[np.int64]:
        """Return the index of the cell that each cell will follow, ``(n,)``."""
        return reachable_maximum(lattice, self._keys(lattice.rows, lattice.columns))
