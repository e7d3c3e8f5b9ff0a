"""Rollers that resist being rolled: closed forms of parcels that are carried, braked and spun on them."""

from __future__ import annotations

from math import expm1, log

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.integrate import solve_ivp

from plant.effects.parcel_contact.bodies import corner_pulls
from plant.friction.registry import FrictionSpec
from plant.kernels.contact import layout as contact_layout
from plant.parcel_spec import ParcelSpec
from plant.plant import Plant
from plant.specs import PlantSpec
from tests.plant.laws import COULOMB, MU, SLIDING, VISCOUS
from tests.plant.scenes import SECOND, Floats, G, parcel, solved

DRAG = 0.05
IMPLICIT: dict[str, object] = {"name": "implicit", "tolerance": 1e-9}
RK4: dict[str, object] = {"name": "fixed_step", "step_s": 1e-3}
WIDE = parcel(size_m=(2.0, 2.0), position_m=(0.0, 0.0), angle_rad=0.0)
"""Over all cells of the array for ever: its supports never change."""


def dragged(
    solver: dict[str, object],
    body: ParcelSpec = WIDE,
    *,
    law: FrictionSpec = VISCOUS,
    drag_s_per_m: float = DRAG,
    **effects: object,
) -> Plant:
    """A plant of nine by nine cells whose rollers resist."""
    table = {"roller_drag": {"drag_s_per_m": drag_s_per_m}} | effects
    return solved(solver, body, law=law, effects=table, rows=9, columns=9)


def uniform(plant: Plant, vx: float, vy: float = 0.0) -> Floats:
    """The same speed of all wheels."""
    return np.tile([vx, vy], (len(plant.array), 1))


