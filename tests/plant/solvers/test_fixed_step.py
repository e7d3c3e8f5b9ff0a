"""Explicit steps: of what order they are, with and without support changes, and where they fail."""

from __future__ import annotations

import numpy as np
import pytest

from plant.plant import Plant
from tests.plant.laws import COULOMB, MU, SLIDING, STICK_SLIP
from tests.plant.scenes import SECOND, G, elliptic, parcel, solved, study
from tests.plant.test_laws import SMALL, drive


def stepped(method: str, step_s: float, **values: object) -> Plant:
    solver: dict[str, object] = {"name": "fixed_step", "method": method, "step_s": step_s}
    return solved(solver, **values)


def errors(method: str, steps: list[float], until_ns: int) -> tuple[list[float], int]:
    """Largest entry of the difference from the exact state, and how often supports changed on the way."""
    exact, off = study(), []
    exact.advance(elliptic(exact), until_ns)
    for step in steps:
        plant = stepped(method, step)
        plant.advance(elliptic(plant), until_ns)
        off.append(float(np.abs(plant.state - exact.state).max()))
    return off, exact.support_changes


def slope(steps: list[float], off: list[float]) -> float:
    return float(np.polyfit(np.log(steps), np.log(off), 1)[0])


@pytest.mark.parametrize(("method", "order"), [("euler", 1.0), ("rk4", 4.0)])
def test_between_support_changes_a_method_is_of_its_own_order(method: str, order: float) -> None:
    steps = [1e-2, 5e-3, 2.5e-3]
    off, changes = errors(method, steps, SECOND // 50)
    assert changes == 0
    assert slope(steps, off) == pytest.approx(order, abs=0.1)


@pytest.mark.parametrize(("method", "below"), [("euler", 2e-4), ("rk4", 2e-5)])
def test_through_support_changes_every_method_is_of_first_order(method: str, below: float) -> None:
    """A step across a change is wrong by the jump of the force: the error of RK4 varies, so its mean is compared."""
    coarse, fine = [4.4e-3, 4e-3, 3.6e-3, 3.3e-3], [2.75e-4, 2.5e-4, 2.25e-4, 2.05e-4]
    before, changes = errors(method, coarse, 2 * SECOND)
    after, _ = errors(method, fine, 2 * SECOND)
    assert changes > 50
    ratio = float(np.mean(before) / np.mean(after))
    assert 8.0 < ratio < 40.0  # 16 at first order, 65,536 at fourth
    assert np.mean(after) < below


@pytest.mark.parametrize("law", [SLIDING, STICK_SLIP], ids=["sliding", "stick_slip"])
def test_laws_that_are_functions_of_the_slip_are_those_of_implicit(law: object) -> None:
    body = parcel(position_m=(0.05, 0.03), angle_rad=0.4, velocity_m_s=(0.02, -0.01))
    ends = []
    for solver in (
        {"name": "fixed_step", "step_s": 2e-5},
        {"name": "implicit", "tolerance": 1e-7},
    ):
        plant = solved(solver, body, law=law)  # type: ignore[arg-type]
        wheels = elliptic(plant, -4.0, -8.0)
        _, events = plant.advance(wheels, SECOND // 20)
        ends.append((plant.state[0], [event.kind for event in events]))
    assert ends[0][0] == pytest.approx(ends[1][0], abs=2e-6)
    assert ends[0][1] == ends[1][1]


def test_coulomb_s_force_is_none_at_no_slip_so_that_a_parcel_on_moving_wheels_chatters_about_them() -> None:
    """It reaches the wheels' speed as it should and then steps back and forth over it by half a step's pull."""
    speed, step = 0.2, 7e-4
    plant = solved({"name": "fixed_step", "method": "euler", "step_s": step}, SMALL, law=COULOMB)
    reaches = speed / (MU * G)
    plant.advance(drive(plant, speed), int(0.9 * reaches * SECOND))
    assert plant.state[0, 3] == pytest.approx(0.9 * speed, rel=1e-6)
    trajectory = plant.trajectory(drive(plant, speed), SECOND, 7 * SECOND // 10_000)
    slip = trajectory.state[-200:, 0, 3] - speed
    assert 0.4 * MU * G * step < np.abs(slip).max() <= 1.01 * MU * G * step
    assert np.count_nonzero(np.diff(np.sign(slip))) > 100


def test_a_step_too_long_for_the_law_blows_up_and_is_reported_as_unstable() -> None:
    """Euler's method is stable up to 2 / (mu g): past that slip grows without end, and the parcel runs off."""
    steady, wild = stepped("euler", 0.9), stepped("euler", 1.0, mu=2.0)
    steady.advance(drive(steady, 0.0), 20 * SECOND)
    assert np.abs(steady.state[0, 3:]).max() < 1e-9
    wild.advance(drive(wild, 0.01), 4 * SECOND)
    assert wild.status[0].state == "off_array"
