"""Forces that are limited or set-valued: slip that turns round, wheels that disagree, a surface that moves."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from plant.effects.motors import MotorsSpec
from plant.plant import Plant
from tests.plant.laws import FREE, LAWS, MU, B
from tests.plant.scenes import SECOND, TICK_NS, Floats, G, parcel
from tests.stability.solvers import Claim, Solver, claiming

PULL = MU * G
"""Acceleration by wheels all of which slip one way, m/s^2."""
MILLI = SECOND // 1_000
SET_VALUED = ["coulomb", "cone"]
SMALL = parcel(position_m=(0.0, 0.0), angle_rad=0.0)


def _uniform(plant: Plant, vx: float, vy: float = 0.0) -> Floats:
    """The same speed of all wheels."""
    return np.tile([vx, vy], (len(plant.array), 1))


# --- slip that turns round ----------------------------------------------------------------------------------------


@claiming(Claim.MOTION, Claim.STICKING, laws=SET_VALUED)
@pytest.mark.parametrize("then", [0.0, -2.0, 2.0], ids=["stop", "run on", "turn back"])
def test_a_parcel_braked_to_zero_goes_on_as_its_wheels_then_say(
    solver: Solver, law: str, then: float
) -> None:
    """H7, the next condition is at its root already: OrdinaryDiffEq #3222, DiffEqBase #634."""
    plant, t = solver.plant(SMALL, law=LAWS[law]), 0.064
    for k, speed in enumerate((2.0, -2.0, then), 1):
        plant.advance(_uniform(plant, speed), 64 * MILLI * k)
    way = PULL * t * t + np.sign(then) * 0.5 * PULL * t * t
    assert plant.state[0, 0] == pytest.approx(way, abs=solver.within(1e-13))
    assert plant.state[0, 3] == pytest.approx(np.sign(then) * PULL * t, abs=solver.within(1e-13))
    if then == 0.0:
        stopped = plant.state
        assert stopped[0, 3:].tolist() == [0.0, 0.0, 0.0]
        plant.advance(_uniform(plant, 0.0), 60 * SECOND)
        assert np.array_equal(plant.state, stopped)


TAU, FULL = 0.1, 1.2
"""Time constant of the motors, s; their speed at full supply, m/s."""


def _overtaken(t: float) -> tuple[float, float]:
    """Place and speed of a parcel whose wheels start up for 0.15 s, then stop: dragged on, overtaking, held."""
    cut = 0.15
    first = FULL * -np.expm1(-cut / TAU)

    def wheel(s: float) -> float:
        return float(first * np.exp(-s / TAU))

    overtakes = brentq(lambda s: wheel(s) - PULL * (cut + s), 0.0, 0.1, xtol=1e-15)
    fastest = PULL * (cut + overtakes)
    # slip turns round without a stop: the wheel slows down faster than friction could
    assert wheel(overtakes) / TAU > PULL
    held = brentq(lambda s: wheel(s) - fastest + PULL * (s - overtakes), overtakes + 0.05, 0.4, xtol=1e-15)
    assert wheel(held) / TAU < PULL
    s = t - cut
    if s <= overtakes:
        return 0.5 * PULL * t * t, PULL * t
    x, u = 0.5 * PULL * (cut + overtakes) ** 2, fastest
    slid = min(s, held) - overtakes
    x, u = x + u * slid - 0.5 * PULL * slid * slid, u - PULL * slid
    if s <= held:
        return x, u
    return x + TAU * (wheel(held) - wheel(s)), wheel(s)


@claiming(Claim.MOTION, Claim.STICKING, Claim.LAGS, laws=SET_VALUED)
@pytest.mark.parametrize("tick_ns", [TICK_NS, 10 * MILLI, 50 * MILLI])
def test_slip_turns_round_where_a_wheel_slows_down_faster_than_friction_and_ends_where_it_no_longer_does(
    solver: Solver, law: str, tick_ns: int
) -> None:
    """H7 between ticks, at no velocity that is special: slip is zero for an instant first, and for good then."""
    motors = MotorsSpec(time_constant_s=TAU, speed_per_volt_m_s=0.1, supply_v=12.0)
    plant = solver.plant(SMALL, law=LAWS[law], motors=motors)
    for until in [*range(tick_ns, 150 * MILLI, tick_ns), 150 * MILLI]:
        plant.advance(_uniform(plant, 12.0), until)
    for until in [*range(150 * MILLI + tick_ns, 600 * MILLI, tick_ns), 600 * MILLI]:
        plant.advance(_uniform(plant, 0.0), until)
        x, u = _overtaken(until * 1e-9)
        assert plant.state[0, 0] == pytest.approx(x, abs=solver.within(1e-12))
        assert plant.state[0, 3] == pytest.approx(u, abs=solver.within(1e-12))


