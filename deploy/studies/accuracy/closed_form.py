"""Closed-form motion of a parcel's centre of mass in a linear field under viscous friction, for all supports.

In ``V = K p + v`` the loads' balances give ``sum N_i V_i = W (K X + v)`` whatever the supports, so ``X`` is a damped
oscillator, ``X'' = mu g (K X + v - X')``, from the start to the end.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from plant.analysis.equilibrium import LinearField, linear_field
from plant.array import CellArray
from plant.friction.viscous import Viscous

if TYPE_CHECKING:
    from deploy.scenes.scene import Scene

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

_INDEPENDENT = 1e-6
"""Eigenvectors closer to each other than this lose digits."""


def closed_form(scene: Scene, speeds_m_s: Floats, starts: Floats, times_s: Floats) -> Floats | None:
    """Centres of mass at some instants, ``(T, m, 2)``.

    Args:
        scene: what to simulate.
        speeds_m_s: ``(n, 2)`` of the wheels.
        starts: ``(m, 6)`` states at time 0.
        times_s: ``(T,)``.

    Returns:
        None where there is none: for another law or field, with an effect, or where cells crash.
    """
    if not isinstance(scene.friction, Viscous) or scene.faults or list(scene.effects.enabled()):
        return None
    field = linear_field(CellArray(scene.array).positions_m, speeds_m_s)
    if field is None:
        return None
    damping = scene.friction.coefficient_s_per_m * scene.gravity_m_s2
    return oscillation(field, damping, starts, times_s)


def oscillation(field: LinearField, damping_per_s: float, starts: Floats, times_s: Floats) -> Floats | None:
    """``X'' = d (K X + v - X')`` from the starts: see `closed_form`.

    Returns:
        None where K has no two independent eigenvectors, or no inverse.
    """
    rates, axes = np.linalg.eig(field.rate_per_s)
    rates, axes = rates.astype(np.complex128), axes.astype(np.complex128)
    if abs(np.linalg.det(axes)) < _INDEPENDENT or np.min(np.abs(rates)) < _INDEPENDENT:
        return None
    rest = -np.linalg.solve(field.rate_per_s, field.offset_m_s)
    place = np.linalg.solve(axes, (starts[:, :2] - rest).T.astype(np.complex128))
    speed = np.linalg.solve(axes, starts[:, 3:5].T.astype(np.complex128))
    along: list[Complex] = [_mode(rates[k], damping_per_s, place[k], speed[k], times_s) for k in range(2)]
    return np.asarray(np.real(np.stack(along, axis=-1) @ axes.T) + rest, dtype=np.float64)


def _mode(rate: complex, damping: float, place: Complex, speed: Complex, times_s: Floats) -> Complex:
    """``q'' = d (rate q - q')``, ``(T, m)``."""
    half = 0.5 * damping
    root = np.sqrt(np.complex128(half * half + damping * rate))
    t = times_s[:, None]
    with np.errstate(over="ignore", invalid="ignore"):
        fall = np.exp(-half * t)
        even = fall * np.cosh(root * t)
        # sinh(x t) / x, which is t where the damping is critical
        odd = fall * (t + 0.0j if abs(root) * times_s.max(initial=0.0) < 1e-8 else np.sinh(root * t) / root)
    return np.asarray(place * even + (speed + half * place) * odd, dtype=np.complex128)
