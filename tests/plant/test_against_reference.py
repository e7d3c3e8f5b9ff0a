"""The whole motion, rotation included, against the plain second plant of ``tests/plant/reference.py``."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from plant.effects.motors import MotorsSpec
from plant.plant import Event, Plant
from tests.plant.reference import Bench
from tests.plant.scenes import SECOND, TICK_NS, bench, cells_of, elliptic, members, parcel, spec, study

Field = Callable[[np.ndarray], np.ndarray]

FIELDS: dict[str, Field] = {
    "elliptic": lambda p: p * (-1.0, -2.0),
    "squeeze": lambda p: np.stack([-0.3 * np.sign(p[:, 0]), -0.6 * p[:, 1]], axis=1),
    "vortex": lambda p: np.stack([-1.5 * p[:, 1] - 0.4 * p[:, 0], 1.5 * p[:, 0] - 0.4 * p[:, 1]], axis=1),
    "cubic": lambda p: -4.0 * p * np.sum(p * p, axis=1, keepdims=True),
    "ragged": lambda p: 0.3 * np.random.default_rng(4).normal(size=p.shape) - 0.8 * p,
}

SHAPES: dict[str, dict[str, object]] = {
    "rectangle": {},
    "triangle": {"vertices_m": ((-0.25, -0.2), (0.3, -0.1), (0.0, 0.3))},
    "hexagon": {
        "vertices_m": tuple(
            (0.25 * float(np.cos(t)), 0.25 * float(np.sin(t))) for t in np.arange(6) * np.pi / 3.0
        )
    },
    "off centre": {"centre_of_mass_m": (0.1, -0.05), "inertia_kg_m2": 0.05},
}


def _same_changes(plant: Plant, events: list[Event], reference: Bench, within: float = 1e-8) -> None:
    kinds = {"support_gained": "in", "support_lost": "out", "load_vanished": "load", "load_returned": "load"}
    mine = [(event.time_s, kinds[event.kind], cells_of(plant, event.cells)[0]) for event in events]
    assert [entry[1:] for entry in mine] == [entry[1:] for entry in reference.events]
    assert [entry[0] for entry in mine] == pytest.approx([float(e[0]) for e in reference.events], abs=within)


@pytest.mark.parametrize("name", FIELDS)
def test_the_motion_in_a_field_is_that_of_the_plain_plant(name: str) -> None:
    plant = Plant(spec(parcel(position_m=(0.25, 0.3), angular_velocity_rad_s=0.7), capture_m=1e-12))
    drives = FIELDS[name](plant.array.positions_m)
    reference = bench(plant, drives)
    expected = reference.run(plant.state[0], 1.0)
    _, events = plant.advance(drives, SECOND)
    assert len(events) >= 10
    _same_changes(plant, events, reference)
    assert plant.state[0] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("shape", SHAPES)
def test_the_motion_of_any_convex_footprint_is_that_of_the_plain_plant(shape: str) -> None:
    body = parcel(position_m=(0.3, 0.2), velocity_m_s=(-0.3, 0.2), **SHAPES[shape])
    plant = Plant(spec(body, capture_m=1e-12))
    drives = FIELDS["vortex"](plant.array.positions_m)
    reference = bench(plant, drives)
    expected = reference.run(plant.state[0], 1.0)
    _, events = plant.advance(drives, SECOND)
    assert len(events) >= 10
    _same_changes(plant, events, reference)
    assert plant.state[0] == pytest.approx(expected, abs=1e-9)


def test_lifted_supports_and_holes_are_those_of_the_plain_plant() -> None:
    draw = np.random.default_rng(21)
    cells = [(r, c) for r in range(14) for c in range(14)]
    holes = tuple(cells[i] for i in draw.choice(196, 70, replace=False))
    body = parcel(
        size_m=(0.7, 0.36), centre_of_mass_m=(0.2, 0.08), position_m=(0.1, 0.1), velocity_m_s=(-0.6, 0.1)
    )
    plant = Plant(spec(body, rows=14, columns=14, missing=holes, capture_m=1e-12))
    drives = FIELDS["elliptic"](plant.array.positions_m)
    reference = bench(plant, drives)
    expected = reference.run(plant.state[0], 0.7)
    _, events = plant.advance(drives, 700_000_000)
    assert {"load_vanished", "support_gained", "support_lost"} <= {event.kind for event in events}
    _same_changes(plant, events, reference)
    assert plant.state[0] == pytest.approx(expected, abs=1e-9)


def test_coasting_wheels_carry_and_pull_nothing() -> None:
    plant = Plant(spec(parcel(position_m=(0.3, 0.2), velocity_m_s=(-0.3, 0.2)), capture_m=1e-12))
    dead = np.random.default_rng(6).choice(400, 150, replace=False)
    plant.release_wheels([int(i) for i in dead], "coast")
    grip = np.ones(400)
    grip[dead] = 0.0
    drives = FIELDS["vortex"](plant.array.positions_m)
    reference = bench(plant, drives, grip=grip)
    expected = reference.run(plant.state[0], 1.0)
    _, events = plant.advance(drives, SECOND)
    _same_changes(plant, events, reference)
    assert plant.state[0] == pytest.approx(expected, abs=1e-9)


def test_on_coasting_wheels_alone_a_parcel_keeps_its_velocity_and_turns_steadily() -> None:
    body = parcel(position_m=(-0.4, 0.0), velocity_m_s=(0.2, 0.05), angular_velocity_rad_s=2.0)
    plant = Plant(spec(body))
    plant.release_wheels(range(400), "coast")
    reference = bench(plant, np.zeros((400, 2)), grip=np.zeros(400))
    expected = reference.run(plant.state[0], 4.0)
    _, events = plant.advance(np.ones((400, 2)), 4 * SECOND)
    assert plant.state[0] == pytest.approx([0.4, 0.2, 8.9, 0.2, 0.05, 2.0], abs=1e-12)
    assert expected == pytest.approx([0.4, 0.2, 8.9, 0.2, 0.05, 2.0], abs=1e-9)
    assert len(events) > 100
    _same_changes(plant, events, reference)


@pytest.mark.parametrize("time_constant_s", [0.01, 0.06, 1.0])
def test_motors_lag_as_in_the_plain_plant(time_constant_s: float) -> None:
    motors = MotorsSpec(time_constant_s=time_constant_s, speed_per_volt_m_s=0.1, supply_v=6.0)
    plant = Plant(spec(parcel(position_m=(0.3, 0.2)), motors=motors, capture_m=1e-12))
    drives = 10.0 * FIELDS["vortex"](plant.array.positions_m)
    steady = 0.1 * np.clip(drives, -6.0, 6.0)
    reference = bench(plant, steady, rate=1.0 / time_constant_s, decay=-steady)
    expected = reference.run(plant.state[0], 1.0)
    _, events = plant.advance(drives, SECOND)
    assert len(events) >= 10
    _same_changes(plant, events, reference)
    assert plant.state[0] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("with_motors", [False, True])
def test_drives_that_change_every_tick_are_followed(with_motors: bool) -> None:
    motors = MotorsSpec(time_constant_s=0.02, speed_per_volt_m_s=0.1) if with_motors else None
    body = parcel(position_m=(0.3, 0.2), velocity_m_s=(-0.5, -0.4), angular_velocity_rad_s=1.5)
    plant = Plant(spec(body, motors=motors, capture_m=1e-12))
    draw = np.random.default_rng(9)
    y, speed = plant.state[0], np.zeros((400, 2))
    for tick in range(1, 60):
        drives = 0.5 * draw.normal(size=(400, 2)) - plant.array.positions_m
        steady = 0.1 * np.clip(10.0 * drives, -12.0, 12.0) if with_motors else drives
        decay = speed - steady
        reference = bench(plant, steady, rate=50.0, decay=decay) if with_motors else bench(plant, steady)
        y = reference.run(y, TICK_NS * 1e-9)
        speed = steady + decay * np.exp(-50.0 * TICK_NS * 1e-9)
        plant.advance(10.0 * drives if with_motors else drives, tick * TICK_NS)
        assert plant.state[0] == pytest.approx(y, abs=1e-10)
        assert np.array_equal(members(plant), reference.under(plant.state[0]))
    assert plant.support_changes >= 5


def test_the_study_scene_has_its_86_support_changes_in_ten_seconds() -> None:
    plant = study()
    _, events = plant.advance(elliptic(plant), 10 * SECOND)
    assert plant.support_changes == 86
    assert len(events) == 86
    assert {event.kind for event in events} == {"support_gained", "support_lost"}


def test_the_study_scene_passes_its_graze_as_in_the_plain_plant() -> None:
    plant = study()
    reference = bench(plant, elliptic(plant))
    expected = reference.run(plant.state[0], 1.2)
    _, events = plant.advance(elliptic(plant), 1_200_000_000)
    _same_changes(plant, events, reference)
    assert plant.state[0] == pytest.approx(expected, abs=1e-10)


def test_small_steps_of_a_plain_integrator_converge_to_it_at_first_order() -> None:
    """RK4 with everything found again at every call knows no events: its error is their jumps, first order in h."""
    plant = study()
    reference, start = bench(plant, elliptic(plant)), plant.state[0]
    plant.advance(elliptic(plant), 300_000_000)

    def rate(y: np.ndarray) -> np.ndarray:
        return reference.rates(0.0, y, reference.under(y))

    def error(steps: int) -> float:
        y, h = start, 0.3 / steps
        for _ in range(steps):
            a = rate(y)
            b = rate(y + h / 2 * a)
            c = rate(y + h / 2 * b)
            y = y + h / 6 * (a + 2 * b + 2 * c + rate(y + h * c))
        return abs(float(y[2] - plant.state[0, 2]))

    coarse = np.mean([error(n) for n in (90, 100, 110)])
    fine = np.mean([error(n) for n in (720, 800, 880)])
    assert fine < coarse / 3.0
    assert fine < 2e-5
