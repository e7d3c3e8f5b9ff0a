"""The implicit solver against the exact one, against its own conditions, and at its ends."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from plant.effects.motors import MotorsSpec
from plant.errors import PlantUnstable
from plant.friction.coulomb import Coulomb
from plant.friction.registry import FrictionSpec
from plant.friction.stick_slip import StickSlip
from plant.plant import Plant
from tests.plant.laws import COULOMB, SLIDING, VISCOUS
from tests.plant.reference import balances
from tests.plant.scenes import (
    SECOND,
    TICK_NS,
    Floats,
    G,
    cells_of,
    elliptic,
    lawful,
    loads,
    parcel,
    solved,
    spec,
    study,
)
from tests.plant.test_laws import ALL, drive

BODY = parcel(position_m=(0.05, 0.03), angle_rad=0.4, velocity_m_s=(0.1, -0.05), angular_velocity_rad_s=0.5)

# --- against exact ------------------------------------------------------------------------------------------------


def test_fixed_steps_tend_to_the_exact_motion_at_first_order() -> None:
    exact = study()
    wheels = elliptic(exact)
    exact.advance(wheels, 2 * SECOND)
    assert exact.support_changes > 50
    steps, off = [4e-3, 2e-3, 1e-3, 5e-4, 2.5e-4], []
    for step in steps:
        plant = lawful(VISCOUS, step_s=step)
        plant.advance(wheels, 2 * SECOND)
        off.append(np.abs(plant.state - exact.state).max())
    slope = np.polyfit(np.log(steps), np.log(off), 1)[0]
    assert 0.9 < slope < 1.3
    assert off[-1] < 1e-3


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8])
def test_controlled_steps_keep_the_tolerance_through_many_support_changes(tolerance: float) -> None:
    exact = study()
    wheels = elliptic(exact)
    _, known = exact.advance(wheels, 4 * SECOND)
    plant = lawful(VISCOUS, tolerance=tolerance)
    _, events = plant.advance(wheels, 4 * SECOND)
    off = np.abs(plant.state[0] - exact.state[0])
    assert np.hypot(off[0], off[1]) + 0.314 * off[2] < 4.0 * tolerance
    assert Counter((e.kind, e.cells) for e in events) == Counter((e.kind, e.cells) for e in known)
    assert [e.time_s for e in events] == pytest.approx([e.time_s for e in known], abs=1e-2 * tolerance**0.25)


def test_motors_and_coasting_cells_are_those_of_the_exact_solver() -> None:
    motors = MotorsSpec(time_constant_s=0.05)
    ends = []
    for plant in (Plant(spec(BODY, motors=motors)), lawful(VISCOUS, BODY, motors=motors, tolerance=1e-8)):
        plant.release_wheels(cells_of(plant, [(9, 9), (10, 11)]), "coast")
        volts = 10.0 * elliptic(plant)
        for tick in range(1, 101):
            plant.advance(volts if tick < 50 else -volts, tick * TICK_NS)
        ends.append(plant.state[0])
    assert np.abs(ends[0] - ends[1]).max() < 1e-7


def test_what_the_cells_sense_is_what_they_sense_with_the_exact_solver() -> None:
    exact, plant = study(), lawful(VISCOUS, tolerance=1e-9)
    for tick in range(1, 60):
        expected, seen = (
            exact.advance(elliptic(exact), tick * SECOND // 20)[0],
            plant.advance(elliptic(exact), tick * SECOND // 20)[0],
        )
        assert np.array_equal(expected.presence, seen.presence)


@pytest.mark.parametrize("steps", [{"step_s": 1e-3}, {"tolerance": 1e-8}], ids=["fixed", "controlled"])
def test_a_trajectory_passes_through_the_states_of_ticks(steps: dict[str, float]) -> None:
    law = ALL["cone"]
    whole, ticks = lawful(law, BODY, **steps), lawful(law, BODY, **steps)
    trajectory = whole.trajectory(elliptic(whole), 100 * TICK_NS, TICK_NS)
    for tick in range(1, 101):
        ticks.advance(elliptic(ticks), tick * TICK_NS)
        assert trajectory.state[tick, 0] == pytest.approx(ticks.state[0], abs=1e-6)


def test_the_same_scene_gives_the_same_bytes() -> None:
    states = []
    for _ in range(2):
        plant = lawful(COULOMB, BODY)
        plant.advance(elliptic(plant), SECOND)
        states.append(plant.state.tobytes())
    assert states[0] == states[1]


def test_a_parcel_does_not_change_another_s_bits() -> None:
    other = parcel(position_m=(-0.6, -0.6), angle_rad=0.1)
    alone, both = lawful(COULOMB, BODY), lawful(COULOMB, BODY, other)
    for plant in (alone, both):
        plant.advance(elliptic(plant), SECOND // 2)
    assert np.array_equal(alone.state[0], both.state[0])


FIELDS = {
    "elliptic": elliptic,
    "spiral": lambda plant: plant.array.positions_m @ np.array([[-0.5, 0.5], [-0.5, -0.5]]),
    "random": lambda plant: np.random.default_rng(4).uniform(-0.5, 0.5, (len(plant.array), 2)),
}


@pytest.mark.slow
@pytest.mark.parametrize("field", sorted(FIELDS))
@pytest.mark.parametrize("name", ["coulomb", "cone", "stick_slip"])
def test_controlled_steps_keep_the_tolerance_where_wheels_disagree_and_stick_and_slip_in_turn(
    name: str, field: str
) -> None:
    ends = {}
    for steps in ({"tolerance": 1e-6}, {"tolerance": 1e-9}, {"step_s": 4e-5}, {"step_s": 1e-5}):
        plant = lawful(ALL[name], **steps)
        plant.advance(FIELDS[field](plant), SECOND // 2)
        ends[next(iter(steps.values()))] = plant.state[0]
    assert np.abs(ends[1e-6] - ends[1e-9]).max() < 1e-6
    # fixed steps know nothing of what controlled ones look for, and come nearer as they shrink
    coarse, fine = (np.abs(ends[step] - ends[1e-9]).max() for step in (4e-5, 1e-5))
    assert fine < 5e-5
    assert fine < 0.6 * coarse


# --- the step's problem -------------------------------------------------------------------------------------------


class Problem:
    """One step, written plainly: cells, the law's coefficients at the exact solver's loads, and the potential."""

    def __init__(self, law: FrictionSpec, plant: Plant, wheels: Floats, h: float) -> None:
        self.start = plant.state[0]
        x, y, angle, vx, vy, omega = self.start
        body = parcel(position_m=(x, y), angle_rad=angle, velocity_m_s=(vx, vy), angular_velocity_rad_s=omega)
        cells, share = loads(Plant(spec(body)))
        cells = cells[share > 0.0]
        ahead = self.start[:2] + h * self.start[3:5]
        place = plant.array.positions_m[cells]
        share = np.linalg.lstsq(balances(place, ahead), np.array([1.0, 0.0, 0.0]), rcond=1e-12)[0]
        traction, load = law.traction(), 2.0 * G * np.maximum(share, 0.0)
        self.arm = place - ahead
        self.slip_free = traction.free_speed * wheels[cells]
        self.b = (traction.stiffness + traction.stiffness_per_load * load)[:, None]
        self.c = (traction.limit + traction.limit_per_load * load)[:, None]
        self.push = (traction.push_per_load * load)[:, None] * np.sign(wheels[cells])
        self.viscous = traction.viscous
        self.set_valued, self.isotropic = traction.set_valued, traction.isotropic
        self.mass = np.array([2.0, 2.0, 2.0 * (0.54**2 + 0.32**2) / 12.0])

    def slip(self, u: Floats) -> Floats:
        under = u[:2] + u[2] * np.stack([-self.arm[:, 1], self.arm[:, 0]], axis=1)
        return self.slip_free - under

    def force(self, r: Floats) -> Floats:
        """Of laws with one force for each slip."""
        return np.clip(self.b * r, -self.c, self.c) + self.push + self.viscous * r

    def gathered(self, f: Floats) -> Floats:
        """Force and torque of the forces ``(n, 2)``."""
        return np.array([*f.sum(axis=0), np.sum(self.arm[:, 0] * f[:, 1] - self.arm[:, 1] * f[:, 0])])

    def rows(self) -> Floats:
        """``gathered`` as a ``(3, 2 n)`` matrix on the flattened forces."""
        n = len(self.arm)
        eye = np.eye(2 * n).reshape(2 * n, n, 2)
        return np.array([self.gathered(one) for one in eye]).T

    def potential(self, u: Floats, h: float) -> float:
        r = self.slip(u)
        size = np.hypot(r[:, :1], r[:, 1:]) if self.isotropic else np.abs(r)
        if self.set_valued:
            phi = self.c * size
        else:
            bent = np.minimum(size, self.c / np.maximum(self.b, 1e-300))
            phi = 0.5 * self.b * bent**2 + np.where(np.isfinite(self.c), self.c, 0.0) * (size - bent)
        phi = phi + 0.5 * self.viscous * size**2
        step = u - self.start[3:]
        return 0.5 * float(self.mass @ step**2) + h * float(np.sum(phi) + np.sum(self.push * r))


stiff = StickSlip(
    law="stick_slip", coefficient=0.4, motor_constant_n_per_a=1.0, resistance_ohm=1.0, gain_v_s_per_m=1e5
)
LAWS = {**ALL, "sliding": SLIDING, "stiff": stiff, "slick": Coulomb(law="coulomb", coefficient=1e-3)}
speeds = st.floats(-1.0, 1.0) | st.sampled_from([0.0, 0.25])


@settings(max_examples=150)
@given(
    name=st.sampled_from(sorted(LAWS)),
    pose=st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05), st.floats(0.0, 1.5)),
    velocity=st.tuples(speeds, speeds, speeds),
    field=st.sampled_from(["still", "uniform", "turning", "random"]),
    exponent=st.floats(-5.0, -1.0),
    seed=st.integers(0, 100),
)
# a share of this velocity is no number any more
@example(
    name="cone", pose=(0.002, 0.0, 0.0), velocity=(0.0, 0.0, 2.3e-313), field="still", exponent=-1.0, seed=0
)
def test_a_step_ends_at_the_minimum_of_its_problem(
    name: str,
    pose: tuple[float, float, float],
    velocity: tuple[float, float, float],
    field: str,
    exponent: float,
    seed: int,
) -> None:
    h = round(10.0**exponent * SECOND) / SECOND
    body = parcel(
        position_m=pose[:2],
        angle_rad=pose[2],
        velocity_m_s=velocity[:2],
        angular_velocity_rad_s=velocity[2],
    )
    law, draw = LAWS[name], np.random.default_rng(seed)
    plant = lawful(law, body, step_s=1.0)
    turning = plant.array.positions_m @ np.array([[0.0, 0.5], [-0.5, 0.0]])
    wheels = {
        "still": drive(plant, 0.0),
        "uniform": drive(plant, 0.25, -0.1),
        "turning": turning,
        "random": draw.uniform(-0.5, 0.5, turning.shape),
    }[field]
    problem = Problem(law, plant, wheels, h)
    plant.advance(wheels, round(h * SECOND))
    u = plant.state[0, 3:]
    scale = 1.0 + np.abs(u).max()
    # strongly convex: away from the minimum the potential rises at least by the inertia's part
    least = problem.potential(u, h)
    for size in (1e-1, 1e-3, 1e-5):
        away = size * draw.standard_normal(3)
        rise = problem.potential(u + away, h) - least
        assert rise >= 0.5 * float(problem.mass @ away**2) * (1.0 - 1e-6) - 1e-12 * (abs(least) + scale)
    needed = problem.mass * (u - problem.start[3:]) / h
    rounding = 1e-13 * (scale / h + problem.b.max() * scale * problem.arm.size)
    if not problem.set_valued:
        got = problem.gathered(problem.force(problem.slip(u)))
        assert (
            np.abs(got - needed).max() <= 1e-10 * np.abs(problem.c[np.isfinite(problem.c)]).sum() + rounding
        )
    elif not problem.isotropic:
        slip = problem.slip(u)
        sticks = np.abs(slip) <= 1e-11 * scale
        low = np.where(sticks, -problem.c, np.sign(slip) * problem.c)
        high = np.where(sticks, problem.c, np.sign(slip) * problem.c)
        spread = 1e-12 * problem.c + 1e-15
        found = lsq_linear(
            problem.rows(),
            needed - problem.gathered(problem.viscous * slip),
            ((low - spread).ravel(), (high + spread).ravel()),
            tol=1e-15,
            method="bvls",
        )
        assert np.sqrt(2.0 * found.cost) <= 1e-9 * problem.c.sum() + rounding


def test_a_step_is_solved_where_the_least_potential_is_nearer_to_a_kink_than_rounding() -> None:
    plant = lawful(COULOMB, step_s=1e-8)
    state = [0.5597927303347818, 0.48302912566445616, 0.8443149647726723]
    state += [0.08637637141178221, -0.11555625973844594, -0.4321689180385033]
    plant._solver.packed.y[0] = state
    plant.advance(FIELDS["random"](plant), 10)
    assert plant.state[0] == pytest.approx(state, abs=1e-7)


# --- ends ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("steps", [{"step_s": 1e-3}, {"tolerance": 1e-8}], ids=["fixed", "controlled"])
def test_a_parcel_tips_where_and_when_it_does_with_the_exact_solver(steps: dict[str, float]) -> None:
    body = parcel(position_m=(0.6, 0.0), angle_rad=0.0, velocity_m_s=(1.0, 0.0))
    gap = [(row, column) for row in range(20) for column in (18, 19)]
    outcomes = []
    for plant in (Plant(spec(body, missing=gap)), lawful(VISCOUS, body, missing=gap, **steps)):
        plant.advance(drive(plant, 1.0), 2 * SECOND)
        outcomes.append((plant.status[0], plant.state[0]))
    (known, place), (status, ended) = outcomes
    assert (status.state, status.detail) == (known.state, known.detail)
    assert known.state == "off_array"
    assert status.time_s == pytest.approx(known.time_s, abs=2e-3 if "step_s" in steps else 1e-7)
    assert ended == pytest.approx(place, abs=2e-3 if "step_s" in steps else 1e-7)
    assert ended[3:].tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("steps", [{"step_s": 1e-3}, {"tolerance": 1e-8}], ids=["fixed", "controlled"])
def test_a_blow_up_ends_the_run_and_says_where_and_when(steps: dict[str, float]) -> None:
    plant = lawful(VISCOUS, **steps)
    wheels = elliptic(plant)
    plant.advance(wheels, SECOND // 4)
    wheels[plant._solver.covered_cells(0)[3]] = np.nan
    with pytest.raises(
        PlantUnstable, match=r"parcel 0 at t = 0\.25 s, x = \S+ m, y = \S+ m: the motion is no longer finite"
    ):
        plant.advance(wheels, SECOND)


@pytest.mark.parametrize("tolerance", [1e-6, 1e-8])
def test_chatter_is_captured_as_the_exact_solver_does(tolerance: float) -> None:
    """The scene that meets 60,958 support changes in 20 s where each is located, and rests at a known angle."""
    body = parcel(size_m=(0.68, 0.42))
    plant = lawful(VISCOUS, body, tolerance=tolerance)
    plant.advance(elliptic(plant), 20 * SECOND)
    assert plant.state[0, 2] == pytest.approx(0.17925400095, abs=1e-9)
    assert plant.support_changes < 200
    assert plant._solver.effort < 3_000
    assert plant._solver.captured[0]


def test_chatter_that_is_not_captured_overruns_its_edge_by_what_is_allowed() -> None:
    """Under a set-valued law: places differ by less than the larger amplitude, and steps are few."""
    body = parcel(size_m=(0.68, 0.42))
    ends = []
    for capture_m in (1e-6, 1e-8):
        settings = {"name": "implicit", "tolerance": 1e-7, "capture_m": capture_m}
        plant = solved(settings, body, law=ALL["cone"])
        plant.advance(elliptic(plant), 14 * SECOND)
        assert plant._solver.captured[0]
        assert plant._solver.effort < 50_000
        ends.append(plant.state[0])
    assert np.abs(ends[0] - ends[1])[:3].max() < 1e-6
