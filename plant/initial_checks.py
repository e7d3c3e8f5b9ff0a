"""Initial checks: every parcel stands where it starts or is fed, and no two parcels overlap."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from plant.errors import PlantError
from plant.overlap import OverlapDetector
from plant.solver_api import Solver
from plant.specs import PlantSpec
from plant.wheels import Floats

if TYPE_CHECKING:
    from plant.effects.feeders.traffic import Traffic


def check_standing(spec: PlantSpec, solver: Solver, cells: int) -> None:
    """Find every parcel's first loads.

    Args:
        spec: names the key of what is refused.
        solver: its parcels are at their start.
        cells: how many the array has.

    Raises:
        PlantError: the cells under a parcel can't carry it.
    """
    driven = np.ones(cells)
    for i, body in enumerate(solver.bodies):
        check_stands(solver, i, driven, _place(spec, i, body.state))


def check_stands(solver: Solver, index: int, driven: Floats, place: str) -> None:
    """Find the loads of a parcel at its pose.

    Args:
        solver: solver of the parcel.
        index: which parcel.
        driven: ``(n,)`` ones.
        place: names the parcel, or the key of its place, in the error.

    Raises:
        PlantError: the cells under the parcel can't carry it.
    """
    under = len(solver.covered_cells(index))
    if under == 0:
        raise PlantError(f"{place}: the parcel stands on nothing: no cell's centre lies under it")
    if not solver.find_supports(index, driven):
        raise PlantError(
            f"{place}: the parcel would tip: its centre of mass lies outside the {_counted(under)} under it"
        )


def check_free(state: Floats, index: int, overlaps: OverlapDetector, there: NDArray[np.int64]) -> None:
    """Refuse a pose at which a parcel overlaps another.

    Args:
        state: ``(parcels, 6)``.
        index: which parcel.
        overlaps: overlap detector of the parcels' footprints.
        there: parcels on the surface, ascending.

    Raises:
        PlantError: it overlaps one.
    """
    other = overlaps.first_blocker(index, state, there[there != index])
    if other is not None:
        raise PlantError(f"parcel {index} would overlap parcel {other}")


def _counted(cells: int) -> str:
    return "one cell" if cells == 1 else f"{cells} cells"


def check_places(spec: PlantSpec, state: Floats, overlaps: OverlapDetector, traffic: Traffic | None) -> None:
    """Refuse parcels that overlap at the start, and parcels that start inside an exit.

    Args:
        spec: scene of the plant, which names the keys in errors.
        state: states of all parcels at the start, ``(parcels, 6)``.
        overlaps: overlap detector of the parcels' footprints.
        traffic: parcels on the surface and exits; None: all parcels are there and there are no exits.

    Raises:
        PlantError: there is such a parcel.
    """
    there = np.arange(len(state)) if traffic is None else traffic.on_surface
    for first, second, depth, place in overlaps.pairs(state, there):
        raise PlantError(
            f"parcels[{first}] and parcels[{second}] overlap at the start by {depth:.3g} m near "
            f"[{place[0]:.3g}, {place[1]:.3g}]"
        )
    if traffic is None:
        return
    for i, pose in enumerate(state):
        name = traffic.exit_at(pose[:2])
        if name is not None:
            raise PlantError(f"{_place(spec, i, pose)}: lies in exit {name}: the parcel would leave at once")


def _place(spec: PlantSpec, number: int, pose: Floats) -> str:
    """Key and value of where a parcel starts; of one that is fed, as it was drawn."""
    return f"{spec.parcel_key(number)}.position_m = [{pose[0]:g}, {pose[1]:g}]"