@pytest.mark.slow
@pytest.mark.parametrize("solver", [IMPLICIT, RK4], ids=["implicit", "fixed_step"])
def test_viscous_wheels_carry_a_parcel_at_the_share_that_the_drag_leaves(solver: dict[str, object]) -> None:
    # dU/dt = mu g (V - U) - d g U, along each axis by itself
    plant, speed, total = dragged(solver), np.array([0.2, -0.1]), 0.2 + DRAG
    plant.advance(uniform(plant, *speed), SECOND // 2)
    end = speed * 0.2 / total
    assert plant.state[0, 3:5] == pytest.approx(end * -expm1(-total * G * 0.5), abs=1e-10)
    way = end * (0.5 + expm1(-total * G * 0.5) / (total * G))
    assert plant.state[0, :2] == pytest.approx(way, abs=1e-10)


@pytest.mark.slow
def test_without_inertia_a_parcel_has_that_share_at_once() -> None:
    plant = dragged({"name": "quasi_static"})
    plant.advance(uniform(plant, 0.2, -0.1), SECOND // 10)
    assert plant.state[0, 3:5] == pytest.approx(np.array([0.2, -0.1]) * 0.2 / (0.2 + DRAG), rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("solver", [IMPLICIT, RK4], ids=["implicit", "fixed_step"])
def test_a_parcel_spun_on_stopped_wheels_is_braked_by_traction_and_drag_together(
    solver: dict[str, object],
) -> None:
    # I domega/dt = -(mu + d) (W / n) sum r^2 omega
    body = WIDE.model_copy(update={"angular_velocity_rad_s": 3.0})
    plant = dragged(solver, body)
    plant.advance(uniform(plant, 0.0), SECOND // 5)
    squares = float(np.mean(np.sum(plant.array.positions_m**2, axis=1)))
    rate = (0.2 + DRAG) * body.mass_kg * G * squares / body.moment_of_inertia_kg_m2()
    assert plant.state[0, 5] == pytest.approx(3.0 * np.exp(-rate * 0.2), abs=1e-9)
    assert np.abs(plant.state[0, :2]).max() < 1e-12


@pytest.mark.slow
def test_a_parcel_that_slides_to_a_stop_does_so_at_the_known_time_and_place() -> None:
    # dU/dt = -(mu + d U) g
    first = 0.8
    plant = dragged(IMPLICIT, WIDE.model_copy(update={"velocity_m_s": (first, 0.0)}), law=COULOMB)
    stop_s = log(1.0 + DRAG * first / MU) / (DRAG * G)
    way = (first - MU / DRAG * log(1.0 + DRAG * first / MU)) / (DRAG * G)
    still = uniform(plant, 0.0)
    plant.advance(still, round((stop_s - 1e-3) * SECOND))
    assert plant.state[0, 3] == pytest.approx(MU * G * 1e-3, rel=1e-3)
    plant.advance(still, round((stop_s + 1e-3) * SECOND))
    assert plant.state[0, 0] == pytest.approx(way, abs=1e-8)
    assert plant.state[0, 3:].tolist() == [0.0, 0.0, 0.0]


@pytest.mark.slow
@pytest.mark.parametrize("speed", [0.2, 1.0], ids=["sticks", "is outrun for ever"])
def test_coulomb_wheels_carry_a_parcel_no_faster_than_their_grip_overcomes_the_drag(speed: float) -> None:
    # dU/dt = (mu - d U) g up to the wheels' speed, or to mu / d
    drag = 0.5
    plant = dragged(IMPLICIT, law=COULOMB, drag_s_per_m=drag)
    for time_s in (0.05, 0.7):
        plant.advance(uniform(plant, speed), round(time_s * SECOND))
        slipping = MU / drag * -expm1(-drag * G * time_s)
        if slipping < speed:
            assert plant.state[0, 3] == pytest.approx(slipping, abs=1e-9)
        else:
            assert plant.state[0, 3:].tolist() == [speed, 0.0, 0.0]


@pytest.mark.slow
def test_each_cell_drags_by_its_own_load() -> None:
    """Off the middle of its cells a parcel that slides is turned by the drag, against SciPy."""
    body = WIDE.model_copy(update={"position_m": (0.0, 0.15), "velocity_m_s": (0.5, 0.0)})
    slick = VISCOUS.model_copy(update={"coefficient_s_per_m": 1e-12})
    plant = dragged(IMPLICIT, body, law=slick, drag_s_per_m=0.3)
    cells = plant.array.positions_m
    spread = float(np.sum(cells[:, 0] ** 2))
    inertia = body.moment_of_inertia_kg_m2()

    def rates(_: float, y: Floats) -> list[float]:
        share = 1.0 / len(cells) + cells @ y[:2] / spread
        arm = cells - y[:2]
        under = y[3:5] + y[5] * np.stack([-arm[:, 1], arm[:, 0]], axis=1)
        force = -0.3 * body.mass_kg * G * share[:, None] * under
        torque = float(np.sum(arm[:, 0] * force[:, 1] - arm[:, 1] * force[:, 0]))
        return [*y[3:], *(force.sum(axis=0) / body.mass_kg), torque / inertia]

    known = solve_ivp(rates, (0.0, 0.3), plant.state[0], method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    plant.advance(uniform(plant, 0.0), 3 * SECOND // 10)
    # loads balance about the centre of mass: drag that is spread as they are turns nothing that does not turn
    assert known[5] == pytest.approx(0.0, abs=1e-12)
    assert plant.state[0] == pytest.approx(known, abs=1e-9)


@pytest.mark.slow
def test_drag_acts_on_the_parcel_and_not_on_the_motors() -> None:
    """With wheels that feel what they pull, against SciPy's account of parcel and wheels."""
    tau, inertia, volts = 0.06, 0.3, 2.0
    plant = dragged(
        IMPLICIT,
        motors={"time_constant_s": tau, "supply_v": 1e3},
        wheel_load={"inertia_kg": inertia},
        drag_s_per_m=0.4,
    )
    cells = plant.array.positions_m
    spread, n, mass = float(np.sum(cells[:, 0] ** 2)), len(cells), WIDE.mass_kg

    def rates(_: float, y: Floats) -> Floats:
        speed = y[2:]
        load = mass * G * (1.0 / n + cells[:, 0] * y[0] / spread)
        force = 0.2 * load * (speed - y[1])
        drag = 0.4 * mass * G * y[1]
        return np.array([y[1], (force.sum() - drag) / mass, *((0.1 * volts - speed) / tau - force / inertia)])

    known = solve_ivp(rates, (0.0, 0.2), np.zeros(2 + n), method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    plant.advance(uniform(plant, volts), SECOND // 5)
    assert plant.state[0, [0, 3]] == pytest.approx(known[:2], abs=1e-9)
    assert plant.wheel_speed[:, 0] == pytest.approx(known[2:], abs=1e-8)


def test_what_bounds_the_motion_between_contacts_bounds_the_drag_too() -> None:
    """A corner is dragged at most as hard as if the whole weight resisted it from one end."""
    mass, inertia, radius = np.array([2.0]), np.array([0.05]), np.array([0.3])
    free, rolled = (
        corner_pulls(SLIDING.traction(), mass, inertia, radius, np.array([20.0]), G, drag)[0]
        for drag in (0.0, DRAG)
    )
    assert free[contact_layout.UNLIMITED] == 0.0
    hardest = np.sqrt(2.0) * DRAG * 2.0 * G * (1.0 / 2.0 + 0.3 * 0.3 / 0.05)
    assert rolled[contact_layout.UNLIMITED] == pytest.approx(hardest, rel=1e-14)
    assert np.array_equal(
        np.delete(rolled, contact_layout.UNLIMITED), np.delete(free, contact_layout.UNLIMITED)
    )


def test_solvers_that_leave_it_out_are_refused_by_name() -> None:
    for name in ("exact", "scipy", "heyoka"):
        rule = rf"solver\.name {name} leaves out effects\.roller_drag; use implicit or fixed_step or quasi_static"
        with pytest.raises(ValidationError, match=rule):
            dragged({"name": name})


@pytest.mark.parametrize("value", [0.0, -0.1, float("nan"), float("inf")])
def test_a_drag_is_a_positive_number(value: float) -> None:
    table = {"roller_drag": {"drag_s_per_m": value}}
    with pytest.raises(ValidationError, match="drag_s_per_m"):
        PlantSpec.model_validate({"effects": table})
