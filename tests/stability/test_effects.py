"""Effects on traction and loads, put to the solvers that simulate them: closed forms, rest, energy, extremes."""

from __future__ import annotations

from math import expm1

import numpy as np
import pytest

from plant.parcel_spec import ParcelSpec
from plant.plant import Plant
from tests.plant.laws import LAWS, MU, STATIC_LAWS
from tests.plant.scenes import SECOND, TICK_NS, Floats, G, elliptic, parcel
from tests.stability.solvers import Claim, Solver, claiming

pytestmark = pytest.mark.slow  # kernels of effects are compiled

MILLI = SECOND // 1_000
EVERY_LAW = ["viscous", "coulomb", "cone", "rolling", "stick_slip"]
DRAG = 0.05
DRAGGED = {"roller_drag": {"drag_s_per_m": DRAG}}


def _over_all(**values: object) -> ParcelSpec:
    """A parcel over all of nine by nine cells for ever."""
    return parcel(**({"size_m": (2.0, 2.0), "position_m": (0.0, 0.0), "angle_rad": 0.0} | values))


def _uniform(plant: Plant, vx: float, vy: float = 0.0) -> Floats:
    return np.tile([vx, vy], (len(plant.array), 1))


def _energy(plant: Plant, body: ParcelSpec) -> float:
    """Of the parcel's motion, J."""
    vx, vy, omega = plant.state[0, 3:]
    inertia = body.moment_of_inertia_kg_m2()
    return float(0.5 * body.mass_kg * (vx * vx + vy * vy) + 0.5 * inertia * omega * omega)


# --- roller_drag --------------------------------------------------------------------------------------------------


