"""Numbers that are none, run away, or vanish: said with place and time, never passed over."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from deploy.runs.field_simulation import simulate
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from plant.errors import PlantError, PlantUnstable
from plant.plant import Plant
from tests.plant.reference import is_least_norm
from tests.plant.scenes import MU, SECOND, TICK_NS, G, elliptic, loads, members, parcel
from tests.stability.solvers import Claim, Solver, claiming

KAPPA = MU * G
NO_LONGER_FINITE = re.compile(
    r"parcel 0 at t = (?P<t>\S+) s, x = (?P<x>\S+) m, y = (?P<y>\S+) m: the motion is no longer finite"
)


def _fails(plant: Plant, drives: np.ndarray, until_ns: int) -> dict[str, float]:
    """Time and place that the plant names as it gives up; they must be numbers."""
    with pytest.raises(PlantUnstable, match=NO_LONGER_FINITE) as caught:
        plant.advance(drives, until_ns)
    found = NO_LONGER_FINITE.search(str(caught.value))
    assert found is not None
    told = {name: float(value) for name, value in found.groupdict().items()}
    assert all(np.isfinite(value) for value in told.values())
    return told


@claiming(Claim.FAILURES)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("at_s", [0, 3])
def test_a_wheel_that_is_told_no_number_ends_the_motion_where_and_when_it_was(
    solver: Solver, at_s: int, value: float
) -> None:
    """H17: MuJoCo #168 and #989 reset the scene and went on; siconos #118, RigidBodyDynamics #568 gave NaN."""
    plant = solver.plant(parcel())
    plant.advance(elliptic(plant), at_s * SECOND)
    before = plant.state
    drives = elliptic(plant)
    drives[members(plant)[3]] = value
    told = _fails(plant, drives, (at_s + 1) * SECOND)
    assert told == {
        "t": at_s,
        "x": pytest.approx(before[0, 0], rel=1e-5),
        "y": pytest.approx(before[0, 1], rel=1e-5),
    }
    assert np.array_equal(plant.state, before)


@claiming(Claim.MOTION)
def test_a_wheel_under_no_parcel_may_be_told_anything(solver: Solver) -> None:
    """H17, the other way round: what touches no parcel spoils none."""
    plain, odd = solver.plant(parcel()), solver.plant(parcel())
    drives = elliptic(plain)
    plain.advance(drives, TICK_NS)
    drives[0] = np.nan
    odd.advance(drives, TICK_NS)
    assert np.array_equal(plain.state, odd.state)


@claiming(Claim.FINALITY)
def test_a_motion_that_has_failed_stays_failed(solver: Solver) -> None:
    """H17, the silent reset: drives that are numbers again don't bring a motion back that has none."""
    plant = solver.plant(parcel())
    drives = elliptic(plant)
    _fails(plant, drives * np.nan, SECOND)
    before = plant.state
    for until in (SECOND, 2 * SECOND):
        with pytest.raises(PlantUnstable, match="the motion is no longer finite"):
            plant.advance(drives, until)
    assert np.array_equal(plant.state, before)
    assert plant.time_ns == 0


@claiming(Claim.FINALITY)
@pytest.mark.parametrize("speed", [1e160, 1e300])
def test_a_motion_too_fast_for_numbers_ends_where_numbers_do(solver: Solver, speed: float) -> None:
    """H17, blow-up with stiff supports: products of such speeds overflow."""
    plant = solver.plant(parcel(position_m=(0.0, 0.0)))
    drives = np.tile((speed, 0.0), (400, 1))
    drives[::3] *= -1.0
    _fails(plant, drives, SECOND)
    assert np.all(np.isfinite(plant.state))


