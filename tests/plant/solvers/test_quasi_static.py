"""Motion without inertia: the velocity balances all pulls, and exact motion tends to it where fields are slow."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from plant.effects.motors import MotorsSpec
from plant.friction.registry import FrictionSpec
from plant.plant import Plant
from plant.solvers.restarting import RestartingSolver
from tests.plant.laws import COULOMB, ROLLING, SLIDING, VISCOUS
from tests.plant.scenes import SECOND, TICK_NS, Floats, elliptic, parcel, solved
from tests.plant.test_laws import ALL, SMALL, drive


def opposed(plant: Plant, left: float, right: float) -> Floats:
    """Wheels left of the middle drive to the right, the others to the left."""
    x = plant.array.positions_m[:, 0]
    return np.stack([np.where(x < 0.0, left, -right), np.zeros_like(x)], axis=1)


def quasi(*bodies: object, tolerance: float = 1e-6, step_s: float | None = None, **values: object) -> Plant:
    solver: dict[str, object] = {"name": "quasi_static", "tolerance": tolerance, "step_s": step_s}
    return solved(solver, *bodies, **values)  # type: ignore[arg-type]


# --- the velocity -------------------------------------------------------------------------------------------------


def potential(plant: Plant, law: FrictionSpec, wheels: Floats, velocity: Floats) -> float:
    """The dissipation potential at a velocity of one parcel of 2 kg, loads from NumPy's own solver."""
    traction, body = law.traction(), plant.state[0]
    at_rest = parcel(position_m=tuple(body[:2]), angle_rad=float(body[2]))
    solver = solved({"name": "scipy"}, at_rest)._solver
    assert isinstance(solver, RestartingSolver)
    (one,) = solver._parcels
    assert one.supports is not None
    away = body[:2] - one.supports.centroid_m
    load = 2.0 * 9.81 * np.maximum(one.supports.plane @ np.array([1.0, *away]), 0.0)[:, None]
    lever = plant.array.positions_m[one.under] - body[:2]
    slip = traction.free_speed * wheels[one.under] - velocity[:2]
    slip -= velocity[2] * np.stack([-lever[:, 1], lever[:, 0]], axis=1)
    size = np.hypot(slip[:, :1], slip[:, 1:]) if traction.isotropic else np.abs(slip)
    limit = traction.limit + traction.limit_per_load * load
    viscous = 0.5 * traction.viscous * float(np.sum(size * size))
    if traction.set_valued:
        return float(np.sum(limit * size)) + viscous
    b = traction.stiffness + traction.stiffness_per_load * load
    bent = np.minimum(size, limit / np.maximum(b, 1e-300))
    straight = np.where(np.isfinite(limit), limit, 0.0) * (size - bent)
    return float(np.sum(0.5 * b * bent**2 + straight)) + viscous


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("seed", range(3))
def test_the_velocity_is_at_the_minimum_of_the_dissipation_potential(name: str, seed: int) -> None:
    draw = np.random.default_rng(seed)
    body = parcel(position_m=tuple(draw.uniform(-0.1, 0.1, 2)), angle_rad=draw.uniform(0.0, 3.0))
    plant = quasi(body, law=ALL[name])
    wheels = draw.uniform(-0.5, 0.5, plant.array.positions_m.shape)
    plant.advance(wheels, 1)
    found = plant.state[0, 3:]
    least = potential(plant, ALL[name], wheels, found)
    for size in (1e-1, 1e-2, 1e-3, 1e-4, 1e-5):
        for _ in range(20):
            away = size * draw.standard_normal(3)
            assert potential(plant, ALL[name], wheels, found + away) >= least * (1.0 - 1e-13)


def test_in_a_linear_field_the_centre_runs_down_the_field_whatever_the_supports() -> None:
    """Under the viscous law the pulls sum to ``mu W (K X - U)``: X' = K X, in closed form."""
    plant = quasi(tolerance=1e-9)
    plant.advance(elliptic(plant), SECOND)
    assert plant.support_changes > 30
    assert plant.state[0, :2] == pytest.approx([0.55 * np.exp(-1.0), 0.5 * np.exp(-2.0)], abs=1e-9)
    assert plant.state[0, 3:5] == pytest.approx(plant.state[0, :2] * (-1.0, -2.0), abs=1e-9)


def test_a_velocity_left_open_is_the_nearest_to_the_last() -> None:
    """Coulomb between two groups of wheels that pull alike against each other: any speed between theirs balances."""
    for start, end in ((0.03, 0.03), (-0.05, -0.05), (0.5, 0.2), (-0.5, -0.1)):
        body = parcel(position_m=(0.0, 0.0), angle_rad=0.0, velocity_m_s=(start, 0.0))
        plant = quasi(body, law=COULOMB)
        plant.advance(opposed(plant, 0.2, 0.1), 1)
        assert plant.state[0, 3:] == pytest.approx([end, 0.0, 0.0], abs=1e-7)


@pytest.mark.parametrize("name", ALL)
def test_where_all_wheels_are_dead_the_parcel_goes_on_as_it_went(name: str) -> None:
    body = parcel(position_m=(0.0, 0.0), angle_rad=0.3)
    plant = quasi(body, law=ALL[name])
    plant.advance(drive(plant, 0.2, 0.1), TICK_NS)
    before = plant.state[0]
    plant.release_wheels(range(400), "coast")
    plant.advance(drive(plant, -0.5), 101 * TICK_NS)
    assert plant.state[0, 3:] == pytest.approx(before[3:], abs=1e-15)
    assert plant.state[0, :2] == pytest.approx(before[:2] + 100 * TICK_NS * 1e-9 * before[3:5], abs=1e-12)
    assert abs(before[3]) > 0.1


