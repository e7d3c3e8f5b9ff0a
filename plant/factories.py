"""Factories of the plant's optional parts: motors, traffic, sensor levels, scanners, camera, parcel contact.

Each factory imports the modules of its effect itself, so that a scene without the effect loads none of its code.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

from plant.array import CellArray
from plant.effects.registry import PlantEffects
from plant.effects.uneven_friction import friction_factors
from plant.friction.law import Traction
from plant.observations import ParcelStatus
from plant.overlap import OverlapDetector
from plant.solver_api import Rewindable, SegmentingSolver, Solver
from plant.specs import PlantSpec
from plant.wheels import IdealWheels, Wheels

if TYPE_CHECKING:
    from plant.effects.analogue_sensors.spots import Spots
    from plant.effects.camera.camera import Camera
    from plant.effects.feeders.traffic import Traffic
    from plant.effects.parcel_contact.mover import ContactMover
    from plant.effects.scanners.scanners import Scanners


def make_wheels(spec: PlantSpec, cells: int) -> Wheels:
    """The wheels of all cells: ideal ones, or with motors."""
    motors = spec.effects.motors
    if motors is None:
        return IdealWheels(cells)
    from plant.effects.motors import Motors

    return Motors(motors, cells, loaded=spec.effects.wheel_load is not None)


def make_traffic(
    spec: PlantSpec, solver: Solver, status: list[ParcelStatus], overlaps: OverlapDetector
) -> Traffic | None:
    """Parcels that come and go, None where all stay.

    Args:
        spec: the scene's physics.
        solver: its parcels are at their start.
        status: of each; changed as they come and go.
        overlaps: knows their footprints.
    """
    feeders = spec.effects.feeders
    if feeders is None:
        return None
    from plant.effects.feeders.traffic import Traffic

    destinations = [parcel.destination for parcel in spec.with_fed().parcels]
    return Traffic(feeders, spec.seed, solver.state, status, overlaps, destinations)


def make_spots(spec: PlantSpec, array: CellArray) -> Spots | None:
    """Make the model of sensor spots' coverage; None where sensors have no levels."""
    analogue = spec.effects.analogue_sensors
    if analogue is None:
        return None
    from plant.effects.analogue_sensors.spots import Spots

    return Spots(analogue, array, spec.with_fed().parcels)


def make_scanners(spec: PlantSpec, array: CellArray) -> Scanners | None:
    """Make the label scanners; None where the scene has no scanners or no feeders."""
    scanners, feeders = spec.effects.scanners, spec.effects.feeders
    if scanners is None or feeders is None:
        return None
    from plant.effects.scanners.scanners import Scanners

    return Scanners(scanners, feeders, array, spec.with_fed().parcels)


def make_camera(effects: PlantEffects, tick_ns: int, seed: int, later: int = 0) -> Camera | None:
    """Make the camera; None where the scene has no camera. See ``plant.effects.camera.camera.Camera``."""
    if effects.camera is None:
        return None
    from plant.effects.camera.camera import Camera

    return Camera(effects.camera, tick_ns, seed, later)


def make_mover(spec: PlantSpec, solver: Solver) -> ContactMover | None:
    """Make the mover of touching parcels; None where the scene has no parcel contact."""
    contact = spec.effects.parcel_contact
    if contact is None:
        return None
    from plant.effects.parcel_contact.mover import ContactMover

    rollers = spec.effects.roller_drag
    # the spec lets only solvers be chosen that can go back
    return ContactMover(
        spec.with_fed().parcels,
        _strongest(spec),
        spec.gravity_m_s2,
        0.0 if rollers is None else rollers.drag_s_per_m,
        spec.array.pitch_m,
        contact,
        cast("Rewindable", solver),
    )


def _strongest(spec: PlantSpec) -> Traction:
    """The scene's law, as strong as the wheel of the most friction has it."""
    traction, uneven = spec.friction.traction(), spec.effects.uneven_friction
    if uneven is None:
        return traction
    most = float(friction_factors(uneven, spec.array.lattice(), spec.seed).max())
    return traction._replace(
        stiffness_per_load=most * traction.stiffness_per_load,
        limit_per_load=most * traction.limit_per_load,
        push_per_load=most * traction.push_per_load,
    )


def segmenting_solver(spec: PlantSpec, solver: Solver) -> SegmentingSolver | None:
    """The solver, if it divides calls for each parcel by itself; None where it can't, or effects act on all at once."""
    effects = spec.effects
    together = (effects.parcel_contact, effects.wheel_load, effects.analogue_sensors, effects.scanners)
    if spec.solver.name != "exact" or any(effect is not None for effect in together):
        return None
    return cast("SegmentingSolver", solver)
