"""Wheels of unequal friction: each wheel's force, closed forms of parcels on them, and how factors are drawn."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from bus.lattice import Lattice
from plant.effects.uneven_friction import UnevenFrictionSpec, friction_factors
from plant.factories import _strongest
from plant.friction.registry import FrictionSpec
from plant.parcel_spec import ParcelSpec
from plant.plant import Plant
from plant.specs import PlantSpec
from tests.plant.laws import CONE, COULOMB, MU, ROLLING, SLIDING, STICK_SLIP, VISCOUS
from tests.plant.scenes import SECOND, Floats, G, parcel, solved, spec

IMPLICIT: dict[str, object] = {"name": "implicit", "tolerance": 1e-9}
WIDE = parcel(size_m=(2.0, 2.0), position_m=(0.0, 0.0), angle_rad=0.0)
FIVE = [(row, column) for row in range(5) for column in range(5)]


def unequal(
    body: ParcelSpec = WIDE,
    *,
    law: FrictionSpec = VISCOUS,
    solver: dict[str, object] | None = None,
    **effect: object,
) -> Plant:
    """A plant of five by five cells of unequal friction, all under the parcel."""
    effects = {"uneven_friction": effect}
    return solved(solver or IMPLICIT, body, law=law, effects=effects, rows=5, columns=5)


def uniform(plant: Plant, vx: float, vy: float = 0.0) -> Floats:
    """The same speed of all wheels."""
    return np.tile([vx, vy], (len(plant.array), 1))


@pytest.mark.slow
@pytest.mark.parametrize(
    "law", [VISCOUS, COULOMB, SLIDING, STICK_SLIP], ids=["viscous", "coulomb", "sliding", "mixed"]
)
def test_a_wheel_pulls_by_its_own_factor(law: FrictionSpec) -> None:
    """What one wheel of 25 gives a parcel at rest, the others having no friction."""
    for axis, factors in ((0, (0.3, 2.0)), (1, (0.3, 2.0)), (0, (0.0, 1.0))):
        cells = [{"cell": cell, "factors": factors if cell == (1, 3) else (0.0, 0.0)} for cell in FIVE]
        plant = unequal(law=law, cells=cells)
        drives = np.zeros((25, 2))
        drives[plant.array.lattice.index((1, 3)), axis] = 1.0
        plant.advance(drives, 1000)
        pull = (0.2 if law is VISCOUS else MU) * G / 25
        assert plant.state[0, 3 + axis] == pytest.approx(factors[axis] * pull * 1e-6, rel=1e-6, abs=1e-18)
        if law is not COULOMB:  # under which the other wheel resists the turning, however slow
            assert abs(plant.state[0, 4 - axis]) < 1e-14


@pytest.mark.slow
def test_a_parcel_stops_along_each_axis_as_the_wheels_of_that_axis_brake() -> None:
    cells = [{"cell": cell, "factors": (0.5, 1.5)} for cell in FIVE]
    plant = unequal(WIDE.model_copy(update={"velocity_m_s": (0.2, 0.3)}), law=COULOMB, cells=cells)
    pull = MU * G * np.array([0.5, 1.5])
    plant.advance(uniform(plant, 0.0), SECOND // 20)
    assert plant.state[0, 3:5] == pytest.approx(np.array([0.2, 0.3]) - pull * 0.05, abs=1e-9)
    plant.advance(uniform(plant, 0.0), SECOND // 2)
    assert plant.state[0, :2] == pytest.approx(0.5 * np.array([0.04, 0.09]) / pull, abs=1e-8)
    assert plant.state[0, 3:].tolist() == [0.0, 0.0, 0.0]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["implicit", "fixed_step", "quasi_static"])
def test_a_parcel_reaches_the_mean_speed_of_its_wheels_weighted_by_their_friction(name: str) -> None:
    """Factors and speeds that mirror about the middle turn nothing: ``sum k_i (V_i - U) = 0``."""
    far = np.array([np.hypot(row - 2, column - 2) for row, column in FIVE])
    cells = [{"cell": cell, "factor": 1.0 + one} for cell, one in zip(FIVE, far.tolist(), strict=True)]
    plant = unequal(solver={"name": name}, cells=cells)
    mean = float(np.sum((1.0 + far) * far) / np.sum(1.0 + far))
    speed = np.array([0.01, -0.02]) * mean
    plant.advance(np.stack([0.01 * far, -0.02 * far], axis=1), 1_000_000)
    if name != "quasi_static":
        speed *= -np.expm1(-0.2 * G * float(np.mean(1.0 + far)) * 1e-3)
    # in a millisecond loads lean by some 1e-5
    assert plant.state[0, 3:5] == pytest.approx(speed, rel=1e-4)


@pytest.mark.slow
def test_the_two_wheels_of_a_cell_with_one_limit_share_its_factor() -> None:
    cells = [{"cell": cell, "factor": 0.5} for cell in FIVE]
    plant = unequal(law=CONE, cells=cells)
    plant.advance(uniform(plant, 3.0, 4.0), SECOND // 100)
    assert plant.state[0, 3:5] == pytest.approx(0.5 * MU * G * 0.01 * np.array([0.6, 0.8]), rel=1e-3)


def test_factors_are_log_normal_with_mean_one_of_cells_times_wheels() -> None:
    lattice = Lattice((row, column) for row in range(150) for column in range(150))
    for seed in range(20):
        drawn = friction_factors(UnevenFrictionSpec(cell_spread=0.3, wheel_spread=0.1), lattice, seed)
        logs = np.log(drawn)
        # four standard errors of 22,500 draws
        assert drawn.mean() == pytest.approx(1.0, abs=4.0 * 0.32 / 150)
        assert logs.std(axis=0) == pytest.approx([np.hypot(0.3, 0.1)] * 2, rel=4.0 / (np.sqrt(2.0) * 150))
        assert np.std(logs[:, 0] - logs[:, 1]) == pytest.approx(
            0.1 * np.sqrt(2.0), rel=4.0 / (np.sqrt(2.0) * 150)
        )


def test_a_cell_with_given_factors_changes_no_other_and_seeds_differ() -> None:
    lattice = Lattice((row, column) for row in range(3) for column in range(3))
    plain = friction_factors(UnevenFrictionSpec(cell_spread=0.2, wheel_spread=0.1), lattice, 5)
    table = {"cell_spread": 0.2, "wheel_spread": 0.1, "cells": [{"cell": (1, 1), "factors": (0.1, 3.0)}]}
    given = friction_factors(UnevenFrictionSpec.model_validate(table), lattice, 5)
    assert given[4].tolist() == [0.1, 3.0]
    assert np.array_equal(np.delete(given, 4, axis=0), np.delete(plain, 4, axis=0))
    assert not np.any(
        friction_factors(UnevenFrictionSpec(cell_spread=0.2, wheel_spread=0.1), lattice, 6) == plain
    )


def test_the_bounds_of_contacts_are_those_of_the_strongest_wheel() -> None:
    cells = [{"cell": (0, 0), "factors": (0.5, 4.0)}]
    table = dict(spec(WIDE)) | {
        "solver": {"name": "implicit"},
        "effects": {"uneven_friction": {"cells": cells}},
    }
    for law in (VISCOUS, COULOMB, SLIDING):
        plain, strong = law.traction(), _strongest(PlantSpec.model_validate(table | {"friction": law}))
        assert strong.stiffness_per_load == 4.0 * plain.stiffness_per_load
        assert strong.limit_per_load == 4.0 * plain.limit_per_load
        assert strong.push_per_load == 4.0 * plain.push_per_load


@pytest.mark.parametrize(
    ("law", "effect", "rule"),
    [
        (
            ROLLING,
            {},
            r"friction\.law rolling doesn't depend on the load, so effects\.uneven_friction can't vary it",
        ),
        (CONE, {"wheel_spread": 0.1}, r"friction\.contact isotropic gives both wheels of a cell one limit"),
        (
            CONE,
            {"cells": [{"cell": (0, 0), "factors": (1.0, 2.0)}]},
            r"friction\.contact isotropic gives both wheels of a cell one limit",
        ),
        (VISCOUS, {"cells": [{"cell": (9, 0), "factor": 1.0}]}, "the array has no cell there"),
        (VISCOUS, {"cells": [{"cell": (0, 0)}]}, "give factor or factors, one of the two"),
        (VISCOUS, {"cells": [{"cell": (0, 0), "factor": 1.0}] * 2}, r"cells names \[0, 0\] twice"),
        (VISCOUS, {"cells": [{"cell": (0, 0), "factor": -1.0}]}, "factor"),
    ],
)
def test_what_does_not_go_together_is_refused(
    law: FrictionSpec, effect: dict[str, object], rule: str
) -> None:
    with pytest.raises(ValidationError, match=rule):
        unequal(law=law, **effect)
