"""What solvers whose parcels live in the kernels' arrays have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from bus.memory import Remembers
from plant import stop
from plant.array import CellArray
from plant.kernels import layout
from plant.kernels.parcels import Parcel, Parcels
from plant.kernels.surface import Surface
from plant.solvers.bodies import (
    ENDINGS,
    SensorCover,
    body_of,
    cells_changed,
    find_members,
    make_parcel,
    members,
    pack,
)
from plant.solvers.solver import Advance, Body, Kept, Leg, SolverEvent
from plant.specs import ParcelSpec
from plant.wheels import Floats, WheelMotion


class CompiledSolver(ABC):
    """A ``plant.solvers.solver.Solver`` but for the moving itself.

    Args:
        array: the surface.
        parcels: footprint, mass and start of each.
        rate: of the motors, 1/s; 0 without.

    Attributes:
        packed: all parcels, side by side.
        parcels: each by itself: parts of ``packed``.
        capacity: cells that fit under any of them.
        state: ``(m, 6)``: part of ``packed``.
        bodies: the parcels as the plant sees them.
    """

    remembers: ClassVar[Remembers] = Remembers(shared=("packed.y", "packed.par", "packed.ctl", "packed.mem"))

    def __init__(self, array: CellArray, parcels: tuple[ParcelSpec, ...], rate: float) -> None:
        from plant.kernels import pick  # loads numba: only where a plant is really built

        self._array = array
        self.packed: Parcels = pack([make_parcel(parcel, array) for parcel in parcels])
        self.packed.par[:, layout.RATE] = rate
        kernels: Any = pick
        self.parcels: list[Parcel] = [kernels.parcel_of.py_func(self.packed, i) for i in range(len(parcels))]
        self.capacity: int = max((len(parcel.mem) for parcel in self.parcels), default=1)
        self.state: Floats = self.packed.y
        self.bodies: Sequence[Body] = [body_of(parcel) for parcel in self.parcels]
        self._stop = stop.flag()
        self._still: Floats = np.zeros((len(array), 2))
        self._cover = SensorCover(array)

    @property
    def effort(self) -> int:
        """Steps of all parcels so far, those not accepted included."""
        return int(self.packed.ctl[:, layout.N_STEPS].sum())

    @property
    def captured(self) -> NDArray[np.bool_]:
        """``(m,)`` parcels whose chatter was captured so far."""
        return self.packed.ctl[:, layout.N_CAPTURES] > 0

    def under(self, index: int) -> NDArray[np.int64]:
        """The cells under a parcel now, in no order, its boundary included."""
        return members(self.parcels[index])

    def stand(self, index: int, grip: Floats) -> bool:
        """Find a parcel's loads where it is. False where its supports can't carry it."""
        still = WheelMotion(self._still, self._still, 0.0)
        news = self.advance(np.array([index]), Leg.through(still, grip, 0.0, len(self.parcels)))
        return not news or news[0].ending == "moving"

    def _memory(self) -> Sequence[NDArray[Any]]:
        """Arrays with a row a parcel that moving it changes."""
        return self.packed.y, self.packed.par, self.packed.ctl

    def keep(self, indices: NDArray[np.int64]) -> Kept:
        """All that moving these parcels changes, to be able to go back."""
        parcels = [self.parcels[int(i)] for i in indices]
        members = [parcel.mem[: int(parcel.ctl[layout.N_MEMBERS])].copy() for parcel in parcels]
        return Kept(indices, [rows[indices] for rows in self._memory()], members)

    def restore(self, kept: Kept) -> None:
        """Go back to what was kept, bit for bit."""
        for rows, before in zip(self._memory(), kept.rows, strict=True):
            rows[kept.indices] = before
        parcels = [self.parcels[int(i)] for i in kept.indices]
        for parcel, before in zip(parcels, kept.members, strict=True):
            parcel.mem[: len(before)] = before

    def put(self, index: int, state: Floats) -> None:
        """Give a parcel another state ``(6,)`` from outside: what lies under it, and how, is found anew."""
        parcel = self.parcels[index]
        parcel.y[:] = state
        self._find_anew(parcel)

    def rebuilt(self, cells: NDArray[np.int64]) -> list[Advance]:
        """Look anew at what lies under parcels, where cells have come or gone; see ``plant.solvers.solver.Solver``."""
        news: list[Advance] = []
        for i, parcel in enumerate(self.parcels):
            changes = cells_changed(parcel, members(parcel), cells, self._array)
            if changes:
                self._find_anew(parcel)
                news.append(Advance(i, 0.0, "moving", (-1, -1), -1, len(changes), changes))
        return news

    def _find_anew(self, parcel: Parcel) -> None:
        """Find the cells under a parcel, whatever was known of them."""
        parcel.ctl[[layout.N_GROUPS, layout.N_CROSSED]] = 0
        find_members(parcel, self._array)

    def presence(self, indices: NDArray[np.int64], bits: NDArray[np.bool_]) -> None:
        """Set the presence bits ``(n, sensors)`` under those parcels."""
        self._cover.mark(self.packed, indices, bits)

    @abstractmethod
    def advance(self, indices: NDArray[np.int64], leg: Leg) -> list[Advance]:
        """Move some parcels; see ``plant.solvers.solver.Solver``."""

    def _surface(self, motion: WheelMotion, grip: Floats) -> Surface:
        """The cells and their wheels for one call of a kernel."""
        return Surface(self._array.positions_m, self._array.grid, motion.steady, motion.decay, grip)

    def _done(self, index: int, moved_s: float, changes: int, events: Sequence[SolverEvent]) -> Advance:
        """What a call of a kernel came to for one parcel, ``changes`` being those of its supports."""
        ctl: list[int] = self.packed.ctl[index].tolist()
        return Advance(
            index,
            moved_s,
            ENDINGS[ctl[layout.STATUS]],
            (ctl[layout.TIP_A], ctl[layout.TIP_B]),
            ctl[layout.CULPRIT],
            changes,
            events,
        )
