"""Standing still, coming to rest, and being nudged out of it."""

from __future__ import annotations

import numpy as np
import pytest

from plant.effects.motors import MotorsSpec
from tests.plant.laws import LAWS
from tests.plant.scenes import MU, SECOND, TICK_NS, G, elliptic, parcel
from tests.stability.solvers import Claim, Solver, claiming

KAPPA = MU * G
HALF_AN_HOUR = 1800 * SECOND
EVERY_LAW = ["viscous", "coulomb", "cone", "damped", "damped_cone", "rolling", "stick_slip"]
"""But full sliding, which knows no rest: its wheels are taken to outrun the parcel for ever."""


@claiming(Claim.REST, Claim.PACE)
def test_half_an_hour_on_stopped_wheels_moves_a_parcel_by_nothing(solver: Solver) -> None:
    """H8, creep where it should stick: MuJoCo #3328 (50-2,300 um/s at 20-95 times the margin), newton #3943."""
    plant = solver.plant(parcel())
    before = plant.state
    _, events = plant.advance(np.zeros((400, 2)), HALF_AN_HOUR)
    assert np.array_equal(plant.state, before)
    assert events == []
    assert plant.support_changes == 0
    assert solver.steps(plant) < 100


@pytest.mark.slow
@claiming(Claim.REST, laws=EVERY_LAW)
def test_under_every_law_half_an_hour_at_rest_moves_a_parcel_by_nothing(solver: Solver, law: str) -> None:
    """H8 where friction is a force that rest needs, not one that motion makes."""
    plant = solver.plant(parcel(angle_rad=0.37), law=LAWS[law])
    before = plant.state
    for minute in range(1, 31):
        _, events = plant.advance(np.zeros((400, 2)), minute * 60 * SECOND)
        assert events == []
    assert np.array_equal(plant.state, before)


@pytest.mark.slow
@claiming(Claim.REST)
def test_ticks_on_stopped_wheels_move_a_parcel_by_nothing(solver: Solver) -> None:
    """H8 again, as the lockstep calls it: what a step leaves behind must not add up over ticks."""
    plant = solver.plant(parcel())
    before = plant.state
    for tick in range(1, 500):
        _, events = plant.advance(np.zeros((400, 2)), tick * TICK_NS)
        assert events == []
    assert np.array_equal(plant.state, before)
    assert plant.status[0].state == "at_rest"
    assert plant.status[0].time_s <= TICK_NS * 1e-9
    if solver.claims(Claim.PACE):
        assert solver.steps(plant) < 2 * 500


@claiming(Claim.REST, Claim.PACE)
@pytest.mark.parametrize("motors", [None, MotorsSpec(time_constant_s=0.06)], ids=["ideal", "motors"])
def test_half_an_hour_at_rest_in_a_field_moves_a_parcel_by_nothing_that_adds_up(
    solver: Solver, motors: MotorsSpec | None
) -> None:
    """H8 with turning wheels whose pulls cancel: rounding must not drift with the time that it is given."""
    plant = solver.plant(parcel(position_m=(0.0, 0.0), angle_rad=0.0), motors=motors)
    drives = elliptic(plant) * (1.0 if motors is None else 10.0)
    _, events = plant.advance(drives, HALF_AN_HOUR)
    assert events == []
    assert np.abs(plant.state).max() < 1e-12


@claiming(Claim.PACE)
def test_a_parcel_that_slides_to_a_stop_takes_longer_steps_not_shorter(solver: Solver) -> None:
    """H9, step collapse: MathWorks 2177781 (steps below 1e-16 s, seconds took hours), Drake #11057."""
    body = parcel(position_m=(-0.4, -0.2), velocity_m_s=(1.0, 0.4), angular_velocity_rad_s=5.0)
    plant = solver.plant(body)
    steps = []
    for until in (10 * SECOND, 20 * SECOND, 3600 * SECOND):
        plant.advance(np.zeros((400, 2)), until)
        steps.append(solver.steps(plant))
    sliding, stopping, stopped = np.diff([0, *steps]) / (10.0, 10.0, 3580.0)
    assert plant.status[0].state == "at_rest"
    assert np.hypot(*plant.state[0, 3:5]) < 1e-12
    assert sliding > 2.0 * stopping > 2.0 * stopped


@claiming(Claim.REST, Claim.PACE)
def test_a_parcel_that_slid_to_a_stop_does_not_creep_from_there(solver: Solver) -> None:
    """H8 after H9: what is left of its speed is rounding, and must not carry it anywhere."""
    plant = solver.plant(parcel(position_m=(-0.4, -0.2), velocity_m_s=(1.0, 0.4), angular_velocity_rad_s=5.0))
    plant.advance(np.zeros((400, 2)), 30 * SECOND)
    stopped = plant.state[0, :3]
    plant.advance(np.zeros((400, 2)), 30 * SECOND + HALF_AN_HOUR)
    assert plant.state[0, :3] == pytest.approx(stopped, abs=1e-12)


@claiming(Claim.PACE)
def test_a_parcel_that_comes_to_rest_in_a_field_takes_few_steps_ever_after(solver: Solver) -> None:
    """H9, at an angle of its own: zero torque on either side."""
    _settles(solver, (0.54, 0.32))


