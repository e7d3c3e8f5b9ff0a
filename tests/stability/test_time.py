"""Time from nanoseconds to weeks: scales of the motion, steps lost in rounding, clocks that drift."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from cell_firmware.specs import CellsSpec
from tests.plant.scenes import MU, SECOND, TICK_NS, elliptic, parcel
from tests.stability.solvers import Claim, Solver, claiming


@claiming(Claim.SCALES, Claim.EVENTS)
@pytest.mark.parametrize("faster", [1e-5, 1e-3, 1e3, 1e6])
def test_a_scene_a_million_times_faster_or_slower_has_the_same_motion(solver: Solver, faster: float) -> None:
    """H14, time scales: scipy #15262, where the root finder's tolerance in time is longer than the step.

    With all speeds and the friction times s, time runs s times as fast: ten seconds take 10 us, or eleven days.
    """
    plain = solver.plant(parcel())
    _, planned = plain.advance(elliptic(plain), 10 * SECOND)
    plant = solver.plant(parcel(), mu=MU * faster)
    _, events = plant.advance(faster * elliptic(plant), round(10 * SECOND / faster))
    assert [(e.kind, e.cells) for e in events] == [(e.kind, e.cells) for e in planned]
    times = [event.time_s * faster for event in events]
    assert times == pytest.approx([event.time_s for event in planned], abs=1e-8)
    scale = [1.0, 1.0, 1.0, faster, faster, faster]
    assert plant.state[0] / scale == pytest.approx(plain.state[0], abs=1e-9)


@claiming(Claim.SCALES, Claim.EVENTS)
@pytest.mark.parametrize("speed", [1e-6, 1e-3, 1e3, 1e6])
def test_crossings_at_constant_speed_come_on_time_at_any_speed(solver: Solver, speed: float) -> None:
    """H14: a metre in a microsecond or in eleven days, every column when the ruler says so."""
    body = parcel(size_m=(0.31, 0.25), position_m=(-0.5, 0.0), angle_rad=0.0, velocity_m_s=(speed, 0.0))
    plant = solver.plant(body)
    span_ns = round(1e9 / speed)
    _, events = plant.advance(np.tile((speed, 0.0), (400, 1)), span_ns)
    gained = sorted({event.time_s for event in events if event.kind == "support_gained"})
    apart = [b - a for a, b in pairwise(gained)]
    # the first column ahead of the edge at -0.345 m is that at -0.25 m
    assert gained[0] == pytest.approx(0.095 / speed, rel=1e-9)
    assert apart == pytest.approx([0.1 / speed] * 9, rel=1e-9)
    assert plant.state[0, 0] == pytest.approx(-0.5 + speed * span_ns * 1e-9, abs=1e-11)


@claiming(Claim.MOTION)
@pytest.mark.parametrize("waited_s", [1, 1_000, 1_000_000])
def test_the_motion_does_not_depend_on_when_it_begins(solver: Solver, waited_s: int) -> None:
    """H14, ``t + h = t``: after eleven days a step of a nanosecond is below the clock's rounding as a float."""
    plain, late = solver.plant(parcel()), solver.plant(parcel())
    begin = waited_s * SECOND
    late.advance(np.zeros((400, 2)), begin)
    for plant, start in ((plain, 0), (late, begin)):
        for k in range(1, 50):
            plant.advance(elliptic(plant), start + k)
        for k in range(1, 250):
            plant.advance(elliptic(plant), start + k * TICK_NS)
    assert late.state == pytest.approx(plain.state, abs=solver.within(1e-13))
    assert late.support_changes == plain.support_changes > 0


@claiming(Claim.SCALES)
def test_a_step_of_a_nanosecond_moves_a_parcel_by_its_share_however_late_it_is(solver: Solver) -> None:
    """H14 and H15: a thousand nanoseconds, one by one, after eleven days."""
    body = parcel(position_m=(0.0, 0.0), velocity_m_s=(1.0, 0.0))
    plant = solver.plant(body)
    wait = 1_000_000 * SECOND
    plant.release_wheels(range(400), "coast")
    drives = np.zeros((400, 2))
    plant.advance(drives, 1)
    start = plant.state[0, 0]
    assert start == pytest.approx(1e-9, rel=1e-9)
    resting = solver.plant(parcel(position_m=(0.0, 0.0)))
    resting.advance(drives, wait)
    for k in range(1, 1001):
        resting.advance(np.tile((1.0, 0.0), (400, 1)), wait + k)
    # from rest, x = V (t - (1 - exp(-kappa t)) / kappa), here kappa V t^2 / 2 to a millionth
    assert resting.state[0, 0] == pytest.approx(0.5 * MU * 9.81 * 1e-12, rel=1e-5)


@claiming(Claim.REST, Claim.PACE)
@pytest.mark.parametrize("period_s", [0.015, 0.004096, 0.1, 0.001, 0.0007])
def test_ten_million_ticks_end_on_the_nanosecond(solver: Solver, period_s: float) -> None:
    """H15, a clock by repeated addition: Drake #4325 froze at tick 11 of 0.015 s; Drake #10443, bdsim #36."""
    period_ns, ticks = CellsSpec(period_s=period_s).period_ns, 10_000_000
    plant = solver.plant(parcel())
    # all but the last hundred in one go: each call takes a whole number of nanoseconds, and none is lost
    for tick in range(ticks - 100, ticks + 1):
        plant.advance(np.zeros((400, 2)), tick * period_ns)
        assert plant.time_ns == tick * period_ns
    assert plant.time_ns == round(ticks * 1_000_000 * period_s) * 1_000
    trajectory = plant.trajectory(np.zeros((400, 2)), plant.time_ns + 7 * period_ns, period_ns)
    assert np.diff(trajectory.time_ns).tolist() == [period_ns] * 7


@claiming(Claim.MOTION)
def test_the_last_of_ten_million_ticks_moves_as_far_as_the_first(solver: Solver) -> None:
    """H15, where the length of a tick is a difference of two large floats: pathsim #249, coral #14."""
    moved = []
    for begin in (0, 10_000_000 * TICK_NS):
        plant = solver.plant(parcel(position_m=(0.0, 0.0)))
        plant.advance(np.zeros((400, 2)), begin)
        for k in range(1, 11):
            plant.advance(np.tile((0.3, 0.1), (400, 1)), begin + k * TICK_NS)
        moved.append(plant.state)
    assert moved[1] == pytest.approx(moved[0], rel=1e-13, abs=solver.within(1e-18))
