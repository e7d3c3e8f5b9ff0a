"""The exact solver under laws other than viscous: against a second plant, closed forms, and limits known otherwise."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from plant.effects.motors import MotorsSpec
from plant.friction.registry import FrictionSpec
from plant.friction.stick_slip import StickSlip
from plant.kernels.common import layout
from plant.kernels.common.parcels import Parcel
from plant.plant import Plant
from plant.specs import PlantSpec
from tests.plant.laws import FREE, MOTORS, MU, ROLLING, SLIDING, STICK_SLIP, B
from tests.plant.reference import Bench
from tests.plant.scenes import SECOND, TICK_NS, Floats, G, bench, cells_of, elliptic, loads, parcel, spec

MASS = 2.0
EXACT: dict[str, FrictionSpec] = {"sliding": SLIDING, "rolling": ROLLING, "stick_slip": STICK_SLIP}
ALIGNED: dict[str, Any] = {"position_m": (0.0, 0.0), "angle_rad": 0.0}


def _limited(loads: Floats, wheels: Floats, under: Floats) -> Floats:
    grip = MU * MASS * G * loads[:, None]
    return np.clip(B * (FREE * wheels - under), -grip, grip) / MASS


PULLS: dict[str, Callable[[Floats, Floats, Floats], Floats]] = {
    "sliding": lambda loads, wheels, _: MU * G * loads[:, None] * np.sign(wheels),
    "rolling": lambda _, wheels, under: B * (FREE * wheels - under) / MASS,
    "stick_slip": _limited,
}
"""Force per kilogram of every law, as it is written."""


def exact(law: FrictionSpec, **scene: Any) -> Plant:
    """A plant of one parcel under any law; ``body`` holds the parcel's settings."""
    return Plant(
        PlantSpec.model_validate(dict(spec(parcel(**scene.pop("body", {})), **scene)) | {"friction": law})
    )


def plain(plant: Plant, name: str, drives: Floats, **settings: Any) -> Bench:
    """The second plant for the same parcel and law."""
    reference = bench(plant, drives, **({"longest_step": 0.01} | settings))
    reference.pull = PULLS[name]  # type: ignore[method-assign]
    return reference


def inner(plant: Plant) -> Parcel:
    """The parcel as the solver holds it."""
    solver: Any = plant._solver
    return solver.parcels[0]


def counts(plant: Plant) -> NDArray[np.int64]:
    """The parcel's counters."""
    return inner(plant).ctl


def branch_changes(plant: Plant) -> int:
    """Changes so far that were none of the supports."""
    return int(counts(plant)[layout.N_CHANGES] - counts(plant)[layout.N_EVENTS])


# --- against the second plant -------------------------------------------------------------------------------------


def _scene(name: str, seed: int) -> tuple[Plant, Floats]:
    """A parcel of random shape and motion, on an array with holes, with every second one's weight off the centre."""
    draw = np.random.default_rng(seed)
    body = {
        "size_m": tuple(draw.uniform(0.25, 0.6, 2)),
        "position_m": tuple(draw.uniform(-0.2, 0.2, 2)),
        "angle_rad": draw.uniform(0.0, 6.0),
        "velocity_m_s": tuple(draw.uniform(-0.3, 0.3, 2)),
        "angular_velocity_rad_s": draw.uniform(-2.0, 2.0),
        "centre_of_mass_m": tuple(draw.uniform(-0.06, 0.06, 2)) if seed % 2 else (0.0, 0.0),
    }
    holes = [cell for cell in product(range(20), repeat=2) if (3 * cell[0] + 5 * cell[1]) % 7 == 0]
    plant = exact(EXACT[name], body=body, missing=holes, capture_m=1e-12)
    return plant, elliptic(plant) + 0.2 * draw.normal(size=(len(plant.array), 2))


