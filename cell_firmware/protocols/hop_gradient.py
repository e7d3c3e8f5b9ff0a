"""Every cell learns how many links it is from the nearest goal, and carries that way."""

from __future__ import annotations

from typing import Annotated, Final, final

import numpy as np
from pydantic import Field, model_validator

from bus.lattice import STEPS, Lattice
from cell_firmware.errors import ParametersError, Problem
from cell_firmware.firmware import Cells, Firmware, Inputs, Outbox, Outputs, State
from cell_firmware.hops import hops_to
from cell_firmware.recall import Patience, last_word, still_counts
from cell_firmware.specs import CellName, Positive, Spec
from cell_firmware.theory import Theory

_AHEAD: Final = np.array([(column, row) for row, column in STEPS], dtype=np.float64)
"""Direction along x and y of each side."""


class Block(Spec):
    """A rectangle of cells, from one corner to the opposite, both of them in it."""

    first: CellName
    last: CellName

    @model_validator(mode="after")
    def _ascending(self) -> Block:
        if self.first[0] > self.last[0] or self.first[1] > self.last[1]:
            raise ValueError(
                "first must be the corner of the lowest row and column, last that of the highest"
            )
        return self

    def cells(self) -> tuple[tuple[int, int], ...]:
        """``(row, column)`` of each."""
        rows, columns = range(self.first[0], self.last[0] + 1), range(self.first[1], self.last[1] + 1)
        return tuple((row, column) for row in rows for column in columns)


class HopGradientParameters(Spec):
    """Where to, how fast, and when a distance or a silence is too long."""

    goals: tuple[CellName, ...] = ()
    blocks: tuple[Block, ...] = ()
    """Goals by the rectangle; cells of these that do not exist are none."""
    speed_m_s: Positive = 0.2
    limit: Annotated[int, Field(ge=2, le=65_535)] = 255
    """Distance that means: no way leads to a goal. More than the longest way there may ever be."""
    patience: Patience = 1
    """For how many periods a neighbour's word counts; one not heard for longer counts as dead."""

    @model_validator(mode="after")
    def _somewhere(self) -> HopGradientParameters:
        if not self.goals and not self.blocks:
            raise ValueError("needs a goal: give goals, blocks or both")
        return self

    def cells(self) -> frozenset[tuple[int, int]]:
        """All that are named."""
        return frozenset(self.goals).union(*(block.cells() for block in self.blocks))


@final
class HopGradient(Firmware):
    """Distance vector routing to the nearest goal, computed anew in every tick, so that it heals by itself.

    A goal's distance is 0. Any other cell's is one more than the least that its neighbours have told, not too long
    ago, and at most ``limit``, which means that no way leads there::

        d_i[k] = min(limit, 1 + min over neighbours j of d_j[k-1])

    Nothing is kept of a cell's own distance, and that bounds the count to infinity: whatever was told before, after m
    ticks no cell is nearer than ``min(m, its true distance)``, nor farther than that from the tick on that equals its
    true distance. Wheels drive towards the neighbour of the least distance, the first of ``north east south west``
    that has it; at a goal, and where no way leads to one, they stand.

    Source: the distributed Bellman-Ford algorithm; D. Bertsekas and R. Gallager, *Data Networks*, 2nd ed., 1992,
    section 5.2.4, whose argument for the bound this is.
    """

    Parameters = HopGradientParameters
    message = np.dtype([("distance", "<u2")])
    observed = "distance"

    def check(self, lattice: Lattice) -> None:
        """Every goal must exist, and some cell of every block."""
        goals = self.parameters.goals
        problems = [
            Problem(("goals", i), f"the array has no cell [{cell[0]}, {cell[1]}]", list(cell))
            for i, cell in enumerate(goals)
            if cell not in lattice
        ] + [
            Problem(("blocks", i), "the array has no cell in it")
            for i, block in enumerate(self.parameters.blocks)
            if not any(cell in lattice for cell in block.cells())
        ]
        if problems:
            raise ParametersError("hop_gradient", tuple(problems))

    def cautions(self, lattice: Lattice) -> tuple[str, ...]:
        """Cells that ``limit`` keeps from ever knowing their way."""
        away, limit = self._away(lattice), self.parameters.limit
        if away.max() < limit:
            return ()
        far = int((away >= limit).sum())
        far_off = f"limit is {limit}, and the farthest cell is {away.max()} links from a goal"
        return (f"{far_off}: {far} cells will say that no way leads there, and stand still",)

    def theory(self, lattice: Lattice) -> Theory:
        """Links to the nearest goal, known everywhere after as many ticks as the farthest has links."""
        away, limit = self._away(lattice), self.parameters.limit
        return Theory(
            "a cell knows its distance d from tick d on (distributed Bellman-Ford)",
            ticks=min(int(away.max()), limit),
            limit=np.where((away < 0) | (away > limit), limit, away),
        )

    def _away(self, lattice: Lattice) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
        return hops_to(lattice, (lattice.index(cell) for cell in self.parameters.cells() if cell in lattice))

    def init(self, cells: Cells) -> State:
        """Who is a goal; each cell's distance; what each side told last, and for how long that counts."""
        named, limit, n = self.parameters.cells(), self.parameters.limit, len(cells)
        goal = np.array([cells.name(i) in named for i in range(n)], dtype=np.bool_)
        return {
            "goal": goal,
            "distance": np.where(goal, 0, limit).astype(np.uint16),
            "told": np.full((n, 4), limit, dtype=np.uint16),
            "counts": np.zeros((n, 4), dtype=np.int16),
        }

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        """Take the least distance, drive that way, tell the neighbours."""
        inbox, limit = inputs.inbox, self.parameters.limit
        assert inbox is not None, "this is a bug: this firmware has messages"
        counts = still_counts(inbox.received, state["counts"], self.parameters.patience)
        told = last_word(inbox.received, counts, inbox.message["distance"], state["told"], silence=limit)
        least, side = told.min(axis=1), told.argmin(axis=1)
        distance = np.where(state["goal"], 0, np.minimum(least, limit - 1) + 1).astype(np.uint16)
        moves = ~state["goal"] & (distance < limit)
        speed = np.where(moves[:, None], self.parameters.speed_m_s * _AHEAD[side], 0.0)

        after = {"goal": state["goal"], "distance": distance, "told": told, "counts": counts}
        return after, Outputs(speed, Outbox.to_all(self.message, distance=distance))
