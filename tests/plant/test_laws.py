"""Traction laws, each by what is known of it otherwise."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from plant.analysis.constants import constants_of_motion
from plant.effects.motors import MotorsSpec
from plant.errors import PlantError
from plant.friction.coulomb import Coulomb
from plant.friction.registry import FrictionSpec
from plant.friction.stick_slip import StickSlip
from plant.plant import Plant
from plant.specs import PlantSpec
from tests.plant.laws import (
    CONE,
    COULOMB,
    DAMPED,
    DAMPED_CONE,
    LAWS,
    MOTORS,
    MU,
    ROLLING,
    SLIDING,
    STICK_SLIP,
    B,
)
from tests.plant.scenes import SECOND, Floats, G, lawful, loads, parcel, spec

SMALL = parcel(position_m=(0.0, 0.0), angle_rad=0.0)
ALL = {name: law for name, law in LAWS.items() if name != "sliding"}
"""But full sliding, which holds only while every wheel outruns the parcel."""


def drive(plant: Plant, vx: float, vy: float = 0.0) -> Floats:
    """The same speed of all wheels."""
    return np.tile([vx, vy], (len(plant.array), 1))


def test_every_law_that_a_scene_can_ask_for_is_tested() -> None:
    laws = get_args(get_args(FrictionSpec)[0])
    assert {type(law) for law in LAWS.values()} == set(laws)


# --- Coulomb ------------------------------------------------------------------------------------------------------


def _slid_to_rest(plant: Plant, radius: float, step_ns: int) -> Floats:
    """``|U| / (R omega)`` every ``step_ns`` on a stopped surface, down to 1 % of the first speed; both end together."""
    still, seen = drive(plant, 0.0), []
    first = float(np.hypot(*plant.state[0, 3:5]))
    for k in range(1, 2000):
        speed, turning = float(np.hypot(*plant.state[0, 3:5])), float(plant.state[0, 5])
        if speed < 0.01 * first:
            break
        seen.append(speed / (radius * turning))
        plant.advance(still, k * step_ns)
    plant.advance(still, 4000 * step_ns)
    assert plant.state[0, 3:].tolist() == [0.0, 0.0, 0.0]
    return np.array(seen)


def _round(radius: float) -> tuple[tuple[float, float], ...]:
    """Corners of what is a disc but for 48 edges."""
    angle = 2.0 * np.pi * np.arange(48) / 48
    return tuple((radius * float(np.cos(a)), radius * float(np.sin(a))) for a in angle)


def _spun_disc(ratio: float) -> Floats:
    """A disc, isotropic, R/pitch 20."""
    radius, omega = 0.2, 2.0
    body = parcel(
        vertices_m=_round(radius),
        position_m=(0.0, 0.0),
        angle_rad=0.0,
        velocity_m_s=(ratio * radius * omega, 0.0),
        angular_velocity_rad_s=omega,
    )
    plant = lawful(CONE, body, step_s=5e-4, rows=60, columns=70, pitch_m=0.01)
    return _slid_to_rest(plant, radius, SECOND // 1000)


def _spun_ring(ratio: float) -> Floats:
    """A thin ring: mass and contact both at R, cells being there and nowhere else; so slow that it hardly moves."""
    pitch, radius, omega, side = 0.005, 0.2, 0.1, 110
    rows, columns = np.divmod(np.arange(side * side), side)
    far = pitch * np.hypot(rows - 0.5 * (side - 1), columns - 0.5 * (side - 1))
    on = np.abs(far - radius) < 0.2 * pitch
    body = parcel(
        vertices_m=_round(0.25),
        inertia_kg_m2=2.0 * float(np.mean(far[on] ** 2)),
        position_m=(0.0, 0.0),
        angle_rad=0.0,
        velocity_m_s=(ratio * radius * omega, 0.0),
        angular_velocity_rad_s=omega,
    )
    cells = tuple((int(r), int(c)) for r, c in zip(rows[on], columns[on], strict=True))
    plant = lawful(CONE, body, step_s=2e-5, rows=side, columns=side, pitch_m=pitch, cells=cells)
    return _slid_to_rest(plant, radius, 40_000)


@pytest.mark.slow
def test_coulomb_alone_a_disc_slides_and_spins_to_one_end_at_the_known_ratio() -> None:
    """Both motions end together, with ``|U| / (R omega)`` tending to 0.653; on this lattice 0.65."""
    slow, steady, fast = _spun_disc(0.45), _spun_disc(0.65), _spun_disc(0.9)
    assert steady == pytest.approx(0.65, abs=0.01)
    assert np.all(np.diff(slow[::5]) > 0.0)
    assert np.all(np.diff(fast[::5]) < 0.0)
    assert 0.58 < slow[-1] < 0.66
    assert 0.64 < fast[-1] < 0.70


def test_coulomb_alone_a_ring_slides_and_spins_to_one_end_at_the_ratio_one() -> None:
    """The same for a ring: its motions end together with ``|U| = R omega``."""
    slow, steady, fast = _spun_ring(0.8), _spun_ring(1.0), _spun_ring(1.25)
    assert steady == pytest.approx(1.0, abs=2e-3)
    assert np.all(np.diff(slow[::5]) > 0.0)
    assert np.all(np.diff(fast[::5]) < 0.0)
    assert 0.9 < slow[-1] < 1.01
    assert 0.99 < fast[-1] < 1.1


@pytest.mark.parametrize("steps", [{"step_s": 1e-3}, {"step_s": 1e-5}, {"tolerance": 1e-6}])
def test_a_parcel_sticks_to_wheels_that_start_to_turn_in_steps_however_short(steps: dict[str, float]) -> None:
    """Their speeds begin as differences of large numbers: what rounding leaves of the slip must not count as slip."""
    body = parcel(size_m=(2.0, 2.0), position_m=(0.0, 0.0), angle_rad=0.0)
    motors = MotorsSpec(time_constant_s=0.1, speed_per_volt_m_s=0.1, supply_v=1e6)
    plant = lawful(COULOMB, body, motors=motors, rows=9, columns=9, **steps)
    cells = plant.array.positions_m
    plant.advance(0.5 * np.stack([-cells[:, 1], cells[:, 0]], axis=1), SECOND // 10_000)
    assert plant.state[0, 5] == pytest.approx(0.05 * -np.expm1(-1e-3), rel=1e-11)
    assert plant._solver.effort <= 10


# --- Coulomb with viscous friction -------------------------------------------------------------------------------


@pytest.mark.parametrize("law", [DAMPED, DAMPED_CONE], ids=["independent wheels", "cone"])
def test_with_viscous_friction_a_parcel_stops_at_the_known_time_and_place(law: Coulomb) -> None:
    """``m dU/dt = -mu m g - n b U``: it stops after ``log(1 + n b U0 / (mu m g)) / (n b / m)``."""
    first = 0.8
    body = parcel(size_m=(2.0, 2.0), position_m=(0.0, 0.0), angle_rad=0.0, velocity_m_s=(first, 0.0))
    plant = lawful(law, body, tolerance=1e-10, rows=5, columns=5)
    rate, still = 25 * law.viscous_n_s_per_m / body.mass_kg, drive(plant, 0.0)
    stop_s = np.log1p(rate * first / (MU * G)) / rate
    plant.advance(still, round(0.5 * stop_s * SECOND))
    speed = (first + MU * G / rate) * np.exp(-0.5 * rate * stop_s) - MU * G / rate
    assert plant.state[0, 3] == pytest.approx(speed, abs=1e-9)
    plant.advance(still, round((stop_s + 1e-3) * SECOND))
    assert plant.state[0, 0] == pytest.approx((first - MU * G * stop_s) / rate, abs=1e-9)
    assert plant.state[0, 3:].tolist() == [0.0, 0.0, 0.0]


def test_viscous_friction_pulls_whatever_the_load_and_beyond_the_limit() -> None:
    """Wheels that run away from a parcel pull it by ``mu m g + sum b (V - U)``: SciPy has the same."""
    body = parcel(size_m=(2.0, 2.0), position_m=(0.03, -0.02), angle_rad=0.0)
    plant = lawful(DAMPED, body, tolerance=1e-9, rows=5, columns=5)
    cells, mass = plant.array.positions_m, body.mass_kg
    wheels = np.stack([2.0 + cells[:, 1], 1.5 - cells[:, 0]], axis=1)
    squares = np.sum(cells * cells, axis=0)

    def rates(_: float, y: Floats) -> list[float]:
        load = mass * G * (1.0 / 25.0 + cells @ (y[:2] / squares))
        arm = cells - y[:2]
        slip = wheels - (y[3:5] + y[5] * np.stack([-arm[:, 1], arm[:, 0]], axis=1))
        force = MU * load[:, None] * np.sign(slip) + DAMPED.viscous_n_s_per_m * slip
        torque = float(np.sum(arm[:, 0] * force[:, 1] - arm[:, 1] * force[:, 0]))
        return [*y[3:], *(force.sum(axis=0) / mass), torque / body.moment_of_inertia_kg_m2()]

    known = solve_ivp(rates, (0.0, 0.05), plant.state[0], method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    plant.advance(wheels, SECOND // 20)
    assert plant.state[0] == pytest.approx(known, abs=1e-9)
    assert abs(known[5]) > 0.01


# --- full sliding (eq. 24) ----------------------------------------------------------------------------------------


def test_full_sliding_pulls_alike_whatever_the_parcel_does_and_says_when_a_wheel_is_outrun() -> None:
    plant = lawful(SLIDING, SMALL, step_s=1e-3)
    _, events = plant.advance(drive(plant, 0.2), SECOND // 20)
    assert plant.state[0, 3] == pytest.approx(MU * G * 0.05, rel=1e-9)
    assert "outrun" not in {event.kind for event in events}
    _, events = plant.advance(drive(plant, 0.2), SECOND // 10)
    assert plant.state[0, 3] == pytest.approx(MU * G * 0.1, rel=1e-9)
    (outrun,) = [event for event in events if event.kind == "outrun"]
    assert outrun.time_s == pytest.approx(0.2 / (MU * G), abs=1e-3)
    assert outrun.cells


def test_full_sliding_says_so_of_a_parcel_that_moves_over_wheels_that_stand() -> None:
    plant = lawful(SLIDING, parcel(position_m=(0.0, 0.0), angle_rad=0.0, velocity_m_s=(0.0, 0.1)))
    _, events = plant.advance(drive(plant, 0.2), SECOND // 100)
    assert [event.kind for event in events].count("outrun") == 1


def test_full_sliding_is_coulomb_while_every_wheel_outruns_the_parcel() -> None:
    body = parcel(position_m=(0.12, 0.07), angle_rad=0.4)
    ends = []
    for law in (SLIDING, COULOMB):
        plant = lawful(law, body, tolerance=1e-9)
        wheels = np.where(plant.array.positions_m >= 0.0, -1.0, 1.0) * (2.0, 3.0)
        plant.advance(wheels, SECOND // 5)
        ends.append(plant.state[0])
    assert ends[0] == pytest.approx(ends[1], abs=1e-8)


# --- rolling (eqs. 27-28) -----------------------------------------------------------------------------------------


def test_rolling_follows_equations_27_and_28_integrated_by_scipy() -> None:
    body = parcel(
        position_m=(0.013, 0.008), angle_rad=0.05, velocity_m_s=(0.05, -0.02), angular_velocity_rad_s=0.2
    )
    plant = lawful(ROLLING, body, tolerance=1e-10)
    rng = np.random.default_rng(7)
    wheels = 0.02 * rng.standard_normal((len(plant.array), 2))
    cells = plant._solver.covered_cells(0)
    place, push = plant.array.positions_m[cells], (2.0 * 10.0 / 4.0) * wheels[cells]
    inertia = 2.0 / (12.0 / (0.54**2 + 0.32**2))

    def rates(_: float, y: Floats) -> list[float]:
        arm = place - y[:2]
        force = push - B * (y[3:5] + y[5] * np.stack([-arm[:, 1], arm[:, 0]], axis=1))
        torque = float(np.sum(arm[:, 0] * force[:, 1] - arm[:, 1] * force[:, 0]))
        return [y[3], y[4], y[5], *(force.sum(axis=0) / 2.0), torque / inertia]

    known = solve_ivp(rates, (0.0, 0.3), plant.state[0], rtol=1e-12, atol=1e-14).y[:, -1]
    plant.advance(wheels, 3 * SECOND // 10)
    assert plant.support_changes == 0
    assert np.abs(plant.state[0] - known).max() < 1e-8


def test_rolling_does_not_depend_on_loads_but_on_their_supports_and_mass() -> None:
    """A parcel whose mass lies off its centre has other loads, and the same force."""
    ends = []
    for centre in ((0.0, 0.0), (0.05, 0.02)):
        body = parcel(position_m=centre, centre_of_mass_m=centre, angle_rad=0.0, inertia_kg_m2=1e9)
        plant = lawful(ROLLING, body, tolerance=1e-10)
        plant.advance(drive(plant, 0.1), SECOND // 20)
        ends.append(plant.state[0, 3])
    assert ends[0] == pytest.approx(ends[1], rel=1e-8)


# --- stick-slip ---------------------------------------------------------------------------------------------------


def _end(law: FrictionSpec) -> Floats:
    plant = lawful(law, parcel(position_m=(0.02, 0.01), angular_velocity_rad_s=0.8), tolerance=1e-7)
    plant.advance(drive(plant, 0.2, -0.1), SECOND // 5)
    return plant.state[0]


def test_stick_slip_with_grip_enough_is_rolling() -> None:
    ample = StickSlip(law="stick_slip", coefficient=1e3, **MOTORS)
    assert _end(ample) == pytest.approx(_end(ROLLING), abs=1e-12)
    assert np.abs(_end(STICK_SLIP) - _end(ROLLING)).max() > 1e-3


def test_stick_slip_with_ever_stiffer_motors_tends_to_coulomb() -> None:
    coulomb, off = _end(COULOMB), []
    for gain in (1e3, 1e4, 1e5):
        stiff = StickSlip(
            law="stick_slip",
            coefficient=MU,
            motor_constant_n_per_a=1.0,
            resistance_ohm=1.0,
            gain_v_s_per_m=gain,
        )
        off.append(np.abs(_end(stiff) - coulomb).max())
    assert off[0] > 5.0 * off[1] > 25.0 * off[2]
    assert off[2] < 1e-4


# --- what the laws differ in --------------------------------------------------------------------------------------


def test_coulomb_loads_are_those_that_the_exact_solver_finds() -> None:
    """The force on a parcel off its centre, on wheels of random direction, summed over the exact solver's loads."""
    body = parcel(position_m=(0.123, -0.071), angle_rad=0.7, centre_of_mass_m=(0.06, 0.03))
    exact = Plant(spec(body))
    cells, share = loads(exact)
    plant = lawful(SLIDING, body, step_s=1e-6)
    wheels = np.random.default_rng(3).choice([-1.0, 1.0], (len(plant.array), 2))
    plant.advance(wheels, 1000)
    assert plant.state[0, 3:5] * 1e6 == pytest.approx(
        MU * G * (share[:, None] * wheels[cells]).sum(axis=0), rel=1e-9
    )


# --- what fits together -------------------------------------------------------------------------------------------


def test_a_law_with_motors_of_its_own_refuses_the_effect() -> None:
    with pytest.raises(
        ValueError, match=r"friction\.law rolling has motors of its own; leave effects\.motors out"
    ):
        lawful(ROLLING, motors=MotorsSpec())


def test_exact_refuses_what_it_does_not_solve() -> None:
    base = dict(spec(parcel()))
    rule = r"solver\.name exact solves law viscous, .*, stick_slip, not coulomb; use implicit"
    with pytest.raises(ValueError, match=rule):
        PlantSpec.model_validate(base | {"friction": COULOMB})


def test_constants_of_motion_are_refused_for_other_laws_than_viscous() -> None:
    given = PlantSpec.model_validate(
        dict(spec(parcel())) | {"friction": COULOMB, "solver": {"name": "implicit"}}
    )
    with pytest.raises(
        PlantError, match=r'"coulomb": there are constants of motion .* for the law viscous only'
    ):
        constants_of_motion(given, 0, np.zeros((400, 2)))
