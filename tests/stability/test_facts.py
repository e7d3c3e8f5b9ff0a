"""Facts about the viscous law that are known without this project, from the scalar problem to the whole parcel."""

from __future__ import annotations

import numpy as np
import pytest

from plant.plant import Plant
from plant.reports import Event
from tests.plant.scenes import SECOND, G, parcel
from tests.stability.solvers import Solver

RETURNS = {5: 6, 10: 39, 20: 1_159}
"""How often ``x'' = -sgn x - x'`` from x = 0, x' = 1 is back at zero by then: computed crossing by crossing."""


def _scalar(solver: Solver, capture_m: float) -> tuple[Plant, np.ndarray]:
    """The scalar problem ``x'' = -sgn x - x'`` made of wheels: unit pitch, ``mu g = 1``.

    A parcel as long as three pitches stands on three columns and gains and loses the outer ones as it passes 0. With
    the inner wheels running outward and the outer ones inward at 3 m/s, the loads' lever rule gives a pull of exactly
    -1 on the right and +1 on the left.
    """
    body = parcel(size_m=(3.0, 1.6), position_m=(0.0, 0.0), angle_rad=0.0, velocity_m_s=(1.0, 0.0))
    plant = solver.plant(
        body, rows=2, columns=6, pitch_m=1.0, mu=1.0 / G, solver={"capture_m": capture_m, "tolerance": 1e-13}
    )
    x = plant.array.positions_m[:, 0]
    drives = np.zeros((len(plant.array), 2))
    drives[:, 0] = np.where(np.abs(x) < 1.0, 3.0, -3.0) * np.sign(x)
    return plant, drives


def test_the_scalar_chatter_returns_as_often_as_it_should(solver: Solver) -> None:
    """H6, Zeno: OpenModelica PR #16009 (the ball falls through the floor), modypy #32, Reference-FMUs PR #252."""
    plant, drives = _scalar(solver, 1e-14)
    events: list[Event] = []
    for second in range(1, 21):
        events += plant.advance(drives, second * SECOND)[1]
        if second in RETURNS:
            # a return changes a column of two cells on each side, all at one instant
            gained = [event.time_s for event in events if event.kind == "support_gained"]
            assert len(gained) // 2 == RETURNS[second]
            # the column left behind at the start is the odd one
            assert len(events) == 2 * len(gained) + 2
    assert np.abs(plant.state[0, [1, 2, 4, 5]]).max() < 1e-12


def test_the_scalar_chatter_captured_is_motion_on_the_surface(solver: Solver) -> None:
    """H6: with swings below 0.1 mm replaced by their limit it comes to rest at zero, about a hundred returns later."""
    plant, drives = _scalar(solver, 1e-4)
    _, events = plant.advance(drives, 1000 * SECOND)
    # speed falls by two thirds of its square at each return, and 0.1 mm are 0.014 m/s at 1 m/s^2
    assert 4 * 80 < plant.support_changes < 4 * 140
    assert [event.kind for event in events if event.kind in ("captured", "released")] == ["captured"]
    assert np.abs(plant.state).max() < 1e-12


@pytest.mark.parametrize(("left", "right"), [(0.1, 0.1), (0.2, 0.1), (0.1, 0.4), (0.25, 0.05)])
def test_the_equilibrium_between_opposed_wheels_moves_with_their_speeds(
    solver: Solver, left: float, right: float
) -> None:
    """Viscous, two opposed groups of wheels: the loads shift until ``N_left V_left = N_right V_right``."""
    plant = solver.plant(parcel(size_m=(1.0, 0.8), position_m=(0.02, 0.0), angle_rad=0.0), rows=2, columns=2)
    drives = np.zeros((4, 2))
    drives[:, 0] = np.where(plant.array.positions_m[:, 0] < 0.0, left, -right)
    plant.advance(drives, 600 * SECOND)
    assert plant.state[0, 0] == pytest.approx(0.05 * (left - right) / (left + right), abs=1e-9)
    assert plant.state[0, 1:] == pytest.approx([0.0] * 5, abs=1e-9)