@claiming(Claim.FINALITY)
def test_a_scene_that_runs_away_ends_with_the_status_unstable(solver: Solver, tmp_path: Path) -> None:
    """H17 for who runs a scene: the summary says so, where and when, and holds what was reached before."""
    field = {"kind": "uniform", "velocity_m_s": [1e300, 0.0]}
    changes = {"solver": solver.settings, "cells.parameters.field": field, "duration_s": 1.0}
    scene = load_scene(
        "elliptic", [Override(tuple(key.split(".")), value, "") for key, value in changes.items()]
    )
    summary = simulate(scene, output=tmp_path, picture=False, quiet=True).summary
    assert summary.status == "unstable"
    assert NO_LONGER_FINITE.search(summary.reason or "")
    assert summary.parcels[0].position_m == (0.55, 0.5)


@claiming(Claim.FAILURES)
def test_the_parcel_whose_motion_failed_is_named_among_several(solver: Solver) -> None:
    """H17: which it was, and where."""
    near, far = (
        parcel(position_m=(-0.5, -0.5), angle_rad=0.0),
        parcel(position_m=(0.5, 0.5), angle_rad=0.0),
    )
    plant = solver.plant(near, far)
    drives = elliptic(plant)
    drives[members(plant, 1)[0]] = np.nan
    with pytest.raises(PlantUnstable, match=r"^parcel 1 at t = 0 s, x = 0\.5 m, y = 0\.5 m"):
        plant.advance(drives, SECOND)
    assert np.all(np.isfinite(plant.state))


@claiming(Claim.SCALES)
@pytest.mark.parametrize("speed", [1e-100, 1e-166, 1e-200, 1e-306])
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_speeds_whose_products_underflow_still_have_their_sign(
    solver: Solver, speed: float, direction: float
) -> None:
    """H13: a sign test by product, as in sundials #57, has (-1e-166) * 1e-166 = 0 and finds a root."""
    body = parcel(size_m=(0.5, 0.4), position_m=(-0.0625, 0.0), angle_rad=0.0)
    plant = solver.plant(body, pitch_m=0.125, rows=4, columns=40)
    before = plant.state
    drives = np.tile((direction * speed, 0.0), (len(plant.array), 1))
    for tick in range(1, 100):
        _, events = plant.advance(drives, tick * TICK_NS)
        assert events == []
    assert np.array_equal(plant.state[0, :2], before[0, :2])
    gained = -np.expm1(-KAPPA * 99 * TICK_NS * 1e-9)
    assert plant.state[0, 3] == pytest.approx(direction * speed * gained, rel=1e-6, abs=1e-320)


def _leaning(solver: Solver, seed: int) -> Plant | None:
    """A parcel with its weight off the centre on an array with holes; None where it would not stand."""
    draw = np.random.default_rng([seed, 16])
    cells = [(r, c) for r in range(14) for c in range(14)]
    holes = tuple(cells[i] for i in draw.choice(196, 80, replace=False))
    body = parcel(
        size_m=(0.7, 0.36),
        centre_of_mass_m=tuple(draw.uniform(-0.15, 0.15, 2)),
        position_m=tuple(draw.uniform(-0.15, 0.15, 2)),
        angle_rad=float(draw.uniform(-3.0, 3.0)),
    )
    try:
        return solver.plant(body, rows=14, columns=14, missing=holes, solver=solver.located)
    except PlantError:
        return None


@pytest.mark.slow
@claiming(Claim.LOADS)
def test_loads_claimed_to_be_converged_are_so_all_along_the_way(solver: Solver) -> None:
    """H16, converged by its own word only: Drake #9241, #21514, #19842. Checked by the optimality conditions."""
    checked = lifted = 0
    for plant in filter(None, (_leaning(solver, seed) for seed in range(20))):
        drives = elliptic(plant, -2.0, -3.0)
        for until in range(TICK_NS, SECOND, 5 * TICK_NS):
            plant.advance(drives, until)
            if plant.status[0].state != "moving":
                break
            plant.advance(drives, until)  # no further: finds the loads of this very instant
            under, share = loads(plant)
            assert is_least_norm(plant.array.positions_m[under], plant.state[0, :2], share) == ""
            checked += 1
            lifted += bool(np.any(share == 0.0))
    assert checked > 200
    assert lifted > 50
