"""Many parcels in one call: each moves independently of threads and of the others."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from plant.effects.motors import MotorsSpec
from plant.kernels.common.parcels import LOG_CAPACITY
from plant.observations import Event
from plant.parcel_spec import ParcelSpec
from plant.plant import Plant
from plant.solver_api import Segment
from plant.solvers import compiled as threaded
from plant.specs import PlantSpec
from tests.plant.scenes import SECOND, TICK_NS, Floats, parcel, spec

SOLVERS: dict[str, dict[str, Any]] = {
    "exact": {"name": "exact", "tolerance": 1e-10},
    "implicit": {"name": "implicit", "tolerance": 1e-5},
}
SPAN_NS = 2 * SECOND


def _crowd() -> list[ParcelSpec]:
    """Parcels apart from each other: some that settle, one that stands still, one that tips at the array's edge."""
    draw = np.random.default_rng(4)
    parcels = [
        parcel(
            size_m=tuple(draw.uniform(0.25, 0.6, 2)),
            position_m=(x, y),
            angle_rad=float(draw.uniform(-3.0, 3.0)),
            velocity_m_s=tuple(draw.normal(size=2) * 0.1),
        )
        for x in (-2.0, 0.0, 2.0)
        for y in (-2.0, 2.0)
    ]
    parcels.append(parcel(size_m=(0.3, 0.3), position_m=(0.0, 0.0), angle_rad=0.0))
    parcels.append(parcel(size_m=(0.3, 0.3), position_m=(2.7, 0.0), angle_rad=0.1, velocity_m_s=(3.0, 0.0)))
    return parcels


def _plant(solver: str, parcels: list[ParcelSpec], threads: int, motors: MotorsSpec | None = None) -> Plant:
    """A plant of these parcels on 60 x 60 cells, moved by so many threads."""
    plain = spec(*parcels, rows=60, columns=60, motors=motors)
    plant = Plant(PlantSpec.model_validate(plain.model_dump() | {"solver": SOLVERS[solver]}))
    plant._solver.thread_pool.threads = threads
    return plant


def _wells(plant: Plant, apart_m: float) -> Floats:
    """Wheel speeds that draw every parcel to the middle of the square it is in: parcels don't meet."""
    offset = (plant.array.positions_m + 0.5 * apart_m) % apart_m - 0.5 * apart_m
    return offset * (-1.0, -2.0)


def _own(events: list[Event], index: int) -> list[tuple[Any, ...]]:
    """What happened to one parcel, but for its number."""
    return [event[:2] + event[3:] for event in events if event.parcel == index]


@pytest.mark.parametrize("solver", SOLVERS)
def test_threads_change_no_bit_and_no_order(solver: str) -> None:
    one, *others = [_plant(solver, _crowd(), threads) for threads in (1, 2, 4)]
    trajectory = one.trajectory(_wells(one, 2.0), SPAN_NS, 50 * TICK_NS)
    assert {state.state for state in one.status} == {"moving", "at_rest", "off_array"}
    for plant in others:
        same = plant.trajectory(_wells(plant, 2.0), SPAN_NS, 50 * TICK_NS)
        assert len(plant._solver._workspaces) > 1
        assert same.state.tobytes() == trajectory.state.tobytes()
        assert same.events == trajectory.events
        assert plant.status == one.status
        assert plant.support_changes == one.support_changes
        assert np.array_equal(plant.sense().presence, one.sense().presence)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_parcel_beside_others_moves_as_it_does_alone(solver: str) -> None:
    together = _plant(solver, _crowd(), 4)
    trajectory = together.trajectory(_wells(together, 2.0), SPAN_NS, 50 * TICK_NS)
    presence = np.zeros_like(together.sense().presence)
    for i, body in enumerate(_crowd()):
        alone = _plant(solver, [body], 1)
        own = alone.trajectory(_wells(alone, 2.0), SPAN_NS, 50 * TICK_NS)
        assert own.state[:, 0].tobytes() == trajectory.state[:, i].tobytes()
        assert _own(own.events, 0) == _own(trajectory.events, i)
        assert alone.status[0] == together.status[i]
        presence |= alone.sense().presence
    assert np.array_equal(together.sense().presence, presence)