@claiming(Claim.MOTION, effect="roller_drag")
def test_dragged_rollers_leave_a_parcel_its_share_of_the_wheels_speed(solver: Solver) -> None:
    """``dU/dt = mu g (V - U) - d g U``."""
    plant = solver.plant(_over_all(), rows=9, columns=9, effects=DRAGGED)
    plant.advance(_uniform(plant, 0.2), SECOND // 2)
    total = 0.2 + DRAG
    known = 0.2 * 0.2 / total * -expm1(-total * G * 0.5)
    assert plant.state[0, 3] == pytest.approx(known, abs=solver.within(1e-12))


@claiming(Claim.ORDER, effect="roller_drag")
def test_errors_of_a_dragged_parcel_fall_with_the_steps(solver: Solver) -> None:
    total = 0.2 + DRAG
    known = 0.2 * 0.2 / total * -expm1(-total * G * 0.5)
    off = []
    for step_s in (0.05, 0.025, 0.0125):
        plant = solver.plant(_over_all(), rows=9, columns=9, effects=DRAGGED, solver={"step_s": step_s})
        plant.advance(_uniform(plant, 0.2), SECOND // 2)
        off.append(abs(plant.state[0, 3] - known))
    assert np.all(np.log2(np.array(off[:-1]) / off[1:]) > 0.9)


@claiming(Claim.REST, laws=EVERY_LAW, effect="roller_drag")
def test_a_parcel_at_rest_on_dragged_rollers_stays_at_rest(solver: Solver, law: str) -> None:
    plant = solver.plant(parcel(angle_rad=0.37), law=LAWS[law], effects=DRAGGED)
    before = plant.state
    for tick in range(1, 50):
        _, events = plant.advance(np.zeros((400, 2)), tick * TICK_NS)
        assert events == []
    assert np.array_equal(plant.state, before)


@claiming(Claim.ENERGY, laws=EVERY_LAW, effect="roller_drag")
def test_steps_of_any_length_gain_no_energy_from_rollers_however_stiff(solver: Solver, law: str) -> None:
    body = parcel(velocity_m_s=(0.3, 0.1), angular_velocity_rad_s=2.0)
    plant = solver.plant(
        body, law=LAWS[law], effects={"roller_drag": {"drag_s_per_m": 1e6}}, solver={"step_s": 0.5}
    )
    before = _energy(plant, body)
    for tick in range(1, 6):
        plant.advance(np.zeros((400, 2)), tick * SECOND // 20)
        after = _energy(plant, body)
        assert after <= before
        before = after


@claiming(Claim.STIFFNESS, effect="roller_drag")
@pytest.mark.parametrize("drag", [1e-9, 1e6])
def test_drag_of_any_size_is_followed(solver: Solver, drag: float) -> None:
    plant = solver.plant(
        _over_all(), rows=9, columns=9, effects={"roller_drag": {"drag_s_per_m": drag}}, solver={}
    )
    plant.advance(_uniform(plant, 0.2), SECOND)
    total = 0.2 + drag
    known = 0.2 * 0.2 / total * -expm1(-total * G)
    # a constant step is of first order
    bound = solver.within(1e-9) if solver.claims(Claim.MOTION) else 0.02 * known
    assert plant.state[0, 3] == pytest.approx(known, abs=bound)


@claiming(Claim.SYMMETRY, laws=EVERY_LAW, effect="roller_drag")
def test_a_quarter_turn_of_a_dragged_scene_turns_its_motion(solver: Solver, law: str) -> None:
    ends = []
    for turn in (0.0, 0.5 * np.pi):
        c, s = round(np.cos(turn)), round(np.sin(turn))
        quarter = np.array([[c, s], [-s, c]])
        place = np.array([0.12, 0.07]) @ quarter
        body = parcel(position_m=tuple(place.tolist()), angle_rad=0.4 + turn)
        plant = solver.plant(body, law=LAWS[law], effects=DRAGGED)
        wheels = elliptic(plant) if turn == 0.0 else elliptic(plant, -2.0, -1.0)
        plant.advance(wheels, 300 * MILLI)
        state = plant.state[0]
        ends.append([*(quarter @ state[:2]), state[2] - turn, *(quarter @ state[3:5]), state[5]])
    assert ends[1] == pytest.approx(ends[0], abs=solver.within(1e-11))


@claiming(Claim.STICKING, laws=["coulomb", "cone"], effect="roller_drag")
def test_wheels_that_overcome_the_drag_carry_a_parcel_at_their_speed_to_the_bit(
    solver: Solver, law: str
) -> None:
    """Below ``mu / d`` it sticks."""
    plant = solver.plant(_over_all(), law=LAWS[law], rows=9, columns=9, effects=DRAGGED)
    assert MU / DRAG > 0.2
    plant.advance(_uniform(plant, 0.2), SECOND // 2)
    assert plant.state[0, 3:].tolist() == [0.2, 0.0, 0.0]


# --- static friction ----------------------------------------------------------------------------------------------

STATIC = ["static", "static_cone"]


@claiming(Claim.REST, laws=STATIC)
def test_a_parcel_at_rest_on_wheels_that_hold_stays_at_rest(solver: Solver, law: str) -> None:
    plant = solver.plant(parcel(angle_rad=0.37), law=STATIC_LAWS[law])
    before = plant.state
    for tick in range(1, 50):
        _, events = plant.advance(np.zeros((400, 2)), tick * TICK_NS)
        assert events == []
    assert np.array_equal(plant.state, before)


@claiming(Claim.ENERGY, laws=STATIC)
@pytest.mark.parametrize("step_s", [1e-3, 0.05])
def test_wheels_that_hold_more_than_they_drag_give_no_energy(solver: Solver, law: str, step_s: float) -> None:
    body = parcel(velocity_m_s=(0.3, 0.1), angular_velocity_rad_s=5.0)
    plant = solver.plant(body, law=STATIC_LAWS[law], solver={"step_s": step_s})
    before = _energy(plant, body)
    for tick in range(1, 11):
        plant.advance(np.zeros((400, 2)), tick * SECOND // 20)
        after = _energy(plant, body)
        assert after <= before
        before = after
    assert after == 0.0


@claiming(Claim.STICKING, Claim.PACE, laws=STATIC)
def test_what_static_friction_alone_holds_does_not_creep_in_half_an_hour(solver: Solver, law: str) -> None:
    """Fourteen of 25 equal loads slip and pull by 14 * 0.3; eleven stand, and hold 11 * 0.45 but drag by 11 * 0.3."""
    body = parcel(size_m=(0.5, 0.5), position_m=(0.0, 0.0), angle_rad=0.0)
    plant = solver.plant(body, law=STATIC_LAWS[law], rows=5, columns=5)
    drives = np.zeros((25, 2))
    x, y = plant.array.positions_m.T
    pulling = (np.abs(y) < 0.15) & ~((np.abs(x) < 0.05) & (np.abs(y) < 0.05))
    assert int(pulling.sum()) == 14
    drives[pulling, 0] = 0.5
    before = plant.state
    for minute in range(1, 31):
        plant.advance(drives, 60 * minute * SECOND)
    assert np.array_equal(plant.state, before)


@claiming(Claim.SYMMETRY, laws=STATIC)
def test_a_quarter_turn_of_wheels_that_hold_turns_the_motion(solver: Solver, law: str) -> None:
    ends = []
    for turn in (0.0, 0.5 * np.pi):
        c, s = round(np.cos(turn)), round(np.sin(turn))
        quarter = np.array([[c, s], [-s, c]])
        body = parcel(position_m=tuple((np.array([0.12, 0.07]) @ quarter).tolist()), angle_rad=0.4 + turn)
        plant = solver.plant(body, law=STATIC_LAWS[law])
        plant.advance(elliptic(plant) if turn == 0.0 else elliptic(plant, -2.0, -1.0), 50 * MILLI)
        state = plant.state[0]
        ends.append([*(quarter @ state[:2]), state[2] - turn, *(quarter @ state[3:5]), state[5]])
    assert ends[1] == pytest.approx(ends[0], abs=solver.within(1e-9))


# --- uneven_friction ----------------------------------------------------------------------------------------------

UNEQUAL = {"uneven_friction": {"cell_spread": 0.5, "wheel_spread": 0.3}}
BY_WHEEL = ["viscous", "coulomb", "stick_slip"]


@claiming(Claim.REST, laws=BY_WHEEL, effect="uneven_friction")
def test_a_parcel_at_rest_on_unequal_wheels_stays_at_rest(solver: Solver, law: str) -> None:
    plant = solver.plant(parcel(angle_rad=0.37), law=LAWS[law], effects=UNEQUAL)
    before = plant.state
    for tick in range(1, 50):
        _, events = plant.advance(np.zeros((400, 2)), tick * TICK_NS)
        assert events == []
    assert np.array_equal(plant.state, before)


@claiming(Claim.ENERGY, laws=BY_WHEEL, effect="uneven_friction")
def test_unequal_wheels_that_stand_give_no_energy(solver: Solver, law: str) -> None:
    body = parcel(velocity_m_s=(0.3, 0.1), angular_velocity_rad_s=5.0)
    plant = solver.plant(body, law=LAWS[law], effects=UNEQUAL, solver={"step_s": 0.05})
    before = _energy(plant, body)
    for tick in range(1, 11):
        plant.advance(np.zeros((400, 2)), tick * SECOND // 20)
        after = _energy(plant, body)
        assert after <= before
        before = after


@claiming(Claim.MOTION, Claim.STICKING, effect="uneven_friction")
def test_a_parcel_brakes_along_each_axis_by_the_friction_of_that_axis_and_stops(solver: Solver) -> None:
    cells = [{"cell": (r, c), "factors": (0.5, 2.0)} for r in range(9) for c in range(9)]
    body = _over_all(velocity_m_s=(0.1, 0.4))
    effects = {"uneven_friction": {"cells": cells}}
    plant = solver.plant(body, law=LAWS["coulomb"], rows=9, columns=9, effects=effects)
    plant.advance(_uniform(plant, 0.0), 50 * MILLI)
    known = np.array([0.1, 0.4]) - MU * G * 0.05 * np.array([0.5, 2.0])
    assert plant.state[0, 3:5] == pytest.approx(known, abs=solver.within(1e-12))
    plant.advance(_uniform(plant, 0.0), SECOND)
    assert plant.state[0, 3:].tolist() == [0.0, 0.0, 0.0]


# --- load_transfer ------------------------------------------------------------------------------------------------

TALL = {"load_transfer": {"centre_of_mass_height_m": 0.05}}


@claiming(Claim.REST, laws=EVERY_LAW, effect="load_transfer")
def test_a_tall_parcel_at_rest_stays_at_rest(solver: Solver, law: str) -> None:
    plant = solver.plant(parcel(angle_rad=0.37), law=LAWS[law], effects=TALL)
    before = plant.state
    for tick in range(1, 50):
        _, events = plant.advance(np.zeros((400, 2)), tick * TICK_NS)
        assert events == []
    assert np.array_equal(plant.state, before)


@claiming(Claim.ENERGY, laws=EVERY_LAW, effect="load_transfer")
def test_stopped_wheels_take_energy_from_a_tall_parcel_and_give_none(solver: Solver, law: str) -> None:
    body = parcel(velocity_m_s=(0.3, 0.1), angular_velocity_rad_s=2.0)
    plant = solver.plant(body, law=LAWS[law], effects=TALL, solver={"step_s": 0.01})
    before = _energy(plant, body)
    for tick in range(1, 11):
        plant.advance(np.zeros((400, 2)), tick * SECOND // 50)
        after = _energy(plant, body)
        assert after <= before
        before = after


@claiming(Claim.LOADS, effect="load_transfer")
def test_traction_tips_a_tall_parcel_before_its_centre_of_mass_has_left_its_supports(solver: Solver) -> None:
    """``X + mu H`` leaves them first: viscous wheels that stand brake by ``mu U`` at the speed U."""
    hole = [(r, c) for r in range(9) for c in range(6, 9)]
    body = parcel(size_m=(0.5, 0.5), position_m=(0.0, 0.0), angle_rad=0.0, velocity_m_s=(1.2, 0.0))
    effects = {"load_transfer": {"centre_of_mass_height_m": 0.2}}
    plant = solver.plant(body, rows=9, columns=9, missing=hole, effects=effects, solver={})
    plant.advance(_uniform(plant, 0.0), SECOND)
    assert plant.status[0].state in ("tipped", "off_array")
    # U = U0 - mu g X, so X + mu H U = 0.1 at
    place = (0.1 - 0.2 * 0.2 * 1.2) / (1.0 - 0.2 * 0.2 * 0.2 * G)
    # steps of one length look once a step
    bound = solver.within(1e-6) if solver.claims(Claim.MOTION) else 1.2 * 1e-2
    assert plant.state[0, 0] == pytest.approx(place, abs=bound)
