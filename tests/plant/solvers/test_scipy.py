"""SciPy's integrators, restarted at the events that they see; and the one that they don't."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from pydantic import ValidationError

from plant.errors import PlantError, PlantUnstable
from plant.friction.registry import FrictionSpec
from plant.solvers import restarting as restarted
from tests.plant.laws import COULOMB, ROLLING, SLIDING, STICK_SLIP
from tests.plant.scenes import SECOND, elliptic, parcel, solved, study
from tests.plant.test_laws import SMALL, drive

METHODS = ["RK45", "DOP853", "Radau", "LSODA"]


def scipy(tolerance: float = 1e-9, method: str = "RK45") -> dict[str, object]:
    return {"name": "scipy", "method": method, "tolerance": tolerance}


@pytest.mark.parametrize("method", METHODS)
def test_every_method_follows_the_exact_motion_through_support_changes_to_its_tolerance(method: str) -> None:
    exact, off = study(), []
    _, known = exact.advance(elliptic(exact), 3 * SECOND // 4)
    for tolerance in (1e-5, 1e-9):
        plant = solved(scipy(tolerance, method))
        _, events = plant.advance(elliptic(plant), 3 * SECOND // 4)
        off.append(float(np.abs(plant.state - exact.state).max()))
    assert [(event.kind, event.cells) for event in events] == [(event.kind, event.cells) for event in known]
    assert len(known) > 20
    assert off[0] < 1e-2
    assert off[1] < min(1e-6, 0.1 * off[0])


def test_it_loses_a_cell_that_a_corner_clips_between_two_of_its_steps() -> None:
    """``solve_ivp`` compares signs at the ends of its steps; no tolerance makes it look in between (scipy #9228)."""
    exact = study()
    _, known = exact.advance(elliptic(exact), SECOND)
    clipped = [event for event in known if event.cells == ((12, 16),)]
    assert [event.kind for event in clipped] == ["support_gained", "support_lost"]
    assert clipped[0].time_s == pytest.approx(0.80356, abs=1e-5)
    for tolerance in (1e-7, 1e-12):
        plant = solved(scipy(tolerance, "DOP853"))
        _, events = plant.advance(elliptic(plant), SECOND)
        entered = [event.time_s for event in events if event.cells == ((12, 16),)]
        assert not entered or entered[0] > clipped[0].time_s + 1e-3
        assert np.abs(plant.state - exact.state).max() > 1e-6


@pytest.mark.parametrize("law", [SLIDING, ROLLING, STICK_SLIP], ids=["sliding", "rolling", "stick_slip"])
def test_other_laws_are_those_of_implicit(law: FrictionSpec) -> None:
    body = parcel(position_m=(0.05, 0.03), angle_rad=0.4, velocity_m_s=(0.02, -0.01))
    ends = []
    for solver in (scipy(), {"name": "implicit", "tolerance": 1e-8}):
        plant = solved(solver, body, law=law)
        _, events = plant.advance(elliptic(plant, -4.0, -8.0), SECOND // 20)
        ends.append((plant.state[0], [(event.kind, event.cells) for event in events]))
    assert ends[0][0] == pytest.approx(ends[1][0], abs=1e-7)
    assert ends[0][1] == ends[1][1]


def test_full_sliding_says_when_a_wheel_is_outrun() -> None:
    plant = solved(scipy(), SMALL, law=SLIDING)
    _, events = plant.advance(drive(plant, 0.2), SECOND // 10)
    (outrun,) = [event for event in events if event.kind == "outrun"]
    assert outrun.time_s == pytest.approx(0.2 / (0.3 * 9.81), abs=1e-9)


def test_loads_that_vanish_and_return_are_those_of_the_exact_solver() -> None:
    draw = np.random.default_rng(21)
    cells = [(r, c) for r in range(14) for c in range(14)]
    array = {
        "rows": 14,
        "columns": 14,
        "missing": tuple(cells[i] for i in draw.choice(196, 70, replace=False)),
    }
    body = parcel(
        size_m=(0.7, 0.36), centre_of_mass_m=(0.2, 0.08), position_m=(0.1, 0.1), velocity_m_s=(-0.6, 0.1)
    )
    outcomes = []
    for solver in ({"name": "exact", "tolerance": 1e-12, "capture_m": 1e-12}, scipy(1e-11)):
        plant = solved(solver, body, **array)
        _, events = plant.advance(elliptic(plant), 700_000_000)
        outcomes.append((plant.state[0], events))
    (known, exact), (state, events) = outcomes
    assert {"load_vanished", "support_gained", "support_lost"} <= {event.kind for event in exact}
    # exact doesn't tell loads that vanish because a cell comes or goes
    for one in exact:
        same = [event for event in events if (event.kind, event.cells) == (one.kind, one.cells)]
        assert min(abs(event.time_s - one.time_s) for event in same) < 1e-7
    assert state == pytest.approx(known, abs=1e-8)


def test_a_row_of_cells_that_enters_at_one_instant_enters_as_one() -> None:
    body = parcel(position_m=(0.0, 0.0), angle_rad=0.0, velocity_m_s=(0.3, 0.0))
    outcomes = []
    for solver in ({"name": "exact"}, scipy(1e-10)):
        plant = solved(solver, body)
        _, events = plant.advance(drive(plant, 0.3), SECOND)
        outcomes.append(sorted((event.kind, event.cells, round(event.time_s, 6)) for event in events))
    assert len(outcomes[0]) > 15
    assert outcomes[1] == outcomes[0]


def test_chatter_ends_as_support_changes_without_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is captured: each crossing of the last cell is located, and they come ever faster."""
    monkeypatch.setattr(restarted, "CHANGES_PER_SECOND", 5)
    monkeypatch.setattr(restarted, "CHANGES_PER_MEMBER", 0)
    plant = solved(scipy(1e-6), parcel(size_m=(0.68, 0.42), position_m=(0.0, 0.0), angle_rad=0.18))
    with pytest.raises(PlantUnstable, match="support changes without end, the last about cell"):
        plant.advance(elliptic(plant), 4 * SECOND)


def test_a_law_with_a_jump_is_refused() -> None:
    with pytest.raises(
        ValidationError, match="solves law viscous, coulomb_sliding, rolling, stick_slip, not"
    ):
        solved(scipy(), law=COULOMB)


def test_without_scipy_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "scipy.integrate", None)
    with pytest.raises(
        PlantError, match=r"SciPy is not installed; .* pip install 'mdms-emulator\[accuracy\]'"
    ):
        solved(scipy())
