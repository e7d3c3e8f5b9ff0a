"""Loads, slips and tractions of the wheels under parcels at one instant, from poses and wheel speeds alone.

The solvers compute these values inside a step and keep none of them. Here they are computed again in NumPy for
plots and live pages, by the same laws (``plant.friction.law.Traction``) and effects, without compiled kernels.

A pose alone doesn't determine two things. A wheel that sticks under a set-valued law pulls with whatever force holds
it: its traction is NaN here, and its limit is given. While a parcel's chatter is captured, its loads are a mixture of
those with and without the captured cells: here a cell on the edge counts as being under the parcel.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np
from numpy.typing import NDArray

from plant.analysis.unilateral import unilateral_loads
from plant.array import CellArray
from plant.effects.uneven_friction import friction_factors
from plant.effects.uneven_supports import supports
from plant.kernel_data import make_parcel
from plant.kernels.common import layout
from plant.kernels.common.parcels import Parcel
from plant.loads import find_supports
from plant.specs import PlantSpec
from plant.wheels import Floats

Bools = NDArray[np.bool_]
Cells = NDArray[np.intp]

_STILL_M_S = 1e-9
_STILL_TOLERANCES = 10.0
"""A slip of at most so many of the solver's tolerances, per second, is none: a step may end with such a slip."""


@final
@dataclass(frozen=True, slots=True)
class ParcelTractions:
    """Forces of the wheels on one parcel at one instant.

    Attributes:
        parcel: Number of the parcel.
        cells: Indices of the cells that carry load, ascending, ``(k,)``.
        load_n: Normal forces, ``(k,)``, N.
        slip_m_s: Slip of each wheel along x and along y, ``(k, 2)``, m/s: the wheel's surface speed less the velocity
            of the parcel's underside above it. With laws that contain the motor (``rolling``, ``stick_slip``) it is
            the speed of the wheel without load less that velocity.
        traction_n: Forces on the parcel along x and along y, ``(k, 2)``, N, resistance of rollers included. NaN at
            wheels that stick: the law then allows any force up to ``limit_n``.
        sticking: Whether the law is set-valued and the wheel does not slip, ``(k, 2)``.
        limit_n: Largest traction of the wheel's law, ``(k, 2)``, N; infinite without a limit.
    """

    parcel: int
    cells: Cells
    load_n: Floats
    slip_m_s: Floats
    traction_n: Floats
    sticking: Bools
    limit_n: Floats


@final
@dataclass(frozen=True, slots=True)
class ArrayTractions:
    """Loads, slips and tractions of all cells at one instant.

    Attributes:
        load_n: Normal force on each cell, ``(n,)``, N; 0 without a parcel.
        slip_m_s: ``(n, 2)``, m/s; NaN where the cell carries no load. See ``ParcelTractions``.
        traction_n: ``(n, 2)``, N; 0 where the cell carries no load, NaN at wheels that stick.
        sticking: ``(n, 2)``.
        parcels: One entry for each parcel that wheels carry, in the order of the scene.
    """

    load_n: Floats
    slip_m_s: Floats
    traction_n: Floats
    sticking: Bools
    parcels: tuple[ParcelTractions, ...]


