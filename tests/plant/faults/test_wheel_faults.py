"""Wheels that are jammed, weak, reversed or run away: parcels on them, and the wheels themselves, in closed form."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from plant.effects.motors import Motors, MotorsSpec
from plant.faults.base import PlantFault, WheelFaults
from plant.faults.faulty_wheels import FaultyWheels
from plant.faults.kinds.wheel_reversed import WheelReversedFault
from plant.faults.kinds.wheel_runaway import WheelRunawayFault
from plant.faults.kinds.wheel_stuck import WheelStuckFault
from plant.faults.kinds.wheel_weak import WheelWeakFault
from plant.plant import Plant
from plant.wheels import Floats, IdealWheels
from tests.plant.scenes import MU, SECOND, TICK_NS, G, cells_of, parcel, solved

KAPPA = MU * G
HALF = 0.05
"""From the middle of four cells to their columns, m."""
DRIVEN = 0.02
"""Speed of the wheels along x, m/s."""

STUCK = WheelStuckFault.model_validate({"kind": "wheel_stuck", "cell": (0, 0)})
WEAK = WheelWeakFault.model_validate({"kind": "wheel_weak", "cell": (0, 0), "strength": 0.4})
SLOW = WheelWeakFault.model_validate({"kind": "wheel_weak", "cell": (0, 0), "most_m_s": 0.005})
REVERSED = WheelReversedFault.model_validate({"kind": "wheel_reversed", "cell": (0, 0)})
RUNAWAY = WheelRunawayFault.model_validate(
    {"kind": "wheel_runaway", "cell": (0, 0), "way": "negative", "speed_m_s": 0.03}
)

SOLVERS: dict[str, tuple[dict[str, object], float]] = {
    "exact": ({"name": "exact"}, 1e-10),
    "implicit": ({"name": "implicit", "tolerance": 1e-9}, 1e-7),
    "rk4": ({"name": "fixed_step", "step_s": 1e-3}, 1e-9),
    "scipy": ({"name": "scipy", "method": "RK45", "tolerance": 1e-11}, 1e-9),
    "heyoka": ({"name": "heyoka", "tolerance": 1e-12}, 1e-10),
}
"""With how far a place may be off, m."""


def faulty(cells: int, *faults: tuple[PlantFault, list[int]]) -> WheelFaults:
    """Effects of faults that affect some of so many cells."""
    wheel_faults = WheelFaults.healthy(cells)
    for fault, affected in faults:
        fault.apply(np.array(affected), wheel_faults)
    return wheel_faults


def on_four(solver: dict[str, object]) -> Plant:
    """A parcel over four cells, all of which carry it wherever it comes."""
    return solved(
        solver, parcel(size_m=(0.16, 0.16), position_m=(0.01, 0.0), angle_rad=0.0), rows=2, columns=2
    )


def followed(start: float, left: float, right: float, span_s: float) -> float:
    """Where a parcel is that begins at rest at ``start`` on wheels of two speeds, its weight shared by where it is.

    ``x'' + kappa x' + kappa (left - right) / (2 HALF) x = kappa (left + right) / 2``: the left wheels carry
    ``(1 - x / HALF) / 2`` of it, the right ones the rest.
    """
    stiffness, push = (left - right) / (2.0 * HALF), 0.5 * (left + right)
    rest = push / stiffness
    slow, fast = np.roots([1.0, KAPPA, KAPPA * stiffness])
    swing = (fast * np.exp(slow * span_s) - slow * np.exp(fast * span_s)) / (fast - slow)
    return rest + (start - rest) * float(np.real(swing))


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize(
    ("fault", "speed"),
    [(STUCK, 0.0), (WEAK, 0.4 * DRIVEN), (SLOW, 0.005), (REVERSED, -DRIVEN), (RUNAWAY, -0.03)],
    ids=lambda value: value.kind_name if isinstance(value, PlantFault) else "",
)
def test_a_parcel_on_faulty_wheels_follows_the_closed_form(
    fault: PlantFault, speed: float, solver: str
) -> None:
    if solver == "heyoka":
        pytest.importorskip("heyoka")
    settings, off_m = SOLVERS[solver]
    plant = on_four(settings)
    drives = np.zeros((4, 2))
    drives[:, 0] = DRIVEN
    right = cells_of(plant, [(0, 1), (1, 1)])
    wheel_faults = faulty(4, (fault, right))
    wheel_faults.runs_m_s[:, 1] = np.nan  # only along x
    plant.apply_faults(wheel_faults, np.zeros((4, 2)))
    plant.advance(drives, SECOND // 2)
    assert plant.state[0, 0] == pytest.approx(followed(0.01, DRIVEN, speed, 0.5), abs=off_m)
    assert plant.state[0, 1:3] == pytest.approx((0.0, 0.0), abs=1e-9)
    assert plant.wheel_speed[right, 0] == pytest.approx(speed)
    assert np.all(plant.wheel_speed[cells_of(plant, [(0, 0), (1, 0)]), 0] == DRIVEN)


def test_one_wheel_of_a_cell_may_be_faulty_alone() -> None:
    along_y = STUCK.model_copy(update={"wheel": "y"})
    plant = on_four({"name": "exact"})
    plant.apply_faults(faulty(4, (along_y, [1, 2])), np.zeros((4, 2)))
    plant.advance(np.full((4, 2), DRIVEN), TICK_NS)
    assert np.all(plant.wheel_speed[:, 0] == DRIVEN)
    assert plant.wheel_speed[:, 1].tolist() == [DRIVEN, 0.0, 0.0, DRIVEN]


def test_what_is_repaired_moves_as_if_nothing_had_been() -> None:
    plain, faulty_once = on_four({"name": "exact"}), on_four({"name": "exact"})
    still = np.zeros((4, 2))
    for fault in (STUCK, WEAK, REVERSED, RUNAWAY):
        faulty_once.apply_faults(faulty(4, (fault, [0, 3])), still)
    faulty_once.apply_faults(WheelFaults.healthy(4), still)
    drives = np.random.default_rng(3).normal(scale=0.02, size=(4, 2))
    for plant in (plain, faulty_once):
        plant.advance(drives, SECOND // 4)
    assert np.array_equal(plain.state, faulty_once.state)
    assert np.array_equal(plain.wheel_speed, faulty_once.wheel_speed)


def test_faults_of_one_wheel_add_up() -> None:
    wheel_faults = faulty(2, (WEAK, [0]), (REVERSED, [0]), (WEAK, [0]), (RUNAWAY, [1]), (SLOW, [1]))
    wheels = FaultyWheels(IdealWheels(2), None, 2)
    wheels.apply_faults(wheel_faults, np.full((2, 2), 1.0))
    assert wheels.speed == pytest.approx(np.array([[-0.16, -0.16], [-0.005, -0.005]]))


def test_a_jammed_wheel_of_a_cell_that_coasts_rubs_all_the_same() -> None:
    ends: list[Floats] = []
    for policy in ("coast", "brake"):
        plant = on_four({"name": "exact"})
        plant.release_wheels([1, 3], policy)  # type: ignore[arg-type]
        plant.apply_faults(faulty(4, (STUCK, [1, 3])), np.zeros((4, 2)))
        plant.advance(np.array([[DRIVEN, 0.0], [0.0, 0.0]] * 2), SECOND // 4)
        ends.append(plant.state)
    assert np.array_equal(ends[0], ends[1])
    freed = on_four({"name": "exact"})
    freed.release_wheels([1, 3], "coast")
    freed.advance(np.array([[DRIVEN, 0.0], [0.0, 0.0]] * 2), SECOND // 4)
    assert not np.array_equal(ends[0], freed.state)


# --- the wheels themselves ------------------------------------------------------------------------------------

TAU = 0.06
MOTORS = MotorsSpec(time_constant_s=TAU, speed_per_volt_m_s=0.1, coulomb_v=0.5, static_v=1.0, supply_v=12.0)


def wheels_of(*faults: tuple[PlantFault, list[int]], cells: int = 1) -> FaultyWheels:
    wheels = FaultyWheels(Motors(MOTORS, cells), MOTORS, cells)
    wheels.apply_faults(faulty(cells, *faults), np.zeros((cells, 2)))
    return wheels


def turned(wheels: FaultyWheels, volts: float, span_s: float, **at: Any) -> float:
    """Speed of the first wheel after a span of driving all with some volts."""
    drives = np.full((len(wheels.speed), 2), volts)
    wheels.elapse(wheels.command(drives, span_s, **at), span_s)
    return float(wheels.speed[0, 0])


@pytest.mark.parametrize(
    ("fault", "volts"),
    [
        (WEAK, 0.4 * 6.0),
        (WEAK.model_copy(update={"strength": None, "most_m_s": 0.2}), 2.5),
        (REVERSED, -6.0),
        (RUNAWAY.model_copy(update={"speed_m_s": None}), -12.0),
    ],
    ids=["weak", "slow", "reversed", "runaway"],
)
def test_a_motor_answers_to_what_reaches_it(fault: PlantFault, volts: float) -> None:
    wheels = wheels_of((fault, [0]))
    steady = 0.1 * (volts - np.sign(volts) * 0.5)
    assert turned(wheels, 6.0, 0.1) == pytest.approx(-steady * np.expm1(-0.1 / TAU), rel=1e-13)
    travel = steady * (0.1 + TAU * np.expm1(-0.1 / TAU))
    assert wheels.travel is not None
    assert wheels.travel[0, 0] == pytest.approx(travel, rel=1e-12)


def test_a_weak_motor_is_weak_below_its_saturation() -> None:
    assert turned(wheels_of((WEAK, [0])), 24.0, 10.0) == pytest.approx(0.1 * (0.4 * 12.0 - 0.5), rel=1e-13)


def test_a_motor_that_jams_stands_at_once_and_starts_from_rest() -> None:
    wheels = wheels_of()
    before = turned(wheels, 6.0, 0.1)
    wheels.apply_faults(faulty(1, (STUCK, [0])), np.full((1, 2), 6.0))
    assert wheels.travel is not None
    passed = wheels.travel.copy()
    assert wheels.speed.tolist() == [[0.0, 0.0]]
    # however it is driven, turned round on the way included
    for volts in (6.0, -12.0, 0.0):
        assert turned(wheels, volts, 0.05, acts_s=np.array([0.02])) == 0.0
    assert np.array_equal(wheels.travel, passed)
    wheels.apply_faults(WheelFaults.healthy(1), np.zeros((1, 2)))
    assert turned(wheels, 6.0, 0.1) == before
    assert turned(wheels_of(), 6.0, 0.1) == before


def test_a_fault_acts_at_once_on_a_drive_that_stands_until_the_next_takes_effect() -> None:
    for wheels in (FaultyWheels(IdealWheels(2), None, 2), wheels_of(cells=2)):
        stood, new, acts_s = np.full((2, 2), 4.0), np.full((2, 2), 7.0), np.array([0.01, 0.01])
        wheels.elapse(wheels.command(stood, 10.0), 10.0)
        plain = wheels.speed[0, 0]
        wheels.apply_faults(faulty(2, (REVERSED, [1])), stood)
        run = wheels.command(new, 0.02, acts_s)
        begun, late = run.motion.steady + run.motion.decay, run.motion.steady
        assert begun[0, 0] == pytest.approx(plain)
        assert np.all(late[1] < 0.0)
        assert np.all(late[0] > 0.0)
        assert run.changes is not None
        assert run.changes.after_s[0, :, 0].tolist() == [0.01, 0.01]
        assert np.all(run.changes.steady[0, 1] < late[1])
