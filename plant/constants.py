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

from plant.array import CellArray
from plant.errors import PlantError
from plant.friction.viscous import Viscous
from plant.kernels import layout
from plant.solvers.exact import Exact
from plant.specs import ExactSpec, PlantSpec
from plant.wheels import Floats


@final
@dataclass(frozen=True, slots=True)
class ConstantsOfMotion:
    """The motion of one parcel on its present supports.

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


def _supports(
    spec: PlantSpec, index: int, position: tuple[float, float] | None
) -> tuple[Exact, NDArray[np.intp]]:
    """The support set of a parcel, by default where it starts, as ``exact`` finds it."""
    parcel = spec.parcels[index]
    if position is not None:
        parcel = parcel.model_copy(update={"position_m": position})
    array = CellArray(spec.array)
    # only where cells carry the parcel is asked: the rate of slip and the tolerance count for nothing
    solver = Exact(array, (parcel,), 1.0, 0.0, ExactSpec())
    if len(solver.under(0)) == 0 or not solver.stand(0, np.ones(len(array))):
        return solver, np.zeros(0, dtype=np.intp)
    members = solver.parcels[0].mem[: solver.parcels[0].ctl[layout.N_MEMBERS]]
    active = members[members[:, layout.MARK] == layout.ACTIVE, layout.CELL]
    return solver, np.sort(active).astype(np.intp)


def constants_of_motion(spec: PlantSpec, index: int, wheel_speed: Floats) -> ConstantsOfMotion:
    """Constants of a parcel at its start pose.

    Args:
        spec: array, parcels and friction.
        index: which parcel.
        wheel_speed: ``(n, 2)`` m/s, of every cell.

    Raises:
        PlantError: the law is not viscous, or the parcel doesn't stand there.
    """
    if not isinstance(spec.friction, Viscous):
        raise PlantError(
            f'friction.law = "{spec.friction.law}": constants of motion are those of the law viscous (eqs. 18 and 23)'
        )
    solver, cells = _supports(spec, index, None)
    if len(cells) == 0:
        raise PlantError(f"parcels[{index}]: no set of cells carries the parcel at this pose")
    array, parcel = CellArray(spec.array), solver.parcels[0]
    mass = spec.parcels[index].mass_kg
    weight = mass * spec.gravity_m_s2
    mu = spec.friction.coefficient_s_per_m
    centre = array.positions_m[cells].mean(axis=0)
    r = array.positions_m[cells] - centre
    v = wheel_speed[cells]
    x = parcel.y[:2] - centre
    # load shares P [1; X - c]: mean share, and the inverse second moment of the supports (eqs. 11-13)
    p: Floats = np.full((len(cells), 3), 1.0 / len(cells))
    p[:, 1:] = r @ np.linalg.pinv(r.T @ r)
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
        _, there = _supports(spec, index, (float(place[0]), float(place[1])))
        inside = bool(np.array_equal(there, cells))
    motion: Floats = np.zeros((4, 4))
    motion[:2, 2:] = np.eye(2)
    motion[2:, :2] = stiffness / mass
    motion[2:, 2:] = -mu * spec.gravity_m_s2 * np.eye(2)
    inertia = mass / parcel.par[layout.MASS_OVER_INERTIA]
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
        eigenvalues_per_s=np.sort_complex(np.linalg.eigvals(motion).astype(np.complex128)),
        angular_acceleration_rad_s2=torque / float(inertia),
    )


def _equilibrium(stiffness: Floats, offset: Floats, natural: float) -> Floats | None:
    """Where ``f0 + k_s X`` vanishes; None where that is no single point. ``natural`` is the size of a true ``k_s``."""
    scale = float(np.max(np.abs(stiffness)))
    if scale <= 1e-12 * natural or abs(float(np.linalg.det(stiffness / scale))) < 1e-12:
        return None
    return np.asarray(-np.linalg.solve(stiffness, offset), dtype=np.float64)