def test_ticks_of_many_parcels_go_as_those_of_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """Through ticks, with motors, every thread awake: what a call leaves for the next is each parcel's own as well."""
    monkeypatch.setattr(threaded, "MIN_WORK_PER_THREAD", 1)
    monkeypatch.setattr(threaded, "SENSED_WORTH_WAKING", 1)
    motors = MotorsSpec(time_constant_s=0.05)
    bodies = _crowd()
    plants = [_plant("exact", bodies, 2, motors), *(_plant("exact", [body], 1, motors) for body in bodies)]
    draw = np.random.default_rng(1)
    logs: list[list[Event]] = [[] for _ in plants]
    for tick in range(1, 60):
        drives = draw.normal(size=(3600, 2)) * 5.0
        for plant, so_far in zip(plants, logs, strict=True):
            so_far.extend(plant.advance(drives, tick * TICK_NS)[1])
    together, *alone = plants
    assert len(together._solver._workspaces) == 2
    presence = np.any([plant.sense().presence for plant in alone], axis=0)
    assert np.array_equal(together.sense().presence, presence)
    for i, plant in enumerate(alone):
        assert plant.state.tobytes() == together.state[i : i + 1].tobytes()
        assert _own(logs[i + 1], 0) == _own(logs[0], i)
    assert together.support_changes == sum(plant.support_changes for plant in alone) > 20


def test_every_parcel_logs_as_much_as_it_does_alone_however_many_log_at_once() -> None:
    """Together they log more than the log of a thread holds, and one of them more than is kept of one."""
    chatters = parcel(size_m=(0.68, 0.42))
    bodies = [
        chatters.model_copy(update={"position_m": (x + 0.55, y + 0.5)})
        for x, y in ((-2.0, -2.0), (0.0, -2.0), (2.0, 0.0))
    ]
    bodies[1:1] = [parcel(position_m=(-1.5, 0.2))]
    settings = {"name": "exact", "tolerance": 1e-12, "capture_m": 1e-10}

    def run(parcels: list[ParcelSpec]) -> tuple[Plant, list[Event]]:
        plain = spec(*parcels, rows=60, columns=60)
        plant = Plant(PlantSpec.model_validate(plain.model_dump() | {"solver": settings}))
        plant._solver.thread_pool.threads = 1
        return plant, plant.advance(_wells(plant, 2.0), 20 * SECOND)[1]

    together, events = run(bodies)
    counts = np.bincount([event.parcel for event in events])
    assert counts.max() == LOG_CAPACITY
    assert together.support_changes > 2 * LOG_CAPACITY
    for i, body in enumerate(bodies):
        alone, own = run([body])
        assert _own(own, 0) == _own(events, i)
        assert alone.state.tobytes() == together.state[i : i + 1].tobytes()


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_solver_returns_only_parcels_with_events(solver: str) -> None:
    plant = _plant(solver, _crowd(), 1)
    inner, n = plant._solver, len(plant.array)
    everyone = np.arange(len(plant.status))

    def move(speeds: Floats, which: NDArray[np.int64], span_s: float) -> list[int]:
        before = inner.state.copy()
        motion = plant._wheels.command(speeds, span_s).motion
        results = inner.advance(which, Segment.through(motion, np.ones(n), span_s, len(everyone)))
        unmoved = np.setdiff1d(everyone, which)
        assert np.array_equal(inner.state[unmoved], before[unmoved])
        return [done.parcel for done in results]

    assert move(np.zeros((n, 2)), np.array([6]), 1.0) == []
    assert move(_wells(plant, 2.0), np.array([5, 6, 0]), 1.0) == [5, 0]