@final
class Tractions:
    """Computes loads, slips and tractions of a scene at given instants.

    Args:
        spec: The scene's physics.

    Attributes:
        array: The cells.
        left_out: Names of the scene's effects that change forces and are not included.
    """

    NOT_INCLUDED: ClassVar[tuple[str, ...]] = ("load_transfer", "roller_impacts", "parcel_contact")

    def __init__(self, spec: PlantSpec) -> None:
        spec = spec.with_fed()
        self.array = CellArray(spec.array)
        self.left_out: tuple[str, ...] = tuple(
            name for name, _ in spec.effects.enabled() if name in self.NOT_INCLUDED
        )
        self._parcels: Sequence[Parcel] = [make_parcel(parcel, self.array) for parcel in spec.parcels]
        self._weight_n = [spec.gravity_m_s2 * parcel.mass_kg for parcel in spec.parcels]
        self._law = spec.friction.traction()
        # wheels that feel what they pull turn a jump into a limit without slip
        self._still_m_s = max(_STILL_M_S, _STILL_TOLERANCES * getattr(spec.solver, "tolerance", 0.0))
        effects = spec.effects
        self._drag_s_per_m = 0.0 if effects.roller_drag is None else effects.roller_drag.drag_s_per_m
        self._width_m = None if effects.contact_width is None else effects.contact_width.width_m
        uneven, rough = effects.uneven_supports, effects.uneven_friction
        self._springs = None if uneven is None else supports(uneven, self.array.lattice, spec.seed)
        self._factors: Floats = (
            np.ones((len(self.array), 2))
            if rough is None
            else friction_factors(rough, self.array.lattice, spec.seed)
        )

    def at(
        self,
        states: Floats,
        wheel_speeds: Floats,
        *,
        parcels: Iterable[int] | None = None,
        coasting: Bools | None = None,
        absent: Bools | None = None,
    ) -> ArrayTractions:
        """Compute all values of one instant.

        Args:
            states: States of the parcels, ``(m, 6)``: x, y, angle, and their rates; a parcel with NaN is skipped.
            wheel_speeds: Surface speeds of the wheels at the instant, ``(n, 2)``, m/s.
            parcels: Numbers of the parcels that lie on the array; None: all.
            coasting: Cells whose wheels turn freely, ``(n,)``: they carry load and pull nothing.
            absent: Cells whose modules are out of the array, ``(n,)``.

        Returns:
            The values. A cell under two overlapping parcels has the sums of both, and the slip of the latter.
        """
        n = len(self.array)
        if states.shape != (len(self._parcels), 6) or wheel_speeds.shape != (n, 2):
            raise ValueError(
                f"states {states.shape} and wheel_speeds {wheel_speeds.shape} must be ({len(self._parcels)}, 6) "
                f"and ({n}, 2)"
            )
        self.array.keep(np.ones(n, dtype=np.bool_) if absent is None else ~absent)
        load, slip = np.zeros(n), np.full((n, 2), np.nan)
        traction, sticking = np.zeros((n, 2)), np.zeros((n, 2), dtype=np.bool_)
        found: list[ParcelTractions] = []
        for index in range(len(states)) if parcels is None else parcels:
            if not np.isfinite(states[index]).all():
                continue
            one = self._parcel(index, states[index], wheel_speeds, coasting)
            if one is None:
                continue
            found.append(one)
            load[one.cells] += one.load_n
            traction[one.cells] += one.traction_n
            slip[one.cells] = one.slip_m_s
            sticking[one.cells] = one.sticking
        return ArrayTractions(load, slip, traction, sticking, tuple(found))

    def _parcel(
        self, index: int, state: Floats, wheel_speeds: Floats, coasting: Bools | None
    ) -> ParcelTractions | None:
        """Values of one parcel; None where no cells can carry it."""
        cells, share = self._loads(index, state)
        carrying = share > 0.0
        if not carrying.any():
            return None
        cells = cells[carrying]
        load = self._weight_n[index] * share[carrying]
        lever = self.array.positions_m[cells] - state[:2]
        underside = state[3:5] + state[5] * np.stack([-lever[:, 1], lever[:, 0]], axis=1)
        surface = wheel_speeds[cells]
        slip = self._law.free_speed * surface - underside
        traction, sticking, limit = self._pull(load[:, None] * self._factors[cells], slip, surface)
        traction -= self._drag_s_per_m * load[:, None] * underside
        if coasting is not None:
            free = coasting[cells]
            traction[free], sticking[free], limit[free] = 0.0, False, 0.0
        return ParcelTractions(index, cells, load, slip, traction, sticking, limit)

    def _pull(self, by_load: Floats, slip: Floats, surface: Floats) -> tuple[Floats, Bools, Floats]:
        """Forces of the law ``(k, 2)``, which wheels stick, and the law's limits ``(k, 2)``.

        Args:
            by_load: Load of each wheel times its friction over the law's, ``(k, 2)``, N.
            slip: ``(k, 2)``, m/s.
            surface: Surface speeds, ``(k, 2)``, m/s.
        """
        law = self._law
        limit = law.limit + law.limit_per_load * by_load
        size = np.hypot(slip[:, :1], slip[:, 1:]) if law.isotropic else np.abs(slip)
        size = np.broadcast_to(size, slip.shape)
        sticking = np.zeros(slip.shape, dtype=np.bool_)
        if law.set_valued:
            sticking = (size <= self._still_m_s) & (limit > 0.0)
            wanted: Floats = np.full(slip.shape, np.inf)
        else:
            wanted = (law.stiffness + law.stiffness_per_load * by_load) * size
        along: Floats = np.divide(slip, size, out=np.zeros_like(slip), where=size > 0.0)
        traction = np.minimum(wanted, limit) * along + law.push_per_load * by_load * np.sign(surface)
        traction += law.viscous * slip
        traction[sticking] = np.nan
        return traction, sticking, np.where(sticking, law.static_ratio * limit, limit)

    def _loads(self, index: int, state: Floats) -> tuple[Cells, Floats]:
        """Cells under a parcel, ascending, and their shares of its weight; 0 if no loads balance."""
        shape = self._parcels[index]
        margin = 0.0 if self._width_m is None else 0.5 * self._width_m
        cells: Cells = self.array.within(state[:2], float(shape.par[layout.RADIUS]) + margin).astype(np.intp)
        offset = self.array.positions_m[cells] - state[:2]
        c, s = np.cos(state[2]), np.sin(state[2])
        depth = shape.offset - offset @ np.array([[c, -s], [s, c]]) @ shape.normal.T
        if self._width_m is None:
            part: Floats = (depth.min(axis=1) >= -shape.par[layout.ON_SURFACE]).astype(np.float64)
        else:  # as plant.kernels.effects.wheel_edges
            u = np.clip(0.5 + depth / self._width_m, 0.0, 1.0)
            part = np.prod(u * u * (3.0 - 2.0 * u), axis=1)
        under = part > 1e-12
        cells, offset, part = cells[under], offset[under], part[under]
        return cells, self._shares(index, cells, offset, part)

    def _shares(self, index: int, cells: Cells, offset: Floats, part: Floats) -> Floats:
        """Loads ``(n,)`` over the weight of cells at ``offset`` ``(n, 2)`` that are under the parcel by ``part``."""
        pitch, none = self.array.pitch_m, np.zeros(len(cells))
        if self._springs is None and self._width_m is None:
            found = find_supports(offset, np.ones(len(cells), dtype=np.bool_), pitch)
            if found is None:
                return none
            load = found.plane @ np.array([1.0, *-found.centroid_m])
            return np.where(found.carrying, np.maximum(load, 0.0), 0.0)
        stiffness, gap = part, none
        if self._springs is not None:
            stiffness = part * self._springs.rate[cells]
            sag_m = self._weight_n[index] / self._springs.stiffness_n_per_m
            gap = -self._springs.height_m[cells] / sag_m
        shares = unilateral_loads(offset / pitch, stiffness, gap)
        return none if shares is None else shares
