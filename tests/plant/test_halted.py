"""Calls of the plant that end early: asked to, or given up for their steps; and what they leave."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest
from pydantic import TypeAdapter

from plant import stop
from plant.effects.parcel_contact.spec import ParcelContactSpec
from plant.effects.registry import PlantEffects
from plant.errors import PlantStopped, PlantUnstable
from plant.plant import Plant
from plant.solver_specs import SolverSpec
from plant.specs import PlantSpec
from plant.stiffness import beyond_steps, fastest
from tests.plant.effects.parcel_contact.benches import box, still
from tests.plant.effects.parcel_contact.benches import plant as touching
from tests.plant.scenes import MU, SECOND, TICK_NS, G, elliptic, parcel, spec

SOLVERS = ["exact", "implicit", "quasi_static", "fixed_step", "scipy", "heyoka"]
STIFF = {"inertia_kg_m2": 1e-9}
"""A parcel that turns a billion times as easily as one of its size."""


def _spec(solver: dict[str, object], *parcels: object, **values: object) -> PlantSpec:
    plain = dict(spec(*parcels, **values))  # type: ignore[arg-type]
    return PlantSpec.model_validate(plain | {"solver": TypeAdapter(SolverSpec).validate_python(solver)})


@pytest.fixture
def stopped() -> Iterator[None]:
    stop.request()
    yield
    stop.withdraw()


@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.usefixtures("stopped")
def test_every_solver_ends_a_call_that_is_to_end_and_leaves_parcels_where_they_were(name: str) -> None:
    if name in ("scipy", "heyoka"):
        pytest.importorskip(name)
    stop.withdraw()
    plant = Plant(_spec({"name": name}, parcel()))
    before, drives = plant.state, elliptic(plant)
    stop.request()
    with pytest.raises(PlantStopped) as caught:
        plant.trajectory(drives, SECOND, TICK_NS)
    assert caught.value.reached is not None
    assert caught.value.reached.time_ns.tolist() == [0]
    assert np.array_equal(plant.state, before)
    assert plant.time_ns == 0


def test_a_running_kernel_ends_soon_after_the_request() -> None:
    plant = Plant(_spec({"name": "exact", "max_steps_per_s": 1e12}, parcel(**STIFF)))
    drives, requested_at = elliptic(plant), []

    def ask() -> None:
        requested_at.append(time.process_time())
        stop.request()

    timer = threading.Timer(0.2, ask)
    timer.start()
    try:
        with pytest.raises(PlantStopped) as caught:
            plant.advance(drives, 1000 * SECOND)
        assert time.process_time() - requested_at[0] < 0.5
        assert 0.0 < caught.value.time_s < 1000.0
    finally:
        timer.join()
        stop.withdraw()


def test_a_plant_that_was_stopped_does_not_go_on() -> None:
    plant = Plant(spec(parcel()))
    stop.request()
    try:
        with pytest.raises(PlantStopped):
            plant.advance(elliptic(plant), TICK_NS)
    finally:
        stop.withdraw()
    with pytest.raises(PlantStopped):
        plant.advance(elliptic(plant), TICK_NS)


@pytest.mark.usefixtures("stopped")
def test_parcels_that_push_each_other_end_their_call_too() -> None:
    stop.withdraw()
    plant = touching(box(-0.4, 0.0, velocity_m_s=(0.5, 0.0)), box(-0.1, 0.0))
    stop.request()
    with pytest.raises(PlantStopped):
        plant.advance(still(plant), TICK_NS)
    assert plant.time_ns == 0


# --- what is stiff -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("solver", "limit"),
    [
        (
            {"name": "exact", "max_steps_per_s": 1e4},
            "10,000 steps in a simulated second .solver.max_steps_per_s.",
        ),
        (
            {"name": "scipy", "max_evaluations_per_s": 1e3},
            "1,000 right-hand sides in a simulated second .solver.max_evaluations_per_s.",
        ),
    ],
    ids=["exact", "scipy"],
)
def test_a_stiff_motion_is_given_up_and_says_what_is_stiff_and_what_to_take(
    solver: dict[str, object], limit: str
) -> None:
    plant = Plant(_spec(solver, parcel(**STIFF)))
    with pytest.raises(
        PlantUnstable,
        match=rf"^parcel 0 at t = \S+ s, .*: more than {limit}: the motion is stiff, its rotation settles in "
        r"7\.1e-09 s; take solver\.name = \"implicit\", or \"quasi_static\", which leaves inertia out$",
    ) as caught:
        plant.advance(elliptic(plant), 2 * SECOND)
    assert 0.0 <= caught.value.time_s < 0.1


def test_only_solvers_that_know_the_effects_are_advised() -> None:
    effects = PlantEffects(parcel_contact=ParcelContactSpec())
    scene = PlantSpec.model_validate(dict(spec(parcel(**STIFF))) | {"effects": effects})
    advice = beyond_steps(scene, 0, np.array([[0.1, 0.1], [-0.1, -0.1]]))
    assert advice.endswith('take solver.name = "implicit"')


def _until_given_up(plant: Plant, span_ns: int) -> float:
    try:
        while True:
            plant.advance(elliptic(plant), plant.time_ns + span_ns)
    except PlantUnstable as unstable:
        return unstable.time_s


def test_a_budget_of_steps_is_for_a_second_of_the_time_reached_however_long_calls_are() -> None:
    one = Plant(_spec({"name": "exact", "max_steps_per_s": 1e3}, parcel()))
    one.trajectory(elliptic(one), 20 * SECOND, TICK_NS)
    many = Plant(_spec({"name": "exact", "max_steps_per_s": 1e3}, parcel()))
    for tick in range(1, 200):
        many.advance(elliptic(many), tick * TICK_NS)
    ends = []
    for span_ns in (SECOND, TICK_NS // 16):
        plant = Plant(_spec({"name": "exact", "max_steps_per_s": 2e3}, parcel(**STIFF)))
        ends.append(_until_given_up(plant, span_ns))
    assert ends[0] == pytest.approx(ends[1], rel=0.2)


def test_time_constants_are_those_of_the_equations() -> None:
    # dU/dt = mu g (V - U); I d omega/dt = tau0 - mu m g <r^2> omega
    levers = np.array([[0.1, 0.1], [-0.1, 0.1], [-0.1, -0.1], [0.1, -0.1]])
    body = parcel(inertia_kg_m2=1e-3)
    turning = fastest(spec(body), body, levers)
    assert turning.part == "its rotation"
    assert turning.time_s == pytest.approx(1e-3 / (MU * G * 2.0 * 0.02), rel=1e-12)
    heavy = parcel(inertia_kg_m2=1e3)
    assert fastest(spec(heavy), heavy, levers).time_s == pytest.approx(1.0 / (MU * G), rel=1e-12)


# --- what is kept -----------------------------------------------------------------------------------


def test_the_state_that_all_parcels_reached_is_retained_to_the_bit() -> None:
    calm = parcel(position_m=(-0.5, -0.4), angle_rad=0.3)
    budget = 4e4
    plant = Plant(_spec({"name": "exact", "max_steps_per_s": budget}, calm, parcel(**STIFF)))
    drives = elliptic(plant)
    with pytest.raises(PlantUnstable, match=r"^parcel 1 at t = ") as caught:
        plant.trajectory(drives, SECOND, TICK_NS // 64)
    reached = caught.value.reached
    assert reached is not None
    assert len(reached.time_ns) > 5
    end_ns = int(reached.time_ns[-1])
    assert 0.0 < caught.value.time_s - end_ns * 1e-9 < 1e-3
    assert plant.time_ns == end_ns
    assert np.array_equal(plant.state, reached.state[-1])
    alone = Plant(_spec({"name": "exact"}, calm)).trajectory(drives, SECOND, TICK_NS // 64)
    assert np.array_equal(alone.state[: len(reached.state), 0], reached.state[:, 0])
    assert all(event.time_s <= caught.value.time_s for event in reached.events)


def test_who_tips_after_another_has_failed_has_not_tipped() -> None:
    edge = parcel(size_m=(0.3, 0.3), position_m=(0.85, 0.0), angle_rad=0.0, velocity_m_s=(2.0, 0.0))
    plant = Plant(_spec({"name": "exact", "max_steps_per_s": 1e4}, edge, parcel(**STIFF)))
    with pytest.raises(PlantUnstable):
        plant.trajectory(elliptic(plant), 5 * SECOND, TICK_NS)
    assert plant.status[0].state == "moving"
    assert plant.state[0, :2].tolist() == [0.85, 0.0]
