"""Kernel data of load and wheel effects, for solvers that support these effects."""

from __future__ import annotations

from importlib import import_module

import numpy as np
from numpy.typing import NDArray

from plant.array import CellArray
from plant.effects.roller_impacts import starts
from plant.effects.uneven_friction import friction_factors
from plant.effects.uneven_supports import supports
from plant.kernels.common import layout
from plant.kernels.common.surface import AllEdges, AllRollers, AllSprings, AllStiction, AllTransfer
from plant.specs import PlantSpec
from plant.wheels import Floats


def make_springs(scene: PlantSpec, array: CellArray) -> AllSprings | None:
    """The springs under the parcels, None where all are equal.

    Kernels compiled from now on know of uneven springs, if the scene has them.

    Args:
        scene: the scene's physics.
        array: the surface.
    """
    uneven = scene.effects.uneven_supports
    if uneven is None:
        return None
    import_module("plant.kernels.effects.uneven_springs")
    drawn = supports(uneven, array.lattice, scene.seed)
    weight = scene.gravity_m_s2 * np.array([parcel.mass_kg for parcel in scene.parcels])
    per_m = drawn.stiffness_n_per_m / weight
    return AllSprings(
        rate=drawn.rate,
        gap_m=-drawn.height_m,
        per_m=per_m,
        span=per_m * float(np.max(np.abs(drawn.height_m))),
        moments=np.zeros((len(scene.parcels), 3)),
    )


def make_edges(scene: PlantSpec, capacity: int) -> AllEdges | None:
    """Room for how much of each cell is under each parcel, None where wheels have no width.

    Kernels compiled from now on know of such wheels, if the scene has them.

    Args:
        scene: the scene's physics.
        capacity: cells that fit under any parcel.
    """
    wide = scene.effects.contact_width
    if wide is None:
        return None
    import_module("plant.kernels.effects.wheel_edges")
    return AllEdges(wide.width_m, np.zeros((len(scene.parcels), capacity)))


def make_drag(scene: PlantSpec) -> float | None:
    """Drag of the rollers under a parcel's whole weight over its mass, 1/s; None where rollers are free.

    Kernels compiled after this call include the drag, if the scene has it.
    """
    dragging = scene.effects.roller_drag
    if dragging is None:
        return None
    import_module("plant.kernels.effects.roller_drag")
    return dragging.drag_s_per_m * scene.gravity_m_s2


def make_factors(scene: PlantSpec, array: CellArray) -> Floats | None:
    """Traction of each wheel over the law's, ``(n, 2)``; None where all wheels are alike.

    Kernels compiled after this call include the factors, if the scene has them.

    Args:
        scene: the scene's physics.
        array: the surface.
    """
    uneven = scene.effects.uneven_friction
    if uneven is None:
        return None
    import_module("plant.kernels.effects.uneven_friction")
    return friction_factors(uneven, array.lattice, scene.seed)


def make_transfer(scene: PlantSpec) -> AllTransfer | None:
    """Shift of each parcel's loads; None where traction acts at the height of the centres of mass.

    Kernels compiled after this call include load transfer, if the scene has it.
    """
    transfer = scene.effects.load_transfer
    if transfer is None:
        return None
    import_module("plant.kernels.effects.load_transfer")
    own = [parcel.centre_of_mass_height_m for parcel in scene.parcels]
    heights = [transfer.centre_of_mass_height_m if height is None else height for height in own]
    return AllTransfer(
        lever_s2=np.array(heights) / scene.gravity_m_s2,
        shift=np.zeros((len(heights), layout.MODES, 2)),
        change=np.zeros((len(heights), layout.MODES, 4)),
        memory=np.zeros((len(heights), 3)),
    )


def make_stiction(scene: PlantSpec, capacity: int) -> AllStiction | None:
    """Memory of how wheels hold each parcel; None where static friction is the kinetic one.

    Kernels compiled after this call include static friction, if the scene's law has it.

    Args:
        scene: the scene's physics.
        capacity: cells that fit under any parcel.
    """
    ratio = scene.friction.traction().static_ratio
    if ratio == 1.0:
        return None
    import_module("plant.kernels.effects.stiction")

    def rows(columns: int) -> NDArray[np.int64]:
        return np.zeros((len(scene.parcels), capacity, columns), dtype=np.int64)

    return AllStiction(
        ratio=ratio,
        grips=rows(3),
        counts=np.zeros((len(scene.parcels), 2), dtype=np.int64),
        begun=rows(3),
        found=rows(3),
        limits=np.zeros((len(scene.parcels), capacity, 2)),
        caught=rows(2),
    )


def make_rollers(scene: PlantSpec, array: CellArray) -> AllRollers | None:
    """Build the roller positions of each wheel for each parcel; None where wheels are smooth.

    Kernels compiled after this call include rollers, if the scene has them.

    Args:
        scene: the scene's physics.
        array: the surface.
    """
    rollers = scene.effects.roller_impacts
    if rollers is None:
        return None
    import_module("plant.kernels.effects.roller_impacts")
    cells = len(array)
    return AllRollers(
        spacing_m=rollers.spacing_m,
        impulse_m_s=rollers.impulse_s * scene.gravity_m_s2,
        start=starts(cells, scene.seed),
        # a parcel's own, so that parcels in several threads share none; zeros take no memory until a wheel is met
        passed=np.zeros((len(scene.parcels), cells, 2)),
    )
