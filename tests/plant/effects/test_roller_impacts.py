"""Roller impacts: single impacts by hand, the viscous law that emerges of many, and energy that never rises."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from plant.effects.motors import MotorsSpec
from plant.effects.roller_impacts import starts
from plant.kernels.common import layout
from plant.parcel_spec import ParcelSpec
from plant.plant import Plant
from plant.solver_api import Segment
from plant.solvers.implicit import Implicit
from plant.specs import PlantSpec
from plant.wheels import WheelMotion
from tests.plant.scenes import SECOND, Floats, G, elliptic, parcel, solved, spec

pytestmark = pytest.mark.slow

TRIFLING = {"law": "viscous", "coefficient_s_per_m": 1e-9}
"""The scene's own law, by which next to nothing moves."""


def bumpy(
    spacing_m: float,
    impulse_s: float,
    *parcels: ParcelSpec,
    seed: int = 0,
    step_s: float | None = None,
    effects: dict[str, object] | None = None,
    **array: object,
) -> Plant:
    """A plant with roller impacts that has next to no friction besides."""
    values = dict(spec(*(parcels or (parcel(),)), **array))  # type: ignore[arg-type]
    rollers = {"spacing_m": spacing_m, "impulse_s": impulse_s}
    values |= {
        "seed": seed,
        "friction": TRIFLING,
        "solver": {"name": "implicit", "tolerance": 1e-6, "step_s": step_s},
        "effects": {"roller_impacts": rollers} | (effects or {}),
    }
    return Plant(PlantSpec.model_validate(values))


def uniform(plant: Plant, speed: tuple[float, float] = (0.1, 0.0)) -> Floats:
    """All wheels at one speed."""
    return np.tile(speed, (len(plant.array.positions_m), 1))


