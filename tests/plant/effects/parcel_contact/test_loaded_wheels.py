"""Touching parcels on wheels that feel what they pull: against SciPy, and what a look ahead must not take."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from plant.effects.parcel_contact.spec import ParcelContactSpec
from plant.parcel_spec import ParcelSpec
from plant.plant import Plant
from plant.specs import PlantSpec
from tests.plant.effects.parcel_contact.benches import Floats, box, run
from tests.plant.laws import VISCOUS
from tests.plant.scenes import TICK_NS, G, spec

TAU, INERTIA, MASS, PITCH = 0.06, 0.3, 2.0, 0.1
VOLTS = 10.0
"""For 1 m/s."""
START, STOP = (0.04, 0.05), 0.05
"""Where the first box starts, and where the rail holds it: over the same nine cells, about (0.05, 0.05)."""
RAIL = ((STOP + 0.125, -0.3), (STOP + 0.125, 0.3))


def plant(*parcels: ParcelSpec, load: bool = True, contact: dict[str, object] | None = None) -> Plant:
    """A small array of motors."""
    values = dict(spec(rows=8, columns=10, pitch_m=PITCH)) | {"parcels": parcels}
    effects: dict[str, object] = {"motors": {"time_constant_s": TAU, "supply_v": 1e3}}
    if load:
        effects["wheel_load"] = {"inertia_kg": INERTIA}
    if contact is not None:
        effects["parcel_contact"] = ParcelContactSpec.model_validate(contact)
    values |= {"effects": effects, "solver": {"name": "implicit", "tolerance": 1e-9}}
    return Plant(PlantSpec.model_validate(values))


def belt(plant: Plant) -> Floats:
    """Volts that drive everything along x."""
    return np.tile([VOLTS, 0.0], (len(plant.array), 1))


def solved(seconds: float) -> tuple[float, Floats]:
    """SciPy's account of one box and the wheels under it, held by the rail: (instant of the impact, wheel speeds)."""
    cells = np.array([-PITCH, 0.0, PITCH]).repeat(3)
    friction = VISCOUS.coefficient_s_per_m * MASS * G

    def shares(x: float) -> Floats:
        # loads that vary along x, as a plane does, about the centre of the nine cells
        return (1.0 + (x - START[1]) * cells / np.mean(cells**2)) / 9.0

    def slope(_: float, z: Floats) -> Floats:
        x, v, wheels = z[0], z[1], z[2:]
        force = friction * shares(x) * (wheels - v)
        return np.concatenate([[v, force.sum() / MASS], (1.0 - wheels) / TAU - force / INERTIA])

    def strikes(_: float, z: Floats) -> float:
        return float(z[0] - STOP)

    strikes.terminal = True  # type: ignore[attr-defined]
    start = np.concatenate([[START[0], 0.0], np.zeros(9)])
    free = solve_ivp(slope, (0.0, seconds), start, method="DOP853", rtol=1e-12, atol=1e-13, events=strikes)
    impact = float(free.t[-1])
    rate = 1.0 / TAU + friction * shares(STOP) / INERTIA
    end = 1.0 / TAU / rate
    return impact, end + (free.y[2:, -1] - end) * np.exp(-rate * (seconds - impact))


@pytest.mark.parametrize("step_s", [1e-3, 1e-4])
def test_a_box_that_a_rail_holds_slows_the_wheels_below_as_far_as_motors_let_it(step_s: float) -> None:
    held = plant(box(*START), contact={"rails": (RAIL,), "step_s": step_s})
    ticks = 120
    events = run(held, belt(held), ticks * TICK_NS * 1e-9)
    impact, wheels = solved(ticks * TICK_NS * 1e-9)
    assert events[0].kind == "contact"
    assert events[0].time_s == pytest.approx(impact, abs=1e-7)
    under = np.all(np.abs(held.array.positions_m - START[1]) < 1.5 * PITCH, axis=1)
    speed = held.wheel_speed[under, 0].reshape(3, 3)
    # in each step of contact the box first moves freely: what wheels feel is of the step's order
    assert speed == pytest.approx(np.tile(wheels.reshape(3, 3).T[0], (3, 1)), abs=0.1 * step_s)
    assert np.ptp(held.wheel_speed[~under, 0]) < 1e-12
    assert held.wheel_speed[under, 0].max() < 0.97 * held.wheel_speed[~under, 0].min()


def test_contact_that_is_only_reported_takes_nothing_from_the_wheels() -> None:
    boxes = (box(0.0, 0.0, 0.3), box(0.3, 0.02, 0.7))
    alone, watched = plant(*boxes), plant(*boxes, contact={"mode": "report_only"})
    for one in (alone, watched):
        run(
            one, 0.3 * belt(one) - VOLTS * np.stack([one.array.positions_m[:, 0] * 6.0, np.zeros(80)], 1), 0.5
        )
    assert np.array_equal(alone.wheel_speed, watched.wheel_speed)
    assert np.array_equal(alone.state, watched.state)
