"""The ends of an integrator's steps past a graze: where it looks, and where the cell is then."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, final

import numpy as np

from deploy.accuracy.evidence.runs import Run, run, scene_with
from deploy.simulate import field_speeds
from plant.array import CellArray
from plant.footing import Footing
from plant.friction.viscous import viscous_of
from plant.geometry import edges
from plant.loads import share_matrix

if TYPE_CHECKING:
    from deploy.scene import Scene
    from plant.wheels import Floats

TOLERANCES = (1e-6, 1e-9, 1e-12)
_LONG_S = 0.7
"""Far enough that no first step ends there."""


@final
@dataclass(frozen=True, slots=True)
class Steps:
    """Motion on one support set, as if no cell came or went, in steps of DOP853's.

    Attributes:
        course: ``(2, k)`` times, s, and how deep the cell then lies inside the footprint, m; negative outside.
        ends: ``(2, n)`` likewise at the ends of the steps, by tolerance.
    """

    course: Floats
    ends: dict[float, Floats]


def steps_past(cell: tuple[int, int], since_s: float, until_s: float) -> Steps:
    """Integrate the scene ``elliptic`` on the supports that it has at one time.

    Args:
        cell: row and column of the one that is looked at.
        since_s: when supports have just changed.
        until_s: where the course is to end; steps go on as long as they like.
    """
    begun = scene_with("elliptic", f"duration_s={np.ceil(since_s * 1e9) * 1e-9:.9f}")
    last = run(begun, {"name": "exact", "tolerance": 1e-14})
    rate = _rate(begun, last)
    depth = _depth(begun, last, cell)
    integrate: Any = import_module("scipy.integrate").solve_ivp
    start = float(last.time_s[-1])
    ends: dict[float, Floats] = {}
    course: Floats = np.zeros((2, 0))
    for tolerance in TOLERANCES:
        found = integrate(
            rate,
            (start, start + _LONG_S),
            last.state[-1],
            method="DOP853",
            rtol=tolerance,
            atol=tolerance,
            dense_output=True,
        )
        ends[tolerance] = np.stack([found.t, depth(found.y)])
        fine = np.linspace(start, until_s, 200)
        course = np.stack([fine, depth(found.sol(fine))])
    return Steps(course, ends)


def _rate(scene: Scene, last: Run) -> Callable[[float, Floats], Floats]:
    """Eqs. 2, 14 and 15 on the cells that carry the parcel where the run ends."""
    spec = scene.plant_spec()
    array = CellArray(spec.array)
    x, y, angle = last.state[-1, :3].tolist()
    parcel = spec.parcels[0].model_copy(update={"position_m": (x, y), "angle_rad": angle})
    footing = Footing(array, parcel)
    cells = footing.carrying()
    places, speeds = array.positions_m[cells], field_speeds(scene, array.positions_m)[cells]
    centroid = places.mean(axis=0)
    share = share_matrix(places - centroid)
    kappa = viscous_of(spec.friction, "the graze").rate(spec.gravity_m_s2)
    turn = parcel.mass_kg / footing.inertia_kg_m2

    def rate(_: float, y: Floats) -> Floats:
        lever = places - y[:2]
        slip = speeds - y[3:5] - y[5] * np.stack([-lever[:, 1], lever[:, 0]], axis=1)
        pull = kappa * (share @ np.array([1.0, *(y[:2] - centroid)]))[:, None] * slip
        torque = np.sum(lever[:, 0] * pull[:, 1] - lever[:, 1] * pull[:, 0])
        return np.concatenate([y[3:], pull.sum(axis=0), [turn * torque]])

    return rate


def _depth(scene: Scene, last: Run, cell: tuple[int, int]) -> Callable[[Floats], Floats]:
    """How deep the cell lies inside the footprint in states ``(6, k)``, m; negative outside."""
    array = CellArray(scene.array)
    place = array.positions_m[array.lattice.index(cell)]
    normal, reach = edges(last.footprint_m)

    def depth(states: Floats) -> Floats:
        dx, dy = place[:, None] - states[:2]
        c, s = np.cos(states[2]), np.sin(states[2])
        body = np.stack([c * dx + s * dy, c * dy - s * dx], axis=1)
        return np.asarray((reach - body @ normal.T).min(axis=1), dtype=np.float64)

    return depth