@claiming(Claim.MOTION, laws=["stick_slip"])
def test_wheels_that_turn_round_pull_by_their_motors_up_to_what_each_cell_carries(
    solver: Solver, law: str
) -> None:
    """H7 where slip sticks to a slope, not to zero: each cell leaves its limit when its own load says so."""
    body = parcel(size_m=(0.58, 0.38), position_m=(0.01, 0.0), angle_rad=0.0)
    plant = solver.plant(body, law=LAWS[law])
    cells = plant.array.positions_m[plant._solver.covered_cells(0)]
    spread = float(np.sum(cells[:, 0] ** 2))

    def rates(t: float, y: Floats, command: float) -> list[float]:
        load = 2.0 * G * (1.0 / len(cells) + cells[:, 0] * y[0] / spread)
        pull = np.clip(B * (FREE * command - y[1]), -MU * load, MU * load)
        return [y[1], float(pull.sum()) / 2.0]

    y = plant.state[0, [0, 3]]
    for k, command in enumerate((0.3, -0.3, 0.15, 0.0), 1):
        y = solve_ivp(rates, (0.0, 0.05), y, args=(command,), rtol=1e-11, atol=1e-13, max_step=1e-4).y[:, -1]
        plant.advance(_uniform(plant, command), 50 * MILLI * k)
        assert plant.state[0, [0, 3]] == pytest.approx(y, abs=solver.within(1e-9))
    assert plant.support_changes == 0


# --- wheels that disagree -----------------------------------------------------------------------------------------


def _five_by_five(solver: Solver, law: str, x: float, y: float) -> Plant:
    """A parcel on 25 cells, a little off their middle."""
    body = parcel(size_m=(0.5, 0.5), position_m=(x, y), angle_rad=0.0)
    return solver.plant(body, law=LAWS[law], rows=5, columns=5)


@claiming(Claim.STICKING, Claim.PACE, laws=SET_VALUED)
@pytest.mark.parametrize("y", [0.0, 0.012], ids=["pushed", "pushed and turned"])
def test_half_an_hour_between_opposed_wheels_below_the_limit_of_others_moves_a_parcel_by_nothing(
    solver: Solver, law: str, y: float
) -> None:
    """H8, creep under a load that friction holds: MuJoCo #3328, newton #3943."""
    plant = _five_by_five(solver, law, 0.01, y)
    before = plant.state
    drives = _uniform(plant, 0.0)
    # the middle column holds: a fifth of the weight against a push of 0.06 of it
    drives[:, 0] = -0.5 * np.sign(np.round(plant.array.positions_m[:, 0], 3))
    for minute in range(1, 31):
        _, events = plant.advance(drives, 60 * minute * SECOND)
        assert events == []
    assert np.array_equal(plant.state[0, :3], before[0, :3])


@claiming(Claim.MOTION, Claim.STICKING, laws=SET_VALUED)
def test_the_same_wheels_move_a_parcel_once_those_that_hold_let_go(solver: Solver, law: str) -> None:
    """H8, the other way round: at rest by balance, not by neglect."""
    plant = _five_by_five(solver, law, 0.01, 0.0)
    drives = _uniform(plant, 0.0)
    drives[:, 0] = -0.5 * np.sign(np.round(plant.array.positions_m[:, 0], 3))
    plant.release_wheels([int(i) for i in np.flatnonzero(drives[:, 0] == 0.0)], "coast")
    plant.advance(drives, 20 * MILLI)
    # x'' = -w^2 x: the push grows with the distance from the middle
    w = np.sqrt(PULL * 5.0 * 0.6 / 0.5)
    assert plant.state[0, 0] == pytest.approx(0.01 * np.cos(w * 0.02), abs=solver.within(1e-12))


@claiming(Claim.MOTION, laws=SET_VALUED)
def test_wheels_driven_on_the_diagonal_pull_root_two_times_as_hard_where_they_are_independent(
    solver: Solver, law: str
) -> None:
    """H18, a pyramid is no cone (SimBenchmark's rolling test)."""
    plant = solver.plant(SMALL, law=LAWS[law])
    plant.advance(_uniform(plant, 1.0, 1.0), 10 * MILLI)
    expected = PULL * 0.01 * (np.sqrt(2.0) if law == "coulomb" else 1.0)
    assert np.hypot(*plant.state[0, 3:5]) == pytest.approx(expected, abs=solver.within(1e-13))


@claiming(Claim.MOTION, laws=SET_VALUED)
def test_a_parcel_that_slides_askew_is_braked_along_each_axis_alike_only_by_independent_wheels(
    solver: Solver, law: str
) -> None:
    """H18: a box slows each axis down by itself, a cone the motion."""
    body = parcel(position_m=(0.0, 0.0), angle_rad=0.0, velocity_m_s=(0.5, 0.4))
    plant = solver.plant(body, law=LAWS[law])
    plant.advance(_uniform(plant, 0.0), 50 * MILLI)
    start, pull = np.array([0.5, 0.4]), PULL * 0.05
    expected = start - pull if law == "coulomb" else start * (1.0 - pull / np.hypot(*start))
    assert plant.state[0, 3:5] == pytest.approx(expected, abs=solver.within(1e-12))


