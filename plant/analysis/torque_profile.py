"""Torque profile: the torque of a wheel velocity field on a parcel at every angle about a fixed centre of mass.

The loads are settled by that point X and by which cells are below, and those change only where a cell crosses an edge
of the turning parcel: so do loads that vanish or return. Between two such angles the torque is constant (in eq. 23
there is no angle), and with the angles from the geometry the whole turn is known exactly.
"""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import NDArray

from plant import geometry
from plant.analysis.crossings import Crossings, crossings
from plant.analysis.orientations import TorqueProfile
from plant.analysis.static_supports import StaticSupports, footprint, moved
from plant.array import CellArray
from plant.errors import PlantError
from plant.friction.viscous import viscous_of
from plant.loads import share_matrix
from plant.parcel_spec import ParcelSpec
from plant.specs import PlantSpec
from plant.wheels import Floats

_NOTHING = 1e-11
"""Of the largest torque or force that the wheels below could have: less is rounding."""
_LIFTED = 1e-12
"""A share of the mean load that rounding can't tell from none."""


@final
class TorqueProfiler:
    """Computes the torque profiles of parcels on one field of wheel velocities.

    Args:
        spec: array, friction and gravity.
        wheel_speed: ``(n, 2)`` m/s, of every cell.
    """

    def __init__(self, spec: PlantSpec, wheel_speed: Floats) -> None:
        self._array = CellArray(spec.array)
        self._speed = wheel_speed
        self._kappa = viscous_of(spec.friction, "stable orientations").rate(spec.gravity_m_s2)

    def drag_n_s_per_m(self, parcel: ParcelSpec) -> float:
        """``mu W`` of a parcel: the force of all its supports together, per speed at which they slip."""
        return self._kappa * parcel.mass_kg

    def profile(self, parcel: ParcelSpec, centre_m: Floats) -> TorqueProfile:
        """Turn a parcel once round.

        Args:
            parcel: footprint, centre of mass in it, and mass; not where it starts.
            centre_m: ``(2,)`` where its centre of mass is.

        Raises:
            PlantError: it stands there at no angle.
        """
        corners = footprint(parcel)
        radius = float(np.max(np.hypot(corners[:, 0], corners[:, 1])))
        offset = self._array.positions_m - centre_m
        near = np.flatnonzero(np.hypot(offset[:, 0], offset[:, 1]) <= radius)
        offset, speed = offset[near], self._speed[near]
        passed = crossings(offset, *geometry.edges(corners))
        # lengths in pitches: sums over lattice points are then nearly whole numbers
        pitch = self._array.pitch_m
        torque, force, count, plane = _all_pressed(offset / pitch, speed, passed)
        farthest = radius / pitch
        pressed = plane[:, 0] - np.hypot(plane[:, 1], plane[:, 2]) * farthest > 0.0
        footing: StaticSupports | None = None
        for step in np.flatnonzero(~pressed).tolist():
            under = passed.under_after(step)
            if np.all(_loads(plane[step], offset[under] / pitch) >= -_LIFTED * plane[step, 0]):
                continue
            if footing is None:
                footing = StaticSupports(self._array, moved(parcel, centre_m))
            footing.set_cells(near[under])
            cells = footing.supports()
            count[step] = len(cells)
            force[step], torque[step] = _pull(self._array.positions_m[cells] - centre_m, self._speed[cells])
            torque[step] /= pitch
        if not np.any(count):
            x, y = centre_m
            raise PlantError(f"a parcel with its centre of mass at ({x:.6g}, {y:.6g}) m stands at no angle")
        fastest = float(np.max(np.hypot(speed[:, 0], speed[:, 1])))
        torque[np.abs(torque) <= _NOTHING * fastest * farthest] = 0.0
        force[np.abs(force) <= _NOTHING * fastest] = 0.0
        drag = self.drag_n_s_per_m(parcel)
        return TorqueProfile(centre_m.copy(), passed.angles_rad, drag * pitch * torque, drag * force, count)


def _all_pressed(
    offset: Floats, speed: Floats, passed: Crossings
) -> tuple[Floats, Floats, NDArray[np.intp], Floats]:
    """Compute torque and force for each set of cells under the parcel, as if every cell carried load.

    Sums over cells change by those that come and leave, so that a step costs the same however many cells there are.

    Args:
        offset: ``(c, 2)`` cells from the centre of mass, in pitches.
        speed: ``(c, 2)`` m/s.
        passed: the turn.

    Returns:
        Torque ``(k,)`` and force ``(k, 2)`` per ``mu W``, how many cells, and the plane ``(k, 3)`` of the load shares,
        NaN where the cells lie on a line.
    """
    x, y, vx, vy = *offset.T, *speed.T
    turn = x * vy - y * vx
    # the plane's normal equations, then its products with torque and force
    terms = np.stack(
        [np.ones(len(x)), x, y, x, x * x, x * y, y, x * y, y * y]
        + [moment * f for f in (turn, vx, vy) for moment in (np.ones(len(x)), x, y)],
        axis=1,
    )
    steps = np.zeros((max(len(passed.angles_rad), 1), terms.shape[1]))
    np.add.at(steps, passed.change, passed.sign[:, None] * terms[passed.cell])
    sums = terms[passed.under].sum(axis=0) + np.cumsum(steps, axis=0)
    normal = sums[:, :9].reshape(-1, 3, 3)
    # the determinant sums the squares of twice the area of every triangle of cells, whole numbers in pitches
    on_line: NDArray[np.bool_] = np.linalg.det(normal) < 0.5
    solvable = np.where(on_line[:, None, None], np.eye(3), normal)
    plane: Floats = np.linalg.solve(solvable, np.array([[1.0], [0.0], [0.0]]))[:, :, 0]
    plane[on_line] = np.nan
    torque, fx, fy = (np.sum(plane * sums[:, at : at + 3], axis=1) for at in (9, 12, 15))
    return torque, np.stack([fx, fy], axis=1), np.rint(sums[:, 0]).astype(np.intp), plane


def _loads(plane: Floats, offset: Floats) -> Floats:
    return plane[0] + offset @ plane[1:]


def _pull(offset: Floats, speed: Floats) -> tuple[Floats, float]:
    """Force ``(2,)`` and torque per ``mu W`` of the cells that carry; NaN where there are none."""
    if not len(offset):
        return np.full(2, np.nan), np.nan
    centre = offset.mean(axis=0)
    share = share_matrix(offset - centre) @ np.array([1.0, *-centre])
    return share @ speed, float(share @ (offset[:, 0] * speed[:, 1] - offset[:, 1] * speed[:, 0]))
