"""Traction laws, each by what is known of it otherwise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from plant.constants import constants_of_motion
from plant.effects.motors import MotorsSpec
from plant.errors import PlantError
from plant.friction.coulomb import Coulomb
from plant.friction.coulomb_sliding import CoulombSliding
from plant.friction.registry import FrictionSpec
from plant.friction.rolling import Rolling
from plant.friction.stick_slip import StickSlip
from plant.friction.viscous import Viscous
from plant.plant import Plant
from plant.specs import PlantSpec
from tests.plant.scenes import SECOND, Floats, G, lawful, loads, parcel, spec

MU = 0.3
MOTORS = {"motor_constant_n_per_a": 2.0, "resistance_ohm": 4.0, "gain_v_s_per_m": 10.0, "drag_n_s_per_m": 0.5}
B = 0.5 + 2.0 * 2.0 / 4.0 + 2.0 * 10.0 / 4.0  # N s/m
FREE = 2.0 * 10.0 / 4.0 / B  # of the commanded speed
SMALL = parcel(position_m=(0.0, 0.0), angle_rad=0.0)
VISCOUS = Viscous(coefficient_s_per_m=0.2)
COULOMB = Coulomb(law="coulomb", coefficient=MU)
CONE = Coulomb(law="coulomb", coefficient=MU, contact="isotropic")
SLIDING = CoulombSliding(law="coulomb_sliding", coefficient=MU)
ROLLING = Rolling(law="rolling", **MOTORS)
STICK_SLIP = StickSlip(law="stick_slip", coefficient=MU, **MOTORS)
ALL = {
    "viscous": VISCOUS,
    "coulomb": COULOMB,
    "cone": CONE,
    "rolling": ROLLING,
    "stick_slip": STICK_SLIP,
}


def drive(plant: Plant, vx: float, vy: float = 0.0) -> Floats:
    """The same speed of all wheels."""
    return np.tile([vx, vy], (len(plant.array), 1))


def opposed(plant: Plant, left: float, right: float) -> Floats:
    """Wheels left of the middle drive to the right, the others to the left."""
    x = plant.array.positions_m[:, 0]
    return np.stack([np.where(x < 0.0, left, -right), np.zeros_like(x)], axis=1)


# --- Coulomb ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", [COULOMB, CONE], ids=["independent", "isotropic"])
@pytest.mark.parametrize("steps", [{"step_s": 1e-3}, {"tolerance": 1e-8}], ids=["fixed", "controlled"])
def test_coulomb_a_stopped_parcel_reaches_the_wheels_at_v_over_mu_g_and_then_sticks_exactly(
    law: Coulomb, steps: dict[str, float]
) -> None:
    speed = 0.2
    plant = lawful(law, SMALL, **steps)
    reaches = speed / (MU * G)
    before, after = int((reaches - 2e-3) * SECOND), int((reaches + 2e-3) * SECOND)
    plant.advance(drive(plant, speed), before)
    assert plant.state[0, 3] == pytest.approx(MU * G * before * 1e-9, rel=1e-9)
    plant.advance(drive(plant, speed), after)
    assert plant.state[0, 3:].tolist() == [speed, 0.0, 0.0]
    plant.advance(drive(plant, speed), SECOND)
    assert plant.state[0, 3:].tolist() == [speed, 0.0, 0.0]


def test_coulomb_a_diagonal_drive_pulls_root_two_times_as_hard_with_independent_wheels() -> None:
    for law, expected in ((COULOMB, MU * G * np.sqrt(2.0)), (CONE, MU * G)):
        plant = lawful(law, SMALL)
        plant.advance(drive(plant, 1.0, 1.0), SECOND // 100)
        assert np.hypot(*plant.state[0, 3:5]) == pytest.approx(expected * 0.01, rel=1e-9)


def test_coulomb_brakes_each_axis_by_itself_only_with_independent_wheels() -> None:
    """A parcel that slides askew is braked along each axis alike by the box, against its motion by the cone."""
    body = parcel(position_m=(0.0, 0.0), angle_rad=0.0, velocity_m_s=(0.5, 0.4))
    ends = []
    for law in (COULOMB, CONE):
        plant = lawful(law, body)
        plant.advance(drive(plant, 0.0), SECOND // 20)
        ends.append(plant.state[0, 3:5])
    pull = MU * G * 0.05
    assert ends[0] == pytest.approx([0.5 - pull, 0.4 - pull], rel=1e-9)
    assert ends[1] == pytest.approx(np.array([0.5, 0.4]) * (1.0 - pull / np.hypot(0.5, 0.4)), rel=1e-7)


def _spun_disc(ratio: float) -> Floats:
    """``|U| / (R omega)`` of a disc on a stopped surface (isotropic, R/pitch 20), down to 1 % of its first speed."""
    pitch, radius, omega = 0.01, 0.2, 2.0
    angle = 2.0 * np.pi * np.arange(48) / 48
    corners = tuple((radius * float(np.cos(a)), radius * float(np.sin(a))) for a in angle)
    velocity = (ratio * radius * omega, 0.0)
    body = parcel(
        vertices_m=corners,
        position_m=(0.0, 0.0),
        angle_rad=0.0,
        velocity_m_s=velocity,
        angular_velocity_rad_s=omega,
    )
    plant = lawful(CONE, body, step_s=5e-4, rows=60, columns=70, pitch_m=pitch)
    still, seen = drive(plant, 0.0), []
    for tick in range(1, 1000):
        speed, turning = float(np.hypot(*plant.state[0, 3:5])), float(plant.state[0, 5])
        if speed < 0.01 * velocity[0]:
            break
        seen.append(speed / (radius * turning))
        plant.advance(still, tick * SECOND // 1000)
    plant.advance(still, 2 * SECOND)
    assert plant.state[0, 3:].tolist() == [0.0, 0.0, 0.0]
    return np.array(seen)


def test_coulomb_alone_a_disc_slides_and_spins_to_one_end_at_the_known_ratio() -> None:
    """Both motions end together, with ``|U| / (R omega)`` tending to 0.653; on this lattice 0.65."""
    slow, steady, fast = _spun_disc(0.45), _spun_disc(0.65), _spun_disc(0.9)
    assert steady == pytest.approx(0.65, abs=0.01)
    assert np.all(np.diff(slow[::5]) > 0.0)
    assert np.all(np.diff(fast[::5]) < 0.0)
    assert 0.58 < slow[-1] < 0.66
    assert 0.64 < fast[-1] < 0.70


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
    cells = plant._solver.under(0)
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


@pytest.mark.parametrize("name", ALL)
def test_kinetic_energy_never_rises_on_stopped_wheels(name: str) -> None:
    body = parcel(position_m=(0.1, 0.05), velocity_m_s=(0.6, -0.3), angular_velocity_rad_s=5.0)
    plant = lawful(ALL[name], body, step_s=2e-3)
    gyration = (0.54**2 + 0.32**2) / 12.0
    still, energy = drive(plant, 0.0), []
    for tick in range(500):
        state = plant.state[0]
        energy.append(0.5 * (state[3] ** 2 + state[4] ** 2 + gyration * state[5] ** 2))
        plant.advance(still, (tick + 1) * SECOND // 500)
    assert np.all(np.diff(energy) <= 0.0)
    assert energy[-1] < 0.5 * energy[0]


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("steps", [{"step_s": 0.05}, {"tolerance": 1e-8}], ids=["fixed", "controlled"])
def test_a_parcel_at_rest_does_not_creep_in_thirty_minutes(name: str, steps: dict[str, float]) -> None:
    plant = lawful(ALL[name], parcel(angle_rad=0.37), **steps)
    before = plant.state
    for minute in range(1, 31):
        _, events = plant.advance(drive(plant, 0.0), minute * 60 * SECOND)
        assert events == []
    assert np.array_equal(plant.state, before)


def test_a_parcel_that_has_come_to_stick_on_moving_wheels_does_not_creep_against_them() -> None:
    body = parcel(position_m=(-0.5, 0.0), angle_rad=0.3, angular_velocity_rad_s=1.0, velocity_m_s=(0.0, 0.1))
    plant = lawful(COULOMB, body, tolerance=1e-8)
    plant.advance(drive(plant, 0.01), SECOND)
    angle = plant.state[0, 2]
    assert plant.state[0, 3:].tolist() == [0.01, 0.0, 0.0]
    plant.advance(drive(plant, 0.01), 60 * SECOND)
    assert plant.state[0, 3:].tolist() == [0.01, 0.0, 0.0]
    assert plant.state[0, 2] == angle


def _settled(law: FrictionSpec, left: float, right: float, velocity: float = 0.0, x: float = 0.0) -> float:
    """Where a parcel is after 20 s between wheels that drive against each other."""
    body = parcel(size_m=(1.58, 0.38), position_m=(x, 0.0), angle_rad=0.0, velocity_m_s=(velocity, 0.0))
    plant = lawful(law, body, tolerance=1e-8)
    plant.advance(opposed(plant, left, right), 20 * SECOND)
    return float(plant.state[0, 0])


def test_between_opposed_wheels_the_equilibrium_moves_with_their_speeds_only_under_viscous_friction() -> None:
    soft = Viscous(coefficient_s_per_m=2.0)
    assert abs(_settled(soft, 0.05, 0.05)) < 1e-9
    assert _settled(soft, 0.06, 0.05) > 0.01
    assert abs(_settled(COULOMB, 0.05, 0.05)) < 1e-9
    assert abs(_settled(COULOMB, 0.06, 0.05)) < 1e-9


def test_without_slip_where_a_parcel_ends_between_opposed_wheels_depends_on_how_it_came() -> None:
    """Rolling forces balance anywhere on the same supports: ``m v0 / (n b)`` further on, n cells."""
    ends = [_settled(ROLLING, 0.05, 0.05, velocity) for velocity in (0.0, 0.05, -0.08)]
    cells = len(
        lawful(ROLLING, parcel(size_m=(1.58, 0.38), position_m=(0.0, 0.0), angle_rad=0.0))._solver.under(0)
    )
    assert ends == pytest.approx([0.0, 2.0 * 0.05 / (cells * B), -2.0 * 0.08 / (cells * B)], abs=1e-8)


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
    with pytest.raises(ValueError, match=r"solver\.name exact solves law viscous, not coulomb; use implicit"):
        PlantSpec.model_validate(base | {"friction": COULOMB})


def test_constants_of_motion_are_refused_for_other_laws_than_viscous() -> None:
    given = PlantSpec.model_validate(
        dict(spec(parcel())) | {"friction": COULOMB, "solver": {"name": "implicit"}}
    )
    with pytest.raises(
        PlantError, match=r'"coulomb": there are constants of motion .* for the law viscous only'
    ):
        constants_of_motion(given, 0, np.zeros((400, 2)))