@claiming(Claim.PACE, Claim.CHATTER)
def test_a_parcel_that_comes_to_rest_where_it_chattered_takes_few_steps_ever_after(solver: Solver) -> None:
    """H9, with the support changes that go on while it settles (H6: they never end)."""
    _settles(solver, (0.68, 0.42))


def _settles(solver: Solver, size: tuple[float, float]) -> None:
    """An hour at rest in the elliptic field costs little, and a quarter at most of what settling does."""
    plant = solver.plant(parcel(size_m=size))
    plant.advance(elliptic(plant), 60 * SECOND)
    settled, changes = solver.steps(plant), plant.support_changes
    plant.advance(elliptic(plant), 3600 * SECOND)
    resting, settling = (solver.steps(plant) - settled) / 3540.0, settled / 60.0
    # a pull that depends on place bounds the steps of some methods, at rest too: mu g k h^2 < 4 + 2 mu g h
    assert resting < min(2.0, settling / 4.0)
    assert plant.support_changes - changes <= 120
    assert np.abs(plant.state[0, 3:]).max() < solver.within(1e-9)


MOTORS = MotorsSpec(time_constant_s=0.05)


@claiming(Claim.MOTION)
def test_a_pulse_of_the_wheels_of_one_tick_is_never_stepped_over(solver: Solver) -> None:
    """H10: an adaptive solver at rest steps over it (scipy #18039, chebfun #1512, pysd #7)."""
    _pulse(solver, TICK_NS, None)


@claiming(Claim.MOTION, Claim.LAGS)
def test_what_motors_make_of_a_pulse_of_one_tick_is_never_stepped_over(solver: Solver) -> None:
    """H10, where the pulse fades within the next call: nothing of it is left at the ends of a long step's parts."""
    _pulse(solver, TICK_NS, MOTORS)


@claiming(Claim.MOTION, Claim.SCALES)
@pytest.mark.parametrize("motors", [None, MOTORS], ids=["ideal", "motors"])
@pytest.mark.parametrize("pulse_ns", [1_000, 1])
def test_a_pulse_of_the_wheels_of_a_nanosecond_is_never_stepped_over(
    solver: Solver, pulse_ns: int, motors: MotorsSpec | None
) -> None:
    """H10, a millionth as long: what it does is far below most tolerances."""
    _pulse(solver, pulse_ns, motors)


def _pulse(solver: Solver, pulse_ns: int, motors: MotorsSpec | None) -> None:
    """Whatever the lag of motors and of friction, the parcel goes as far as the wheels' command: speed times time."""
    plant = solver.plant(parcel(position_m=(0.0, 0.0)), motors=motors)
    still, drives = np.zeros((400, 2)), np.tile((5.0, -2.5), (400, 1))
    plant.advance(still, 10 * SECOND)
    plant.advance(drives, 10 * SECOND + pulse_ns)
    plant.advance(still, 40 * SECOND)
    way = (
        pulse_ns
        * 1e-9
        * np.array([5.0, -2.5])
        * (1.0 if motors is None else motors.first_order.speed_per_volt_m_s)
    )
    off = solver.within(1e-14)
    assert off < 1e-2 * np.abs(way).min()
    assert plant.state[0, :2] == pytest.approx(way, rel=1e-9, abs=off)
    assert plant.state[0, 2] == pytest.approx(0.9, abs=solver.within(1e-12))


@claiming(Claim.ENERGY)
@pytest.mark.parametrize("coasting", [0, 150])
def test_with_stopped_wheels_kinetic_energy_never_rises(solver: Solver, coasting: int) -> None:
    """H16: a step-size-dependent oscillation feeds itself (Drake #9241 was cured by another step, or 20 N)."""
    body = parcel(
        position_m=(-0.4, -0.2),
        velocity_m_s=(1.2, 0.5),
        angular_velocity_rad_s=6.0,
        centre_of_mass_m=(0.08, 0.03),
        inertia_kg_m2=0.09,
    )
    plant = solver.plant(body)
    plant.release_wheels(
        [int(i) for i in np.random.default_rng(1).choice(400, coasting, replace=False)], "coast"
    )
    state = plant.trajectory(np.zeros((400, 2)), 2 * SECOND, 1_000_000).state[:, 0]
    energy = state[:, 3] ** 2 + state[:, 4] ** 2 + 0.045 * state[:, 5] ** 2
    assert np.all(np.diff(energy) <= 1e-15)
    assert energy[-1] < 0.2 * energy[0]


@claiming(Claim.ENERGY, laws=EVERY_LAW)
def test_under_every_law_stopped_wheels_take_kinetic_energy_and_never_give_any(
    solver: Solver, law: str
) -> None:
    """H16 where the force jumps: a step too long would throw the parcel back faster than it came."""
    body = parcel(position_m=(0.1, 0.05), velocity_m_s=(0.6, -0.3), angular_velocity_rad_s=5.0)
    plant = solver.plant(body, law=LAWS[law])
    state = plant.trajectory(np.zeros((400, 2)), SECOND, 2_000_000).state[:, 0]
    energy = state[:, 3] ** 2 + state[:, 4] ** 2 + (0.54**2 + 0.32**2) / 12.0 * state[:, 5] ** 2
    assert np.all(np.diff(energy) <= 1e-15)
    assert energy[-1] < 0.5 * energy[0]
