"""Constants of motion of a pose (eqs. 18 and 23): what the wheels do to a parcel while its supports stay the same.

On one support set S with centroid c, load shares are ``N_i / W = P_i [1; X - c]``, so under viscous friction

    force   F(X, U)     = f0 + k_s X - mu W U                 (eqs. 16-18)
    torque  T(X, omega) = tau(X) - d(X) omega                 (eqs. 21-23)

with F affine in the position X of the centre of mass, and tau and d quadratic in it. ``tau0`` and ``k_tau`` are tau and
its gradient at the pose, ``d`` is the damping there. All are independent of the angle while S stands.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from plant.analysis.static_supports import StaticSupports, moved
from plant.array import CellArray
from plant.errors import PlantError
from plant.friction.viscous import viscous_of
from plant.loads import share_matrix
from plant.specs import PlantSpec
from plant.wheels import Floats


@final
@dataclass(frozen=True, slots=True)
class ConstantsOfMotion:
    """Constants of the motion of one parcel on its current supports.

    Attributes:
        supports: ``(row, column)`` of every cell that carries load.
        loads_n: ``(n,)`` their normal forces, N.
        k_s_n_per_m: ``(2, 2)`` stiffness of the force, N/m (eq. 18).
        f0_n: ``(2,)`` force with the centre of mass at the origin of the array, N (eq. 18).
        damping_n_s_per_m: ``mu W``, N s/m.
        tau0_n_m: torque at the pose without rotation, N m (eq. 23).
        k_tau_n: ``(2,)`` its gradient along x and y at the pose, N (eq. 23).
        d_n_m_s: rotational damping at the pose, N m s (eq. 23).
        equilibrium_m: ``(2,)`` where the force vanishes; None where ``k_s`` is singular.
        equilibrium_inside: whether the same cells carry the parcel there, at the same angle.
        eigenvalues_per_s: ``(4,)`` complex, of the translation, 1/s.
        angular_acceleration_rad_s2: at the pose, without rotation.
    """

    supports: tuple[tuple[int, int], ...]
    loads_n: Floats
    k_s_n_per_m: Floats
    f0_n: Floats
    damping_n_s_per_m: float
    tau0_n_m: float
    k_tau_n: Floats
    d_n_m_s: float
    equilibrium_m: Floats | None
    equilibrium_inside: bool
    eigenvalues_per_s: NDArray[np.complex128]
    angular_acceleration_rad_s2: float


def constants_of_motion(spec: PlantSpec, index: int, wheel_speed: Floats) -> ConstantsOfMotion:
    """Constants of a parcel at its start pose.

    Args:
        spec: array, parcels and friction.
        index: which parcel.
        wheel_speed: ``(n, 2)`` m/s, of every cell.

    Raises:
        PlantError: the law is not viscous, or the parcel doesn't stand there.
    """
    law = viscous_of(spec.friction, "constants of motion (eqs. 18 and 23)")
    array, parcel = CellArray(spec.array), spec.parcels[index]
    footing = StaticSupports(array, parcel)
    cells = footing.supports()
    if len(cells) == 0:
        raise PlantError(f"parcels[{index}]: no set of cells carries the parcel at this pose")
    mass = parcel.mass_kg
    weight = mass * spec.gravity_m_s2
    mu = law.coefficient_s_per_m
    centre = array.positions_m[cells].mean(axis=0)
    r = array.positions_m[cells] - centre
    v = wheel_speed[cells]
    x = np.array(parcel.position_m) - centre
    p = share_matrix(r)
    shares = p @ np.array([1.0, *x])
    stiffness = mu * weight * v.T @ p[:, 1:]
    offset = mu * weight * v.T @ p[:, 0] - stiffness @ centre
    lever = r - x
    turn = lever[:, 0] * v[:, 1] - lever[:, 1] * v[:, 0]
    # moving X changes every share (P) and every lever arm (by -1)
    gradient = mu * weight * (p[:, 1:].T @ turn + np.array([-(shares @ v[:, 1]), shares @ v[:, 0]]))
    damping = mu * weight * float(shares @ np.sum(lever * lever, axis=1))
    torque = mu * weight * float(shares @ turn)
    # what a field that changes by all its speed across the supports would give: less than its rounding is none
    natural = mu * weight * float(np.max(np.abs(v))) / max(float(np.max(np.abs(r))), array.pitch_m)
    place = _equilibrium(stiffness, offset, natural)
    inside = False
    if place is not None:
        inside = bool(np.array_equal(StaticSupports(array, moved(parcel, place)).supports(), cells))
    return ConstantsOfMotion(
        supports=tuple(array.lattice.cells[int(i)] for i in cells.tolist()),
        loads_n=weight * shares,
        k_s_n_per_m=stiffness,
        f0_n=offset,
        damping_n_s_per_m=mu * weight,
        tau0_n_m=torque,
        k_tau_n=gradient,
        d_n_m_s=damping,
        equilibrium_m=place,
        equilibrium_inside=inside,
        eigenvalues_per_s=translation_rates(stiffness / mass, mu * spec.gravity_m_s2),
        angular_acceleration_rad_s2=torque / footing.inertia_kg_m2,
    )


def translation_rates(stiffness: Floats, mu_g: float) -> NDArray[np.complex128]:
    """Eigenvalues of ``X'' = stiffness X - mu_g X'``: ``(4,)``, 1/s; ``stiffness`` is ``(2, 2)`` per mass, 1/s^2."""
    motion: Floats = np.zeros((4, 4))
    motion[:2, 2:] = np.eye(2)
    motion[2:, :2] = stiffness
    motion[2:, 2:] = -mu_g * np.eye(2)
    return np.sort_complex(np.linalg.eigvals(motion).astype(np.complex128))


def _equilibrium(stiffness: Floats, offset: Floats, natural: float) -> Floats | None:
    """Solve ``f0 + k_s X = 0``; None where ``k_s`` is singular. ``natural``: magnitude of a regular ``k_s``, N/m."""
    scale = float(np.max(np.abs(stiffness)))
    if scale <= 1e-12 * natural or abs(float(np.linalg.det(stiffness / scale))) < 1e-12:
        return None
    return np.asarray(-np.linalg.solve(stiffness, offset), dtype=np.float64)