@pytest.mark.parametrize(
    ("name", "seed", "span_s"),
    [
        ("sliding", 3, 0.4),
        ("sliding", 8, 0.4),
        ("rolling", 0, 0.3),
        ("rolling", 3, 0.3),
        ("stick_slip", 0, 0.15),
        ("stick_slip", 7, 0.15),
    ],
)
def test_the_motion_and_its_events_are_those_of_the_plain_plant(name: str, seed: int, span_s: float) -> None:
    plant, drives = _scene(name, seed)
    reference = plain(plant, name, drives)
    expected = reference.run(plant.state[0], span_s)
    _, events = plant.advance(drives, int(span_s * SECOND))
    changes = [(event.time_s, cells_of(plant, event.cells)[0]) for event in events if event.kind != "outrun"]
    assert len(changes) >= 3
    assert [cell for _, cell in changes] == [cell for _, _, cell in reference.events]
    assert [time for time, _ in changes] == pytest.approx([float(e[0]) for e in reference.events], abs=1e-9)
    assert plant.state[0] == pytest.approx(expected, abs=1e-10)
    assert branch_changes(plant) >= 10 or name != "stick_slip"


def test_a_corner_that_clips_a_cell_for_five_milliseconds_is_seen_under_full_sliding() -> None:
    plant = exact(SLIDING, body={"position_m": (0.25, 0.3), "angular_velocity_rad_s": 0.7}, capture_m=1e-12)
    reference = plain(plant, "sliding", elliptic(plant))
    expected = reference.run(plant.state[0], 0.2)
    _, events = plant.advance(elliptic(plant), SECOND // 5)
    clipped = [event for event in events if event.cells == ((11, 9),)]
    assert [event.kind for event in clipped] == ["support_gained", "support_lost"]
    assert clipped[1].time_s - clipped[0].time_s == pytest.approx(0.00528, abs=1e-5)
    assert plant.state[0] == pytest.approx(expected, abs=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("name", EXACT)
def test_drives_that_change_every_tick_and_coasting_wheels_are_followed(name: str) -> None:
    plant = exact(
        EXACT[name], body={"velocity_m_s": (-0.5, -0.4), "angular_velocity_rad_s": 1.5}, capture_m=1e-12
    )
    draw, grip = np.random.default_rng(9), np.ones(400)
    dead = draw.choice(400, 100, replace=False)
    plant.release_wheels(dead.tolist(), "coast")
    grip[dead] = 0.0
    y = plant.state[0]
    for tick in range(1, 25):
        drives = 0.5 * draw.normal(size=(400, 2)) - plant.array.positions_m
        # short steps: SciPy does not know where wheels change branch
        y = plain(plant, name, drives, grip=grip, longest_step=2e-4).run(y, TICK_NS * 1e-9)
        plant.advance(drives, tick * TICK_NS)
        assert plant.state[0] == pytest.approx(y, abs=1e-10)
    assert plant.support_changes >= 1


# --- full sliding (eq. 24) ----------------------------------------------------------------------------------------


def test_full_sliding_on_a_belt_is_a_parabola_through_all_support_changes() -> None:
    body = {"position_m": (-0.4, 0.3), "angle_rad": 0.4, "angular_velocity_rad_s": 1.0}
    plant = exact(SLIDING, body=body)
    plant.advance(np.tile((4.0, -2.0), (400, 1)), SECOND // 4)
    distance, speed = 0.5 * MU * G * 0.25**2, MU * G * 0.25
    assert plant.support_changes >= 10
    assert plant.state[0] == pytest.approx(
        [-0.4 + distance, 0.3 - distance, 0.65, speed, -speed, 1.0], abs=1e-12
    )


def test_being_outrun_is_reported_again_once_the_wheels_have_been_faster_in_between() -> None:
    plant = exact(SLIDING, body=ALIGNED | {"position_m": (-0.5, 0.0)})
    slow, fast, times = np.tile([0.1, 0.0], (400, 1)), np.tile([0.3, 0.0], (400, 1)), []
    for drives, until in ((slow, 0.05), (slow, 0.07), (fast, 0.09), (fast, 0.12)):
        _, events = plant.advance(drives, int(until * SECOND))
        times += [event.time_s for event in events if event.kind == "outrun"]
    assert times == pytest.approx([0.1 / (MU * G), 0.3 / (MU * G)], abs=1e-11)


def test_the_end_of_being_outrun_is_seen_within_one_call() -> None:
    """Between belts that run against each other a parcel swings, and outruns the one, then the other."""
    body = ALIGNED | {"position_m": (-0.45, 0.0)}
    x = exact(SLIDING, body=body).array.positions_m[:, 0]
    drives = np.stack([np.where(x < 0.0, 0.1, -0.1), np.zeros_like(x)], axis=1)
    reports = []
    for calls in (1, 100):
        plant, times = exact(SLIDING, body=body), []
        for call in range(1, calls + 1):
            _, events = plant.advance(drives, call * 3 * SECOND // calls)
            times += [event.time_s for event in events if event.kind == "outrun"]
        reports.append(times)
    assert len(reports[0]) >= 2
    assert reports[0][0] == pytest.approx(0.1 / (MU * G), abs=1e-11)
    assert reports[0] == pytest.approx(reports[1], abs=1e-11)


@pytest.mark.parametrize("time_constant_s", [0.02, 0.3])
def test_motors_that_turn_their_wheels_round_turn_the_pull_round_at_that_instant(
    time_constant_s: float,
) -> None:
    motors = MotorsSpec(time_constant_s=time_constant_s, speed_per_volt_m_s=0.1, supply_v=100.0)
    plant = exact(SLIDING, body=ALIGNED, motors=motors)
    plant.advance(np.tile([100.0, 0.0], (400, 1)), SECOND // 50)
    speed, before = float(plant.wheel_speed[0, 0]), plant.state[0, 3]
    assert before == pytest.approx(MU * G / 50.0, abs=1e-13)
    plant.advance(np.tile([-80.0, 0.0], (400, 1)), 3 * SECOND // 50)
    turns = time_constant_s * np.log((speed + 8.0) / 8.0)
    assert 0.0 < turns < 0.04
    assert plant.state[0, 3] == pytest.approx(before + MU * G * (2.0 * turns - 0.04), abs=1e-12)


def test_wheels_that_motors_bring_to_a_stop_pull_until_they_stand() -> None:
    motors = MotorsSpec(time_constant_s=0.01, speed_per_volt_m_s=0.1, supply_v=100.0)
    plant = exact(SLIDING, body=ALIGNED, motors=motors)
    plant.advance(np.tile([10.0, 0.0], (400, 1)), SECOND // 100)
    plant.advance(np.zeros((400, 2)), SECOND // 10)
    assert plant.state[0, 3] == pytest.approx(MU * G * 0.1, abs=1e-12)


# --- rolling (eq. 27) ---------------------------------------------------------------------------------------------


def test_rolling_on_a_belt_follows_its_closed_form_while_its_supports_stand() -> None:
    """Without rotation ``m x'' = n b (s - x')``, whatever the loads."""
    body = ALIGNED | {"centre_of_mass_m": (0.01, 0.0), "inertia_kg_m2": 1e12, "velocity_m_s": (0.02, 0.01)}
    plant = exact(ROLLING, body=body)
    start = plant.state[0]
    plant.advance(np.tile([0.05, -0.03], (400, 1)), SECOND // 5)
    assert plant.support_changes == 0
    assert np.all(loads(plant)[1] > 0.0)
    rate, free = len(plant._solver.covered_cells(0)) * B / MASS, FREE * np.array([0.05, -0.03])
    off = start[3:5] - free
    assert plant.state[0, 3:5] == pytest.approx(free + off * np.exp(-rate * 0.2), abs=1e-13)
    moved = free * 0.2 - off * np.expm1(-rate * 0.2) / rate
    assert plant.state[0, :2] == pytest.approx(start[:2] + moved, abs=1e-13)


# --- stick-slip ---------------------------------------------------------------------------------------------------


def test_stick_slip_between_its_limits_is_rolling_and_beyond_all_of_them_full_sliding() -> None:
    body = {"position_m": (0.02, 0.01), "angular_velocity_rad_s": 0.8}
    ample = exact(StickSlip(law="stick_slip", coefficient=1e3, **MOTORS), body=body)
    rolling, spare, sliding = (
        exact(ROLLING, body=body),
        exact(STICK_SLIP, body=body),
        exact(SLIDING, body=body),
    )
    drives = elliptic(rolling)
    for plant in (ample, rolling):
        plant.advance(drives, SECOND)
    assert rolling.support_changes >= 3
    assert ample.state == pytest.approx(rolling.state, abs=1e-13)
    for plant in (spare, sliding):
        plant.advance(np.sign(drives) * 20.0, SECOND // 10)
    assert sliding.support_changes >= 3
    assert spare.state == pytest.approx(sliding.state, abs=1e-13)


def test_rows_of_wheels_that_change_branch_at_one_instant_leave_a_symmetric_motion_symmetric() -> None:
    plant, slipping = exact(STICK_SLIP, body=ALIGNED | {"position_m": (0.53, 0.0)}), set()
    for tick in range(1, 101):
        plant.advance(elliptic(plant), tick * SECOND // 100)
        listed = inner(plant).mem[: counts(plant)[layout.N_MEMBERS]]
        slipping.add(int(np.count_nonzero(listed[:, layout.BRANCH : layout.BRANCH + 2])))
        assert np.abs(plant.state[0, [1, 2, 4, 5]]).max() < 1e-13
    assert len(slipping) >= 4
    assert all(wheels % 2 == 0 for wheels in slipping)


# --- chatter, rest ------------------------------------------------------------------------------------------------

CHATTER = {
    # size, first angle or how far from the last one, cell
    "rolling": ((0.68, 0.42), 0.3, (0.35, 0.15)),
    "stick_slip": ((0.66, 0.34), 0.3, (0.35, 0.05)),
    "sliding": ((0.54, 0.32), None, (0.25, 0.05)),
}
"""Parcels at the origin whose torque changes sign where a cell (x, -y) and its opposite lie under the long edges."""


@pytest.mark.parametrize("name", CHATTER)
def test_chatter_is_captured_and_ends_with_the_cells_on_the_edges(name: str) -> None:
    size, angle, (x, y) = CHATTER[name]
    ends = float(np.arcsin(0.5 * size[1] / np.hypot(x, y)) - np.arctan2(y, x))
    # without resistance a swing never dies out: begin it as small as chatter that is captured
    begins = ends - 1e-9 if angle is None else angle
    plant = exact(EXACT[name], body={"size_m": size, "position_m": (0.0, 0.0), "angle_rad": begins})
    plant.advance(elliptic(plant), 6 * SECOND)
    assert counts(plant)[layout.N_GROUPS] == 1
    assert 1 <= counts(plant)[layout.N_CHANGES] < 400
    assert plant.state[0] == pytest.approx([0.0, 0.0, ends, 0.0, 0.0, 0.0], abs=1e-12)
    steps, changes = counts(plant)[layout.N_STEPS], plant.support_changes
    plant.advance(elliptic(plant), 6 * SECOND + TICK_NS)
    assert counts(plant)[layout.N_STEPS] == steps + 1
    assert plant.support_changes == changes


def test_a_smaller_capture_takes_more_changes_to_the_same_angle_under_stick_slip() -> None:
    ends, changes = [], []
    for capture_m in (1e-6, 1e-8):
        body = {"size_m": (0.66, 0.34), "position_m": (0.0, 0.0), "angle_rad": 0.3}
        plant = exact(STICK_SLIP, body=body, capture_m=capture_m)
        plant.advance(elliptic(plant), 6 * SECOND)
        ends.append(plant.state[0, 2])
        changes.append(plant.support_changes)
    assert ends[0] == pytest.approx(ends[1], abs=1e-12)
    assert changes[1] > 5 * changes[0]


@pytest.mark.parametrize("name", EXACT)
def test_a_parcel_at_rest_stays_to_the_bit_at_the_cost_of_one_step_a_call(name: str) -> None:
    plant = exact(EXACT[name], body={"angle_rad": 0.37})
    before = plant.state
    for call in range(1, 6):
        plant.advance(np.zeros((400, 2)), call * TICK_NS)
        assert counts(plant)[layout.N_STEPS] == call
    assert np.array_equal(plant.state, before)