@claiming(Claim.MOTION, Claim.STICKING, laws=SET_VALUED)
def test_independent_wheels_hold_on_the_diagonal_what_isotropic_ones_let_go(solver: Solver, law: str) -> None:
    """H18: eight cells pull along x, eight along y, nine hold: 8 < 9 on each axis, but 11.3 > 9 together."""
    plant = _five_by_five(solver, law, 0.0, 0.0)
    # by distance from the middle, so that opposite cells do the same and nothing turns
    far = np.round(np.sum(plant.array.positions_m**2, axis=1), 4)
    drives = _uniform(plant, 0.0)
    drives[far == 0.05, 0] = 100.0
    drives[(far == 0.04) | (far == 0.08), 1] = 100.0
    assert [int(np.count_nonzero(drives[:, axis])) for axis in (0, 1)] == [8, 8]
    plant.advance(drives, 20 * MILLI)
    if law == "coulomb":
        assert np.abs(plant.state).max() < 1e-15
    else:
        speed = PULL * 0.02 * (8.0 * np.sqrt(2.0) - 9.0) / 25.0
        # a parcel that moves at v turns the slip of wheels at 100 m/s by v / 100
        assert plant.state[0, 3:5] == pytest.approx([speed / np.sqrt(2.0)] * 2, rel=1e-3)


# --- a surface that moves -----------------------------------------------------------------------------------------


@claiming(Claim.MOTION, laws=["viscous", "coulomb", "cone", "damped", "damped_cone", "rolling", "stick_slip"])
def test_the_same_slip_pulls_the_same_whether_wheels_or_parcel_move(solver: Solver, law: str) -> None:
    """H19, moving against stopped surface: Webots #2412, IsaacLab #6885."""
    speed, moved = np.array([0.6, -0.3]), []
    free = LAWS[law].traction().free_speed  # of a wheel, as a share of what it is told
    for wheels, own in ((1.0, 0.0), (0.0, -1.0)):
        start = own * speed
        body = parcel(
            size_m=(2.0, 2.0), position_m=(0.0, 0.0), angle_rad=0.0, velocity_m_s=(start[0], start[1])
        )
        # under wheels that all are under the parcel for ever: relative to them, the scenes are one
        plant = solver.plant(body, law=LAWS[law], rows=9, columns=9)
        plant.advance(_uniform(plant, *(wheels * speed / free)), 70 * MILLI)
        state = plant.state[0]
        moved.append([*(state[:2] - wheels * speed * 0.07), *(state[3:5] - wheels * speed)])
        assert state[[2, 5]] == pytest.approx([0.0, 0.0], abs=solver.within(1e-12))
    assert moved[0] == pytest.approx(moved[1], abs=solver.within(1e-12))
    # and it does pull
    assert np.hypot(*moved[0][2:]) < 0.9 * np.hypot(*speed)


@claiming(Claim.STICKING, laws=[*SET_VALUED, "damped", "damped_cone"])
@pytest.mark.parametrize(("wheels", "start"), [(0.2, 0.0), (0.0, 0.2), (0.2, 0.5), (-0.2, 0.2)])
def test_a_parcel_takes_on_its_wheels_speed_to_the_bit_and_keeps_it(
    solver: Solver, law: str, wheels: float, start: float
) -> None:
    """H19: sticking to wheels that run is sticking to wheels that stand."""
    body = parcel(position_m=(-0.3, 0.0), angle_rad=0.0, velocity_m_s=(start, 0.0))
    plant = solver.plant(body, law=LAWS[law])
    stuck_s = abs(wheels - start) / PULL
    plant.advance(_uniform(plant, wheels), round((stuck_s + 0.03) * SECOND))
    for tick in range(3):
        assert plant.state[0, 3:].tolist() == [wheels, 0.0, 0.0]
        plant.advance(_uniform(plant, wheels), plant.time_ns + (tick + 1) * TICK_NS)


@claiming(Claim.STICKING, Claim.PACE, laws=["coulomb"])
def test_a_parcel_that_has_come_to_stick_on_moving_wheels_does_not_turn_against_them(
    solver: Solver, law: str
) -> None:
    """H8 on a surface that moves, after sliding and turning."""
    body = parcel(position_m=(-0.5, 0.0), angle_rad=0.3, angular_velocity_rad_s=1.0, velocity_m_s=(0.0, 0.1))
    plant = solver.plant(body, law=LAWS[law])
    plant.advance(_uniform(plant, 0.01), SECOND)
    angle = plant.state[0, 2]
    assert plant.state[0, 3:].tolist() == [0.01, 0.0, 0.0]
    plant.advance(_uniform(plant, 0.01), 60 * SECOND)
    assert plant.state[0, 3:].tolist() == [0.01, 0.0, 0.0]
    assert plant.state[0, 2] == angle
