"""What solvers whose parcels live in the kernels' arrays have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from plant.array import CellArray
from plant.kernels import layout
from plant.solvers.bodies import (
    ENDINGS,
    LOG_CAPACITY,
    Parcel,
    SensorCover,
    Surface,
    body_of,
    logged,
    make_parcel,
    members,
)
from plant.solvers.solver import Advance, Body
from plant.specs import ParcelSpec
from plant.wheels import Floats, WheelMotion


class CompiledSolver(ABC):
    """A ``plant.solvers.solver.Solver`` but for the moving itself.

    Args:
        array: the surface.
        parcels: footprint, mass and start of each.
        rate: of the motors, 1/s; 0 without.
    """

    def __init__(self, array: CellArray, parcels: tuple[ParcelSpec, ...], rate: float) -> None:
        self._array = array
        self.parcels = [make_parcel(parcel, array) for parcel in parcels]
        for parcel in self.parcels:
            parcel.par[layout.RATE] = rate
        self.bodies: Sequence[Body] = [body_of(parcel) for parcel in self.parcels]
        self._capacity = max((len(parcel.mem) for parcel in self.parcels), default=1)
        self._still: Floats = np.zeros((len(array), 2))
        self._log: Floats = np.zeros((LOG_CAPACITY, 4))
        self._cover = SensorCover(array)

    def under(self, index: int) -> NDArray[np.int64]:
        """The cells under a parcel now, in no order, its boundary included."""
        return members(self.parcels[index])

    def stand(self, index: int, grip: Floats) -> bool:
        """Find a parcel's loads at its start. False where its supports can't carry it."""
        none = np.zeros(0)
        still = WheelMotion(self._still, self._still, 0.0)
        return self.advance(index, still, grip, 0.0, none, np.zeros((0, 6))).ending == "moving"

    def presence(self, bits: NDArray[np.bool_]) -> None:
        """Set the presence bits ``(n, sensors)`` under every parcel."""
        self._cover.mark(self.parcels, bits)

    @abstractmethod
    def advance(
        self, index: int, motion: WheelMotion, grip: Floats, span_s: float, times_s: Floats, out: Floats
    ) -> Advance:
        """Move one parcel by ``span_s``, changing its state; see ``plant.solvers.solver.Solver``."""

    def _surface(self, motion: WheelMotion, grip: Floats) -> Surface:
        """The cells and their wheels for one call of a kernel."""
        return Surface(self._array.positions_m, self._array.grid, motion.steady, motion.decay, grip)

    def _done(self, parcel: Parcel, moved_s: float, changes: int, culprit: int = layout.NO_CELL) -> Advance:
        """What a kernel's call came to; ``changes`` is how many there had been before it."""
        ctl = parcel.ctl
        return Advance(
            float(moved_s),
            ENDINGS[int(ctl[layout.STATUS])],
            (int(ctl[layout.TIP_A]), int(ctl[layout.TIP_B])),
            culprit,
            int(ctl[layout.N_EVENTS]) - changes,
            logged(parcel, self._log),
        )