def test_one_driven_cell_gives_the_parcel_its_speed_and_turns_it_no_more_than_it_must() -> None:
    """All other wheels turn freely: the underside follows the one cell, the rest is least change from rest."""
    body = parcel(position_m=(0.02, 0.01), angle_rad=0.2)
    plant = quasi(body)
    under = plant._solver.covered_cells(0)
    cell = int(under[np.argmax(plant.array.positions_m[under, 0])])
    plant.release_wheels([i for i in range(400) if i != cell], "coast")
    plant.advance(drive(plant, 0.0, 0.2), 1)
    vx, vy, turning = plant.state[0, 3:]
    lever = plant.array.positions_m[cell] - plant.state[0, :2]
    assert [vx - turning * lever[1], vy + turning * lever[0]] == pytest.approx([0.0, 0.2], abs=1e-12)
    gyration2 = (0.54**2 + 0.32**2) / 12.0
    # least ``|U|^2 + gyration^2 turning^2`` under those two: the pull at the cell is all there is
    assert gyration2 * turning == pytest.approx(lever[0] * vy - lever[1] * vx, abs=1e-12)


# --- the motion ---------------------------------------------------------------------------------------------------


def test_steps_are_of_third_order_where_the_velocity_does_not_jump() -> None:
    """The centre's in a linear field does not, whatever supports change."""
    steps, off = [1e-2, 5e-3, 2.5e-3], []
    for step in steps:
        plant = quasi(step_s=step)
        plant.advance(elliptic(plant), SECOND)
        off.append(np.abs(plant.state[0, :2] - (0.55 * np.exp(-1.0), 0.5 * np.exp(-2.0))).max())
    assert np.polyfit(np.log(steps), np.log(off), 1)[0] == pytest.approx(3.0, abs=0.1)


def test_controlled_steps_keep_the_tolerance_where_it_jumps() -> None:
    fine = quasi(tolerance=1e-11)
    fine.advance(elliptic(fine), SECOND)
    for tolerance in (1e-4, 1e-6, 1e-8):
        plant = quasi(tolerance=tolerance)
        plant.advance(elliptic(plant), SECOND)
        assert plant.support_changes == fine.support_changes > 30
        assert np.abs(plant.state - fine.state)[0, :3].max() < 4.0 * tolerance


@pytest.mark.parametrize("law", [VISCOUS, ROLLING], ids=["viscous", "rolling"])
def test_the_difference_from_the_motion_with_inertia_falls_with_the_speed_of_the_field(
    law: FrictionSpec,
) -> None:
    """The same way through a field eps times as fast: off by O(eps), eps being its rate over that of the pulls."""
    with_inertia = {"name": "exact"} if law is VISCOUS else {"name": "implicit", "tolerance": 1e-6}
    rates, off = [0.2, 0.1, 0.05], []
    for rate in rates:
        ends = []
        for solver in (with_inertia, {"name": "quasi_static", "tolerance": 1e-6}):
            plant = solved(solver, parcel(), law=law)  # type: ignore[arg-type]
            plant.advance(elliptic(plant, -rate, -2.0 * rate), round(0.5 / rate * SECOND))
            ends.append(plant.state[0, :3])
            assert plant.support_changes > 15
        off.append(float(np.abs(ends[1] - ends[0]).max()))
    assert np.polyfit(np.log(rates), np.log(off), 1)[0] == pytest.approx(1.0, abs=0.2)
    assert off[-1] < 0.02


def test_a_velocity_given_at_the_start_has_no_meaning() -> None:
    ends = []
    for velocity in ((0.0, 0.0), (0.7, -0.4)):
        plant = quasi(parcel(velocity_m_s=velocity, angular_velocity_rad_s=velocity[0]))
        plant.advance(elliptic(plant), SECOND // 10)
        ends.append(plant.state[0])
    assert ends[0] == pytest.approx(ends[1], abs=1e-9)


def test_chatter_is_followed_at_a_bounded_cost() -> None:
    """The parcel comes to rest with a cell on its edge: the angle is known, whatever the inertia."""
    plant = quasi(parcel(size_m=(0.68, 0.42), position_m=(0.0, 0.0), angle_rad=0.25))
    plant.advance(elliptic(plant), 5 * SECOND)
    assert plant.state[0, 2] == pytest.approx(0.17925400095, abs=1e-5)
    assert plant._solver.parcels[0].ctl[4] < 150_000  # attempted steps


def test_motors_are_followed() -> None:
    """One speed of all wheels is the parcel's too, at every instant."""
    plant = quasi(SMALL, motors=MotorsSpec(time_constant_s=0.05, speed_per_volt_m_s=0.1))
    plant.advance(drive(plant, 3.0), SECOND // 10)
    ramp = 0.3 * (0.1 - 0.05 * (1.0 - np.exp(-2.0)))
    assert plant.state[0, 0] == pytest.approx(ramp, abs=1e-6)
    assert plant.state[0, 3] == pytest.approx(0.3 * (1.0 - np.exp(-2.0)), abs=1e-9)


def test_cells_that_turn_freely_carry_and_pull_nothing() -> None:
    body = parcel(position_m=(0.05, 0.03), angle_rad=0.4)
    plant = quasi(body)
    dead = [int(cell) for cell in plant._solver.covered_cells(0)[::2]]
    plant.release_wheels(dead, "coast")
    wheels = elliptic(plant)
    wheels[dead] = 1e3
    plant.advance(wheels, 1)
    assert np.abs(plant.state[0, 3:]).max() < 1.0


def test_full_sliding_has_no_balance_and_is_refused() -> None:
    with pytest.raises(
        ValidationError, match="solves law viscous, coulomb, rolling, stick_slip, not coulomb_sliding"
    ):
        quasi(law=SLIDING)
