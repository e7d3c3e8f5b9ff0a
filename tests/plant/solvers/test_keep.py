"""Going back: a solver that is put back to an instant goes on as it did, to the last bit."""

from __future__ import annotations

import numpy as np
import pytest

from plant.plant import Plant
from plant.solver_specs import ExactSpec, ImplicitSpec, SolverSpec
from plant.specs import PlantSpec
from tests.plant.scenes import TICK_NS, elliptic, members, parcel, spec

SOLVERS = [ExactSpec(), ImplicitSpec(name="implicit"), ImplicitSpec(name="implicit", step_s=1e-3)]


def _plant(solver: SolverSpec) -> Plant:
    other = parcel(position_m=(-0.5, -0.4), angle_rad=0.2)
    return Plant(PlantSpec.model_validate(dict(spec(parcel(), other)) | {"solver": solver}))


def _on(plant: Plant, drives: np.ndarray, count: int) -> bytes:
    for _ in range(count):
        plant.advance(drives, plant.time_ns + TICK_NS)
    return plant.state.tobytes() + members(plant).tobytes()


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_snapshot_is_restored_and_continues_with_the_same_bits(solver: SolverSpec) -> None:
    plant = _plant(solver)
    drives = elliptic(plant)
    _on(plant, drives, 200)
    snapshot = plant._solver.snapshot(np.array([0, 1]))
    before = plant.state.tobytes()
    first = _on(plant, drives, 100)
    plant._solver.restore(snapshot)
    assert plant.state.tobytes() == before
    assert _on(plant, drives, 100) == first


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_parcel_put_elsewhere_is_as_one_that_starts_there(solver: SolverSpec) -> None:
    plant = _plant(solver)
    drives = elliptic(plant)
    _on(plant, drives, 600)
    place = np.array([0.31, 0.22, 0.4, 0.1, -0.2, 0.3])
    plant._solver.set_state(0, place)
    fresh = _plant(solver)
    fresh._solver.set_state(0, place)
    assert np.array_equal(members(plant), members(fresh))
    plant.advance(drives, plant.time_ns + 10 * TICK_NS)
    fresh.advance(drives, 10 * TICK_NS)
    assert plant.state[0] == pytest.approx(fresh.state[0], abs=1e-6)
    assert plant.state[1].tobytes() != fresh.state[1].tobytes()
