"""Static friction above the kinetic one: letting go at the exact force, sliding by the kinetic one, holding again."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.optimize import brentq

from plant.effects.motors import MotorsSpec
from plant.effects.parcel_contact.bodies import corner_pulls
from plant.friction.coulomb import Coulomb
from plant.kernels.common import layout
from plant.kernels.contact import layout as contact_layout
from plant.parcel_spec import ParcelSpec
from plant.plant import Plant
from tests.plant.laws import COULOMB, MU
from tests.plant.scenes import SECOND, TICK_NS, Floats, G, elliptic, parcel, solved

STATIC = 0.45
TAU = 0.1
CONTACTS = ["independent_wheels", "isotropic"]
STEPS: list[dict[str, object]] = [{"tolerance": 1e-9}, {"step_s": 1e-4}]
MILLI = SECOND // 1000
WIDE = parcel(size_m=(2.0, 2.0), position_m=(0.0, 0.0), angle_rad=0.0)


def held(
    *bodies: ParcelSpec,
    contact: str = "independent_wheels",
    static: float = STATIC,
    motors: bool = True,
    steps: dict[str, object] | None = None,
    **scene: object,
) -> Plant:
    """A plant of nine by nine cells under Coulomb's law with a static coefficient of its own."""
    law = Coulomb.model_validate(
        {"law": "coulomb", "coefficient": MU, "static_coefficient": static, "contact": contact}
    )
    size = {"rows": 9, "columns": 9} | scene
    wheels = MotorsSpec(time_constant_s=TAU, speed_per_volt_m_s=0.1, supply_v=1e6) if motors else None
    solver = {"name": "implicit"} | (steps or STEPS[0])
    return solved(solver, *(bodies or (WIDE,)), law=law, motors=wheels, **size)


def uniform(plant: Plant, vx: float, vy: float = 0.0) -> Floats:
    """The same command to all wheels."""
    return np.tile([vx, vy], (len(plant.array), 1))


def volts(acceleration: float) -> float:
    """Command at which motors at rest speed up so fast, m/s^2."""
    return acceleration * TAU / 0.1


def wheel(acceleration: float, time_s: float) -> float:
    """Speed of such a motor."""
    return acceleration * TAU * -np.expm1(-time_s / TAU)


@pytest.mark.slow
@pytest.mark.parametrize("contact", CONTACTS)
@pytest.mark.parametrize("steps", STEPS, ids=["controlled", "fixed"])
def test_wheels_carry_a_parcel_along_up_to_the_static_force_and_drag_it_by_the_kinetic_one_beyond(
    contact: str, steps: dict[str, object]
) -> None:
    """Motors speed up fastest at once: below ``mu_s g`` the parcel keeps up, above it is let go at once."""
    for acceleration in (STATIC * G * (1.0 - 1e-3), STATIC * G * (1.0 + 1e-2)):
        plant = held(contact=contact, steps=steps)
        drives = uniform(plant, volts(acceleration))
        sticks = acceleration < STATIC * G
        plant.advance(drives, 40 * MILLI)
        speed = wheel(acceleration, 0.04) if sticks else MU * G * 0.04
        assert plant.state[0, 3] == pytest.approx(speed, abs=1e-13)
        # the wheels slow down their pick-up: the parcel catches up, and keeps up
        plant.advance(drives, 300 * MILLI)
        assert plant.state[0, 3] == pytest.approx(wheel(acceleration, 0.3), abs=1e-13)
        assert plant.state[0, [4, 5]].tolist() == [0.0, 0.0]
        way = TAU * (acceleration * 0.3 - wheel(acceleration, 0.3))
        if not sticks:
            caught = brentq(lambda t: wheel(acceleration, t) - MU * G * t, 0.02, 0.3, xtol=1e-15)  # noqa: B023
            way -= TAU * (acceleration * caught - wheel(acceleration, caught)) - 0.5 * MU * G * caught**2
        bound = 1e-8 if "tolerance" in steps else 2e-4
        assert plant.state[0, 0] == pytest.approx(way, abs=bound)