def path(plant: Plant, drives: Floats, seconds: int = 6) -> Floats:
    """``(k, 3)`` poses of the first parcel, ten a second."""
    return plant.trajectory(drives, seconds * SECOND, SECOND // 10).state[:, 0, :3]


def energy(state: Floats, inertia_per_mass: float) -> Floats:
    """Kinetic energy per kilogram of states ``(T, 6)``."""
    return 0.5 * (state[:, 3] ** 2 + state[:, 4] ** 2 + inertia_per_mass * state[:, 5] ** 2)


def test_each_wheel_impacts_once_a_spacing_where_its_roller_stood_by_its_share_of_the_load() -> None:
    spacing_m, impulse_s, speed = 1e-3, 1e-5, 0.1
    body = parcel(size_m=(0.15, 0.15), position_m=(0.02, 0.0), angle_rad=0.0, velocity_m_s=(speed, 0.0))
    plant = bumpy(spacing_m, impulse_s, body, rows=2, columns=2, seed=3)
    seen = plant.trajectory(uniform(plant, (0.0, 0.0)), SECOND // 50, 10_000)
    dropped = -np.diff(seen.state[:, 0, 3])
    dropping = np.flatnonzero(dropped > 1e-3 * impulse_s * G)
    # the surface seen from the parcel runs backwards: a wheel's roller passes after what it has turned since the last
    passing = np.concatenate([starts(4, 3)[:, 0], starts(4, 3)[:, 0] + 1.0]) * spacing_m
    order = np.argsort(passing)
    assert len(dropping) == 8
    assert seen.state[dropping + 1, 0, 0] - 0.02 == pytest.approx(passing[order], abs=1.5e-6)
    # moments about the centre of mass, x off the middle: columns at -p/2 and p/2 carry 1/4 -+ x/(2 p) a cell
    x_m = np.tile(plant.array.positions_m[:, 0], 2)[order]
    share = 0.25 + 0.5 * np.sign(x_m) * seen.state[dropping + 1, 0, 0] / 0.1
    assert dropped[dropping] == pytest.approx(share * impulse_s * G, rel=0.01)


@pytest.mark.parametrize("ratio", [0.1, 0.3])
def test_a_viscous_coefficient_emerges_which_is_impulse_over_spacing(ratio: float) -> None:
    spacing_m, rate = 1e-3, ratio * G
    smooth = solved({"name": "implicit", "tolerance": 1e-6}, mu=1e-9)
    smooth.advance(uniform(smooth), SECOND)
    assert smooth.state[0, 3] < 1e-8
    emerged, distances = [], []
    for seed in range(8):
        plant = bumpy(spacing_m, ratio * spacing_m, seed=seed)
        plant.advance(uniform(plant), SECOND // 2)
        emerged.append(-np.log(1.0 - plant.state[0, 3] / 0.1) / (0.5 * G))
        distances.append(plant.state[0, 0] - 0.55)
    assert np.mean(emerged) == pytest.approx(ratio, rel=0.01)
    assert np.std(emerged) < 0.02 * ratio
    known = 0.1 * (0.5 - (1.0 - np.exp(-0.5 * rate)) / rate)
    assert np.mean(distances) == pytest.approx(known, abs=0.2 * spacing_m)


def test_path_and_end_are_those_of_the_viscous_law_and_the_scatter_falls_with_the_spacing() -> None:
    exact = Plant(spec(parcel()))
    known = path(exact, elliptic(exact))
    spacings, scatter = np.array([8e-3, 2e-3, 5e-4]), []
    for spacing_m in spacings:
        off = []
        for seed in range(6):
            plant = bumpy(spacing_m, 0.2 * spacing_m, seed=seed)
            found = path(plant, elliptic(plant)) - known
            off.append(np.max(np.hypot(found[:, 0], found[:, 1])))
            assert np.abs(found[-1, 2]) < 5.0 * spacing_m
        scatter.append(np.sqrt(np.mean(np.square(off))))
    assert np.all(np.array(scatter) < 0.4 * spacings)
    assert 0.7 < np.polyfit(np.log(spacings), np.log(scatter), 1)[0] < 1.3


def test_steps_of_one_length_are_cut_to_one_roller_too() -> None:
    exact = Plant(spec(parcel()))
    plant = bumpy(1e-3, 2e-4, step_s=0.05)
    exact.advance(elliptic(exact), 2 * SECOND)
    plant.advance(elliptic(plant), 2 * SECOND)
    assert plant.state[0, :2] == pytest.approx(exact.state[0, :2], abs=5e-4)
    # twenty steps a second, were they not
    assert plant._solver.parcels[0].ctl[layout.N_STEPS] > 1000


def test_motors_that_spin_up_strike_as_often_as_they_slip() -> None:
    motors = MotorsSpec(time_constant_s=0.2)
    exact = Plant(spec(parcel(), motors=motors))
    plant = bumpy(1e-3, 2e-4, effects={"motors": motors.model_dump()})
    for other in (exact, plant):
        other.advance(uniform(other, (1.0, -2.0)), SECOND)
    assert plant.state[0, :2] == pytest.approx(exact.state[0, :2], abs=5e-4)
    assert plant.state[0, 3:5] == pytest.approx(exact.state[0, 3:5], rel=0.02)


def test_a_parcel_at_the_wheels_speed_has_no_roller_impacts() -> None:
    plant = bumpy(1e-4, 1e-3, parcel(position_m=(-0.4, 0.1), velocity_m_s=(0.1, 0.05)))
    plant.advance(uniform(plant, (0.1, 0.05)), 5 * SECOND)
    assert plant.state[0, 2:].tolist() == [0.9, 0.1, 0.05, 0.0]
    still = bumpy(1e-4, 1e-3)
    before = still.state[0].tolist()
    still.advance(uniform(still, (0.0, 0.0)), 3600 * SECOND)
    assert still.state[0].tolist() == before


def test_wheels_that_coast_strike_nothing() -> None:
    plant = bumpy(1e-3, 1e-3, parcel(velocity_m_s=(0.1, 0.0)))
    plant.release_wheels(range(len(plant.array.positions_m)), "coast")
    plant.advance(uniform(plant, (0.0, 0.0)), SECOND)
    assert plant.state[0, 3:].tolist() == [0.1, 0.0, 0.0]


@pytest.mark.parametrize("impulse_s", [1e-4, 1e-2, 10.0])
def test_on_stopped_wheels_kinetic_energy_never_rises_however_hard_the_rollers_strike(
    impulse_s: float,
) -> None:
    body = parcel(position_m=(0.0, 0.0), velocity_m_s=(0.3, -0.2), angular_velocity_rad_s=1.5)
    plant = bumpy(2e-3, impulse_s, body)
    seen = plant.trajectory(uniform(plant, (0.0, 0.0)), 2 * SECOND, SECOND // 1000)
    held = energy(seen.state[:, 0], 1.0 / plant._solver.parcels[0].par[layout.MASS_OVER_INERTIA])
    assert np.all(np.diff(held) <= 1e-15 * held[0])
    assert held[-1] < 0.5 * held[0]


def test_an_impact_stops_the_slip_that_it_opposes_and_does_not_reverse_it() -> None:
    speed, spacing_m = 0.1, 1e-3
    body = parcel(size_m=(0.15, 0.15), position_m=(0.0, 0.0), angle_rad=0.0, velocity_m_s=(speed, 0.0))
    plant = bumpy(spacing_m, 10.0, body, rows=2, columns=2)
    first = int(np.argmin(starts(4, 0)[:, 0]))
    until_ns = round(starts(4, 0)[first, 0] * spacing_m / speed * SECOND)
    plant.advance(uniform(plant, (0.0, 0.0)), until_ns - 10_000)
    assert plant.state[0, 3:].tolist() == pytest.approx([speed, 0.0, 0.0], rel=1e-6)
    plant.advance(uniform(plant, (0.0, 0.0)), until_ns + 10_000)
    # a plastic impact at a lever: of a square's side s, the radius of gyration squared is s^2 / 6
    lever = plant.state[0, 1] - plant.array.positions_m[first, 1]
    squared = 0.15 * 0.15 / 6.0
    lost = speed / (1.0 + lever * lever / squared)
    assert plant.state[0, 3:] == pytest.approx([speed - lost, 0.0, -lost * lever / squared], rel=1e-6)


def test_chance_is_the_seeds_and_no_parcel_changes_anothers_impacts() -> None:
    other = parcel(position_m=(-0.5, -0.5), angle_rad=0.3)
    plants = [
        bumpy(2e-3, 4e-4),
        bumpy(2e-3, 4e-4),
        bumpy(2e-3, 4e-4, seed=1),
        bumpy(2e-3, 4e-4, other, parcel()),
    ]
    for plant in plants:
        # long enough for the two to come to lie on the same cells
        plant.advance(elliptic(plant), 3 * SECOND)
    once, again, reseeded, beside = (plant.state[-1].tobytes() for plant in plants)
    assert once == again == beside
    assert once != reseeded


def test_a_parcel_taken_back_to_where_it_was_meets_the_same_rollers_again() -> None:
    plant = bumpy(2e-3, 4e-4)
    plant.advance(elliptic(plant), SECOND)
    solver, motion = plant._solver, WheelMotion(elliptic(plant), uniform(plant, (0.0, 0.0)), 0.0)
    assert isinstance(solver, Implicit)
    one = np.zeros(1, dtype=np.int64)
    saved, ends = solver.snapshot(one), list[bytes]()
    for _ in range(2):
        solver.restore(saved)
        solver.advance(one, Segment.through(motion, np.ones(len(elliptic(plant))), 1.0, 1))
        ends.append(solver.state.tobytes())
    assert ends[0] == ends[1]


def test_the_effect_is_refused_where_it_does_not_fit() -> None:
    values, rollers = dict(spec(parcel())), {"spacing_m": 1e-3, "impulse_s": 2e-4}
    with pytest.raises(
        ValidationError, match=r"solver\.name exact leaves out effects\.roller_impacts; use implicit"
    ):
        PlantSpec.model_validate(values | {"effects": {"roller_impacts": rollers}})
    with pytest.raises(ValidationError, match=r"spacing_m\n.*greater than or equal to 0\.00001"):
        bumpy(1e-6, 2e-4)
