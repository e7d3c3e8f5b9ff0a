"""Hop gradient: cells learn their distance from the nearest goal, in links, and drive towards it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any, Final, final

import numpy as np
from pydantic import Field

from bus.lattice import STEPS, Lattice
from cell_firmware.array_view import ArrayView
from cell_firmware.errors import ParametersError
from cell_firmware.firmware import Bools, Cells, Firmware, Inputs, Outbox, Outputs, State
from cell_firmware.program import Theory
from cell_firmware.specs import Positive, Spec
from cell_firmware.toolkit.graph import hop_distance
from cell_firmware.toolkit.hold import Ttl, age_ttl, hold_last
from cell_firmware.toolkit.regions import Ints, Region, region_problems

_AHEAD: Final = np.array([(column, row) for row, column in STEPS], dtype=np.float64)
"""Direction along x and y of each side."""


class HopGradientParameters(Spec):
    """Goals, speed, and limits of distance and silence."""

    goals: Annotated[tuple[Region, ...], Field(min_length=1)]
    speed_m_s: Positive = 0.2
    limit: Annotated[int, Field(ge=2, le=65_535)] = 255
    """Distance that stands for no route to a goal; must exceed the longest route."""
    ttl_periods: Ttl = 1
    """Validity of a neighbour's message, periods; a neighbour that is silent for longer counts as dead."""


@final
class HopGradient(Firmware):
    """Distance-vector routing to the nearest goal, recomputed in every tick, and therefore self-healing.

    A goal's distance is 0. Any other cell's distance is one more than the least valid distance received from its
    neighbours, and at most ``limit``, which means no way::

        d_i[k] = min(limit, 1 + min over neighbours j of d_j[k-1])

    A cell's own distance is not stored, which bounds the count to infinity: whatever was sent before, after m ticks no
    distance is below ``min(m, true distance)``, and from the tick equal to the true distance on, none is above it.
    Wheels drive towards the neighbour of the least distance, the first of ``north east south west`` that has it; at a
    goal, and where no way leads to one, they stand.

    Source: the distributed Bellman-Ford algorithm; D. Bertsekas and R. Gallager, *Data Networks*, 2nd ed., 1992,
    section 5.2.4, whose argument for the bound this is.
    """

    Parameters = HopGradientParameters
    message = np.dtype([("distance", "<u2")])
    observable = "distance"

    def check(self, lattice: Lattice) -> None:
        """Refuse goals without cells."""
        problems = region_problems(lattice, {"goals": self.parameters.goals})
        if problems:
            raise ParametersError("hop_gradient", problems)

    def eventually(self, view: ArrayView) -> Iterable[tuple[str, Any, int]]:
        """Yield the fixed point: each distance is one more than the least of the running neighbours."""
        limit, ttl_periods = self.parameters.limit, self.parameters.ttl_periods
        distance = view["distance"].astype(np.int64)
        around = np.where(view.neighbours >= 0, distance[view.neighbours], limit)
        wanted = np.where(view["goal"], 0, np.minimum(around.min(axis=1) + 1, limit))
        yield (
            "a distance is one more than the least around",
            distance == wanted,
            limit + ttl_periods + len(view),
        )

    def warnings(self, lattice: Lattice) -> tuple[str, ...]:
        """Warn of cells too far away for ``limit``, which never find a way to a goal."""
        away, limit = self._away(lattice), self.parameters.limit
        if away.max() < limit:
            return ()
        far = int((away >= limit).sum())
        far_off = f"limit is {limit}, and the farthest cell is {away.max()} links from a goal"
        return (f"{far_off}: {far} cells will find no route to a goal, and stand still",)

    def theory(self, lattice: Lattice) -> Theory:
        """Predict the distances to the nearest goal, known after as many ticks as the largest distance."""
        away, limit = self._away(lattice), self.parameters.limit
        return Theory(
            "a cell knows its distance d from tick d on (distributed Bellman-Ford)",
            ticks=min(int(away.max()), limit),
            limit=np.where((away < 0) | (away > limit), limit, away),
        )

    def _is_goal(self, row: Ints, column: Ints) -> Bools:
        found = np.zeros(len(row), dtype=np.bool_)
        for place in self.parameters.goals:
            found |= place.has(row, column)
        return found

    def _away(self, lattice: Lattice) -> Ints:
        return hop_distance(lattice, np.flatnonzero(self._is_goal(lattice.rows, lattice.columns)))

    def init(self, cells: Cells) -> State:
        """Return the initial state: goals, distances, and last distances of neighbours with remaining validity."""
        goal, n = self._is_goal(cells.row, cells.column), len(cells)
        return {
            "goal": goal,
            "distance": np.where(goal, 0, self.parameters.limit).astype(np.uint16),
            "neighbour": np.full((n, 4), self.parameters.limit, dtype=np.uint16),
            "counts": np.zeros((n, 4), dtype=np.int16),
        }

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        """Take the least distance, drive that way, and send the own distance."""
        inbox, limit = inputs.inbox, self.parameters.limit
        assert inbox is not None, "this is a bug: this firmware has messages"
        counts = age_ttl(inbox.received, state["counts"], self.parameters.ttl_periods)
        neighbour = hold_last(
            inbox.received, counts, inbox.message["distance"], state["neighbour"], silence=limit
        )
        least, side = neighbour.min(axis=1), neighbour.argmin(axis=1)
        distance = np.where(state["goal"], 0, np.minimum(least, limit - 1) + 1).astype(np.uint16)
        moves = ~state["goal"] & (distance < limit)
        speed = np.where(moves[:, None], self.parameters.speed_m_s * _AHEAD[side], 0.0)

        after = {"goal": state["goal"], "distance": distance, "neighbour": neighbour, "counts": counts}
        return after, Outputs(speed, Outbox.to_all(self.message, distance=distance))