@pytest.mark.slow
@pytest.mark.parametrize("static", [MU, STATIC])
@pytest.mark.parametrize("contact", CONTACTS)
def test_slips_that_all_end_at_once_end_on_time(contact: str, static: float) -> None:
    """Motors that slow down as they pick up: the parcel slides until it is as fast as all wheels are."""
    acceleration = 1.3 * static * G
    plant = held(contact=contact, static=static)
    caught = brentq(lambda t: wheel(acceleration, t) - MU * G * t, 0.02, 0.5, xtol=1e-15)
    plant.advance(uniform(plant, volts(acceleration)), round((caught + 0.01) * SECOND))
    end = plant.time_ns / SECOND

    def way(time_s: float) -> float:
        return TAU * (acceleration * time_s - wheel(acceleration, time_s))

    assert plant.state[0, 3] == pytest.approx(wheel(acceleration, end), abs=1e-13)
    assert plant.state[0, 0] == pytest.approx(0.5 * MU * G * caught**2 + way(end) - way(caught), abs=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("static", [STATIC, 0.8])
@pytest.mark.parametrize("contact", CONTACTS)
def test_a_parcel_whose_slip_ends_is_held_by_what_only_static_friction_can_give(
    contact: str, static: float
) -> None:
    """The wheels speed up, then stop: where they meet the parcel they slow down faster than it could slide."""
    cut, command, past = 0.15, volts(1.2 / TAU), 0.005
    plant = held(contact=contact, static=static)
    plant.advance(uniform(plant, command), round(cut * SECOND))
    assert plant.state[0, 3] == pytest.approx(MU * G * cut, abs=1e-12)
    first = wheel(1.2 / TAU, cut)
    meets = brentq(lambda s: first * np.exp(-s / TAU) - MU * G * (cut + s), 0.0, 0.1, xtol=1e-15)
    needed = first * np.exp(-meets / TAU) / TAU
    assert MU * G < STATIC * G < needed < 0.8 * G < 1.2 / TAU
    plant.advance(uniform(plant, 0.0), round((cut + meets + past) * SECOND))
    if needed < static * G:
        known = first * np.exp(-(meets + past) / TAU)
    else:
        known = MU * G * (cut + meets - past)
    assert plant.state[0, 3] == pytest.approx(known, abs=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.99, 1.01], ids=["let go", "held"])
def test_wheels_that_stand_hold_a_parcel_against_others_that_slip_up_to_their_static_force(
    ratio: float,
) -> None:
    """Fifteen of 25 equal loads slip and pull, ten stand: they hold as long as ``10 mu_s > 15 mu_k``."""
    body = parcel(size_m=(0.5, 0.5), position_m=(0.0, 0.0), angle_rad=0.0)
    plant = held(body, static=1.5 * MU * ratio, motors=False, rows=5, columns=5)
    drives = uniform(plant, 0.0)
    pulling = np.abs(plant.array.positions_m[:, 1]) < 0.15
    assert int(pulling.sum()) == 15
    drives[pulling, 0] = 5.0
    plant.advance(drives, 20 * MILLI)
    if ratio > 1.0:
        assert np.abs(plant.state).max() == 0.0
    else:
        assert plant.state[0, 3] == pytest.approx(MU * G * (15 - 10) / 25 * 0.02, abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.99, 1.01], ids=["held", "let go"])
def test_turning_wheels_carry_a_parcel_round_up_to_the_static_torque(ratio: float) -> None:
    """Each wheel up to its own limit at its own lever: ``I omega' = mu (W / n) sum (|x| + |y|)``."""
    plant = held()
    cells = plant.array.positions_m
    lever = WIDE.mass_kg * G * float(np.mean(np.abs(cells).sum(axis=1))) / WIDE.moment_of_inertia_kg_m2()
    acceleration = ratio * STATIC * lever
    drives = volts(acceleration) * np.stack([-cells[:, 1], cells[:, 0]], axis=1)
    plant.advance(drives, 30 * MILLI)
    known = wheel(acceleration, 0.03) if ratio < 1.0 else MU * lever * 0.03
    assert plant.state[0, 5] == pytest.approx(known, abs=1e-9)
    assert np.abs(plant.state[0, [0, 1, 3, 4]]).max() < 1e-12


@pytest.mark.slow
def test_errors_of_fixed_steps_fall_with_them_through_letting_go_and_holding() -> None:
    fine = held()
    drives = uniform(fine, volts(1.05 * STATIC * G))
    fine.advance(drives, 200 * MILLI)
    off = []
    for step_s in (4e-3, 2e-3, 1e-3, 5e-4):
        plant = held(steps={"step_s": step_s})
        plant.advance(drives, 200 * MILLI)
        off.append(abs(plant.state[0, 0] - fine.state[0, 0]))
    assert np.polyfit(np.log([4e-3, 2e-3, 1e-3, 5e-4]), np.log(off), 1)[0] == pytest.approx(1.0, abs=0.15)


