"""Solvers whose kernels take each parcel through legs of its own where wheels change on the way of a call."""

from __future__ import annotations

from abc import abstractmethod
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from plant.kernels.outing import Hand, Way
from plant.solvers.solver import Advance, Outing
from plant.solvers.threaded import WORTH_WAKING, Desk, Errand, ThreadedSolver
from plant.wheels import Changes, WheelMotion

WorkT = TypeVar("WorkT")

LEGS = 8
"""About how many legs a parcel has then: threads are worth waking for as many fewer parcels."""


class LeggedSolver(ThreadedSolver[WorkT]):
    """A ``plant.solvers.solver.LegSolver`` but for one block of parcels."""

    @abstractmethod
    def _legs_block(
        self, desk: Desk[WorkT], block: NDArray[np.int64], errand: Errand, way: Way, hand: Hand
    ) -> tuple[int, int]:
        """Move the parcels of a block through their legs; see ``_advance_block``."""

    def advance_legs(self, indices: NDArray[np.int64], outing: Outing) -> list[Advance]:
        """Move some parcels, each through its own legs; see ``plant.solvers.solver.LegSolver``."""
        motion, changes = outing.run.motion, outing.run.changes
        if changes is None:
            none = np.zeros((0, len(self._array), 2))
            changes = Changes(none, none, none)
        way = Way(*changes, outing.reads_s, outing.margin_m, self._array.sensors_m, outing.presence)
        surface = self._surface(motion, outing.grip)
        errand = Errand(surface, outing.span_s, np.zeros(0), np.zeros((0, len(self.parcels), 6)))

        def move(thread: int, share: slice) -> list[Advance]:
            desk, hand = self.desk(thread), _hand(motion, changes)
            return self._move(
                desk, indices[share], lambda block: self._legs_block(desk, block, errand, way, hand)
            )

        shares = self.crew.share(len(indices), move, WORTH_WAKING // LEGS)
        return [news for share in shares for news in share]


def _hand(motion: WheelMotion, changes: Changes) -> Hand:
    """Scratch for one share of the parcels; what isn't written is never touched."""
    n = len(motion.steady)
    return Hand(
        steady=motion.steady.copy(),
        decay=motion.decay.copy(),
        when=np.empty(changes.after_s.size),
        which=np.empty(changes.after_s.size, dtype=np.int64),
        times=np.empty(n),
        cells=np.empty(n, dtype=np.int64),
        poses=np.empty((n, 1, 6)),
    )
