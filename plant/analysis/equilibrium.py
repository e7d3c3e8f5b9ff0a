"""Continuum limit of a parcel's surface: infinitely many, infinitely small cells.

Restricted to linear fields ``V = K p + v``, which have a closed form. The load is spread over the whole bottom, in a
plane as on springs, and the torque depends on second moments of the loaded bottom alone.

Only for a linear field ``V = K p + v``, where it has a closed form: the load is spread over the whole bottom, in a
plane as on springs, and the torque depends on second moments of the loaded bottom alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from plant.analysis.constants import constants_of_motion, translation_rates
from plant.analysis.static_supports import footprint, moved
from plant.array import CellArray
from plant.errors import PlantError
from plant.friction.viscous import viscous_of
from plant.parcel_spec import ParcelSpec
from plant.specs import PlantSpec
from plant.wheels import Floats

_LINEAR = 1e-9
"""How far off a linear field a speed may be, over the largest: rounding."""


@final
@dataclass(frozen=True, slots=True)
class LinearField:
    """A field ``V = K p + v``.

    Attributes:
        rate_per_s: ``(2, 2)`` K.
        offset_m_s: ``(2,)`` v.
    """

    rate_per_s: Floats
    offset_m_s: Floats


def linear_field(positions_m: Floats, wheel_speed: Floats) -> LinearField | None:
    """The linear field that wheels run at.

    Args:
        positions_m: ``(n, 2)`` cells.
        wheel_speed: ``(n, 2)`` their speeds, m/s.

    Returns:
        None where the field isn't linear, or the cells lie on a line.
    """
    centre = positions_m.mean(axis=0)
    rows = np.concatenate([positions_m - centre, np.ones((len(positions_m), 1))], axis=1)
    scale = max(float(np.max(np.abs(rows[:, :2]))), 1e-300)
    rows[:, :2] /= scale
    found, _, rank, _ = np.linalg.lstsq(rows, wheel_speed, rcond=1e-10)
    off = float(np.max(np.abs(rows @ found - wheel_speed)))
    if rank < 3 or off > _LINEAR * float(np.max(np.abs(wheel_speed))):
        return None
    rate: Floats = np.asarray(found[:2].T / scale, dtype=np.float64)
    return LinearField(rate, found[2] - rate @ centre)


def loaded_moments(parcel: ParcelSpec) -> Floats | None:
    """Second moments about the centre of mass, per weight, of the load on a parcel's bottom.

    Returns:
        ``(2, 2)`` in the parcel's axes, m²; None where the load would have to pull somewhere, for the centre of mass
        is too far from the middle.
    """
    corners = footprint(parcel)
    points, areas = _quadrature(corners)
    rows = np.concatenate([np.ones((len(points), 1)), points], axis=1)
    # the plane of the springs, eqs. 3-13 with an integral for the sum
    plane = np.linalg.solve(rows.T @ (areas[:, None] * rows), np.array([1.0, 0.0, 0.0]))
    if np.min(plane[0] + corners @ plane[1:]) < 0.0:
        return None
    return np.asarray((points * (areas * (rows @ plane))[:, None]).T @ points, dtype=np.float64)


def continuous_torque(angles_rad: Floats, field: LinearField, moments_m2: Floats) -> Floats:
    """Torque per ``mu W`` of a linear field on a parcel, m²/s.

    For a rectangle and ``V = (k_x x, k_y y)`` it is ``(k_y - k_x) (L^2 - B^2) / 24 sin(2 theta)``.

    Args:
        angles_rad: ``(k,)``.
        field: any; where the centre of mass is, and v with it, doesn't count.
        moments_m2: ``(2, 2)``, from `loaded_moments`.
    """
    c, s = np.cos(angles_rad), np.sin(angles_rad)
    (xx, xy), (_, yy) = moments_m2
    # turned into the axes of the array
    along_x = c * c * xx - 2.0 * c * s * xy + s * s * yy
    along_y = s * s * xx + 2.0 * c * s * xy + c * c * yy
    across = c * s * (xx - yy) + (c * c - s * s) * xy
    (kxx, kxy), (kyx, kyy) = field.rate_per_s
    return np.asarray((kyy - kxx) * across + kyx * along_x - kxy * along_y, dtype=np.float64)


def _quadrature(corners: Floats) -> tuple[Floats, Floats]:
    """Points and areas that integrate polynomials of degree 3 over a convex polygon exactly: a fan of triangles."""
    node, weight = np.polynomial.legendre.leggauss(3)
    node, weight = 0.5 * (node + 1.0), 0.5 * weight
    u, v = (axis.ravel() for axis in np.meshgrid(node, node, indexing="ij"))
    share = np.outer(weight * node, weight).ravel()
    points: list[Floats] = []
    areas: list[Floats] = []
    for b, c in zip(corners[1:-1] - corners[0], corners[2:] - corners[0], strict=True):
        points.append(corners[0] + u[:, None] * ((1.0 - v)[:, None] * b + v[:, None] * c))
        areas.append(share * float(b[0] * c[1] - b[1] * c[0]))
    return np.concatenate(points), np.concatenate(areas)


_NOTHING = 1e-11
"""Of the largest speed: a pull that is less is rounding."""
_ATTEMPTS = 50
"""Steps from the equilibrium of one support set to that of the next."""


def equilibrium_point(spec: PlantSpec, index: int, wheel_speed: Floats) -> Floats:
    """Find the equilibrium of a parcel's centre of mass at its initial angle: ``(2,)`` m.

    In a linear field the equilibrium is the zero of the field, at every angle and on all supports. In other fields the
    search solves for the equilibrium on the parcel's supports, then on the supports there, until the supports repeat.
    The result is about the same at other angles. Along a line of equilibria the nearest point is returned.

    Args:
        spec: array, parcels and friction.
        index: index of the parcel.
        wheel_speed: speeds of all cells' wheels, ``(n, 2)``, m/s.

    Raises:
        PlantError: no equilibrium exists, it doesn't hold the parcel, or the supports alternate without converging.
    """
    field = linear_field(CellArray(spec.array).positions_m, wheel_speed)
    place: Floats = np.array(spec.parcels[index].position_m)
    fastest = float(np.max(np.hypot(wheel_speed[:, 0], wheel_speed[:, 1])))
    # a pull that changes by no more than rounding from one cell to the next draws nowhere
    weak = _NOTHING * fastest / spec.array.pitch_m
    kappa = viscous_of(spec.friction, "stable orientations").rate(spec.gravity_m_s2)
    for _ in range(_ATTEMPTS):
        if field is None:
            try:
                rate, pull = _on_supports(spec, index, wheel_speed, place)
            except PlantError:
                break
        else:
            rate, pull = field.rate_per_s, field.rate_per_s @ place + field.offset_m_s
        if np.max(np.abs(pull)) <= _NOTHING * fastest:
            if np.max(translation_rates(kappa * rate, kappa).real) > _NOTHING * kappa:
                break
            return place
        place = place - np.linalg.pinv(np.where(np.abs(rate) <= weak, 0.0, rate), rcond=1e-9) @ pull
    raise PlantError(f"parcels[{index}]: from its start no point is found to which the field draws it")


def _on_supports(spec: PlantSpec, index: int, wheel_speed: Floats, place: Floats) -> tuple[Floats, Floats]:
    """Force per ``mu W`` at a place, ``(2,)`` m/s, and its gradient on the supports there, ``(2, 2)`` 1/s."""
    parcels = list(spec.parcels)
    parcels[index] = moved(parcels[index], place)
    motion = constants_of_motion(spec.model_copy(update={"parcels": tuple(parcels)}), index, wheel_speed)
    force = motion.f0_n + motion.k_s_n_per_m @ place
    return motion.k_s_n_per_m / motion.damping_n_s_per_m, force / motion.damping_n_s_per_m