@pytest.mark.slow
def test_a_parcel_slides_as_under_one_coefficient_and_does_not_creep_where_it_stopped() -> None:
    body = WIDE.model_copy(update={"velocity_m_s": (0.5, 0.0)})
    plain = solved({"name": "implicit", "tolerance": 1e-9}, body, law=COULOMB, rows=9, columns=9)
    plant = held(body, motors=False)
    for each in (plain, plant):
        each.advance(uniform(each, 0.0), 100 * MILLI)
    assert plant.state[0] == pytest.approx(plain.state[0], abs=1e-12)
    plant.advance(uniform(plant, 0.0), SECOND)
    stopped = plant.state
    assert stopped[0, 3:].tolist() == [0.0, 0.0, 0.0]
    assert stopped[0, 0] == pytest.approx(0.5 * 0.25 / (MU * G), abs=1e-8)
    for minute in range(1, 6):
        plant.advance(uniform(plant, 0.0), 60 * minute * SECOND)
    assert np.array_equal(plant.state, stopped)


@pytest.mark.slow
@pytest.mark.parametrize("steps", STEPS, ids=["controlled", "fixed"])
def test_a_solver_that_goes_back_remembers_which_wheels_held(steps: dict[str, object]) -> None:
    body = parcel(size_m=(0.46, 0.34), position_m=(-0.1, 0.02), angle_rad=0.3, angular_velocity_rad_s=1.0)
    plant = held(body, static=2.0 * MU, motors=False, steps=steps)
    turning = plant.array.positions_m @ np.array([[0.0, 0.5], [-0.5, 0.0]])

    def on(count: int) -> bytes:
        for _ in range(count):
            plant.advance(turning, plant.time_ns + TICK_NS)
        return plant.state.tobytes()

    on(2)
    snapshot = plant._solver.snapshot(np.array([0]))
    # where steps end when a wheel lets go, the law's branches say which hold; elsewhere grips do
    if "step_s" in steps:
        holds = plant._solver._stiction.grips[:, :, 1:]  # type: ignore[attr-defined]
    else:
        holds = plant._solver.packed.mem[:, layout.BRANCH : layout.BRANCH + 2]  # type: ignore[attr-defined]
    kept = holds.copy()
    assert set(kept.ravel().tolist()) == {-1, 0, 1}
    first = on(20)
    assert not np.array_equal(holds, kept)
    plant._solver.restore(snapshot)
    assert np.array_equal(holds, kept)
    assert on(20) == first


@pytest.mark.slow
def test_steps_end_where_wheels_let_go_instead_of_shrinking() -> None:
    """Wheels that pull against each other, some forty that stick or slip in turn."""
    body = parcel(velocity_m_s=(0.1, -0.05), angular_velocity_rad_s=0.5)
    ends: list[Floats] = []
    for tolerance in (1e-6, 1e-8):
        plant = held(body, motors=False, steps={"tolerance": tolerance}, rows=20, columns=20)
        plant.advance(elliptic(plant), SECOND // 2)
        assert plant.effort < 1000
        ends.append(plant.state[0])
    assert ends[0] == pytest.approx(ends[1], abs=1e-6)


def test_a_static_coefficient_is_at_least_the_kinetic_one() -> None:
    with pytest.raises(
        ValidationError, match=r"static_coefficient = 0\.2 must be at least coefficient = 0\.3"
    ):
        held(static=0.2)


@pytest.mark.parametrize("name", ["fixed_step", "quasi_static"])
def test_solvers_that_don_t_know_which_wheels_stick_are_refused(name: str) -> None:
    law = Coulomb(law="coulomb", coefficient=MU, static_coefficient=STATIC)
    rule = rf"solver\.name {name} leaves out friction\.static_coefficient; use implicit"
    with pytest.raises(ValidationError, match=rule):
        solved({"name": name}, law=law)


def test_what_bounds_the_motion_between_contacts_is_the_static_force() -> None:
    one = np.array([2.0])
    static = Coulomb(law="coulomb", coefficient=MU, static_coefficient=STATIC).traction()
    bounds = [corner_pulls(law, one, one, one, one, G)[0] for law in (COULOMB.traction(), static)]
    assert bounds[1][contact_layout.LIMIT] == pytest.approx(bounds[0][contact_layout.LIMIT] * STATIC / MU)
