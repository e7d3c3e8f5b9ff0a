"""Plants whose parcels touch."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from plant import geometry
from plant.effects.parcel_contact.bodies import pack
from plant.effects.parcel_contact.spec import ParcelContactSpec
from plant.effects.registry import PlantEffects
from plant.kernels.contact import entry as contact_entry
from plant.observations import Event
from plant.parcel_spec import ParcelSpec
from plant.plant import Plant
from plant.solver_specs import ImplicitSpec
from plant.specs import PlantSpec
from tests.plant.scenes import TICK_NS, parcel, spec

Floats = NDArray[np.float64]
FREE = 1e-12
"""A viscous coefficient that doesn't slow anything within a test."""
BOX = 0.25
CONTACTS = ("contact", "apart", "contact_residual", "parted")


def box(x: float, y: float, angle: float = 0.0, **values: object) -> ParcelSpec:
    """A square parcel of 2 kg."""
    settings = {"size_m": (BOX, BOX), "position_m": (x, y), "angle_rad": angle}
    return parcel(**(settings | values))


def plant(
    *parcels: ParcelSpec, mu: float = FREE, fine: bool = False, implicit: float | None = None, **rules: object
) -> Plant:
    """A plant with the effect; ``fine`` cells carry small parcels anywhere; ``implicit`` is that solver's step, s."""
    across, pitch_m = (120, 0.04) if fine else (20, 0.1)
    values = dict(spec(*parcels, mu=mu, rows=across, columns=across, pitch_m=pitch_m)) | {
        "effects": PlantEffects(parcel_contact=ParcelContactSpec.model_validate(rules))
    }
    if implicit is not None:
        values["solver"] = ImplicitSpec(name="implicit", step_s=implicit)
    return Plant(PlantSpec.model_validate(values))


def still(plant: Plant) -> Floats:
    """Wheels that stand."""
    return np.zeros((len(plant.array), 2))


def ticks(plant: Plant, drives: Floats, count: int) -> Iterator[list[Event]]:
    """Events of contact of each tick."""
    for _ in range(count):
        _, events = plant.advance(drives, plant.time_ns + TICK_NS)
        yield [event for event in events if event.kind in CONTACTS]


def run(plant: Plant, drives: Floats, seconds: float) -> list[Event]:
    """All events of contact of a run."""
    count = round(seconds * 1e9 / TICK_NS)
    return [event for tick in ticks(plant, drives, count) for event in tick]


def energy(plant: Plant, parcels: tuple[ParcelSpec, ...]) -> float:
    """Kinetic energy, J."""
    mass = np.array([one.mass_kg for one in parcels])
    inertia = np.array([one.moment_of_inertia_kg_m2() for one in parcels])
    state = plant.state
    return float(0.5 * np.sum(mass * (state[:, 3] ** 2 + state[:, 4] ** 2) + inertia * state[:, 5] ** 2))


def least_gap(plant: Plant) -> float:
    """The least free space between any two parcels, m; negative where they overlap."""
    shapes, state = pack(plant.footprints_m), plant.state
    return min(
        contact_entry.gap(shapes, i, j, state[i], state[j])[0]
        for i in range(len(state))
        for j in range(i + 1, len(state))
    )


@st.composite
def polygons(draw: st.DrawFn) -> Floats:
    """Convex polygons of 2 to 7 corners, about a point within a metre of theirs."""
    count = draw(st.integers(2, 7))
    turns = np.cumsum([draw(st.floats(0.2, 1.0)) for _ in range(count)])
    angle = 2.0 * np.pi * turns / (turns[-1] + 0.2)
    size = draw(st.floats(0.1, 1.0))
    corners = size * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    middle = (draw(st.floats(-0.5, 0.5)), draw(st.floats(-0.5, 0.5)))
    return corners + np.array(middle)


def placed(outline: Floats, pose: Floats) -> Floats:
    """Corners in the world."""
    return geometry.placed(outline, pose)
