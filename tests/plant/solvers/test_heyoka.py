"""heyoka's Taylor integrator, its events isolated: the plant's own digits by another's hand."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from pydantic import ValidationError

from plant.errors import PlantError, PlantUnstable
from plant.solvers import restarting as restarted
from tests.plant.laws import ROLLING, STICK_SLIP
from tests.plant.scenes import SECOND, elliptic, parcel, solved, study
from tests.plant.test_laws import drive


def heyoka(tolerance: float = 1e-12) -> dict[str, object]:
    pytest.importorskip("heyoka")
    return {"name": "heyoka", "tolerance": tolerance}


def test_it_finds_every_change_of_the_study_scene_the_graze_included_and_ends_where_exact_does() -> None:
    exact = study()
    _, known = exact.advance(elliptic(exact), 10 * SECOND)
    assert sum(event.cells == ((12, 16),) and 0.80 < event.time_s < 0.81 for event in known) == 2
    for tolerance, off in ((1e-6, 1e-5), (1e-9, 1e-8), (1e-14, 1e-12)):
        plant = solved(heyoka(tolerance))
        _, events = plant.advance(elliptic(plant), 10 * SECOND)
        assert [(event.kind, event.cells) for event in events] == [(e.kind, e.cells) for e in known]
        assert plant.state == pytest.approx(exact.state, abs=off)
    assert [event.time_s for event in events] == pytest.approx([event.time_s for event in known], abs=1e-10)


@pytest.mark.parametrize(
    "shape",
    [
        {"vertices_m": ((-0.25, -0.2), (0.3, -0.1), (0.0, 0.3))},
        {"vertices_m": tuple((0.25 * np.cos(t), 0.25 * np.sin(t)) for t in np.arange(6) * np.pi / 3.0)},
        {"centre_of_mass_m": (0.1, -0.05), "inertia_kg_m2": 0.05},
    ],
    ids=["triangle", "hexagon", "off centre"],
)
def test_any_convex_footprint_moves_as_with_exact(shape: dict[str, object]) -> None:
    body = parcel(position_m=(0.3, 0.2), velocity_m_s=(-0.3, 0.2), **shape)
    ends = []
    for solver in ({"name": "exact", "tolerance": 1e-12, "capture_m": 1e-12}, heyoka(1e-14)):
        plant = solved(solver, body)
        _, events = plant.advance(elliptic(plant), SECOND)
        ends.append(
            (plant.state[0], [(event.kind, event.cells) for event in events if "support" in event.kind])
        )
    assert len(ends[0][1]) > 10
    assert ends[1][0] == pytest.approx(ends[0][0], abs=1e-10)
    assert ends[1][1] == ends[0][1]


def test_loads_that_vanish_and_return_are_those_of_exact() -> None:
    draw = np.random.default_rng(21)
    cells = [(r, c) for r in range(14) for c in range(14)]
    holes = tuple(cells[i] for i in draw.choice(196, 70, replace=False))
    body = parcel(
        size_m=(0.7, 0.36), centre_of_mass_m=(0.2, 0.08), position_m=(0.1, 0.1), velocity_m_s=(-0.6, 0.1)
    )
    outcomes = []
    for solver in ({"name": "exact", "tolerance": 1e-12, "capture_m": 1e-12}, heyoka(1e-14)):
        plant = solved(solver, body, rows=14, columns=14, missing=holes)
        _, events = plant.advance(elliptic(plant), 700_000_000)
        outcomes.append((plant.state[0], events))
    assert {"load_vanished", "load_returned"} <= {event.kind for event in outcomes[0][1]}
    assert outcomes[1][0] == pytest.approx(outcomes[0][0], abs=1e-10)
    for one in outcomes[0][1]:
        same = [event for event in outcomes[1][1] if (event.kind, event.cells) == (one.kind, one.cells)]
        assert min(abs(event.time_s - one.time_s) for event in same) < 1e-9


def test_a_row_of_cells_that_enters_at_one_instant_enters_as_one() -> None:
    body = parcel(position_m=(0.0, 0.0), angle_rad=0.0, velocity_m_s=(0.3, 0.0))
    outcomes = []
    for solver in ({"name": "exact"}, heyoka()):
        plant = solved(solver, body)
        _, events = plant.advance(drive(plant, 0.3), SECOND)
        outcomes.append(sorted((event.kind, event.cells, round(event.time_s, 8)) for event in events))
    assert len(outcomes[0]) > 15
    assert outcomes[1] == outcomes[0]


@pytest.mark.parametrize("tick_ns", [62_500_000, 125_000_000, SECOND])
def test_cells_come_and_go_on_time_where_all_else_falls_on_the_same_instant(tick_ns: int) -> None:
    """Ends of calls, and the parcel's leaving of the place that it looked for cells from: at every second column."""
    body = parcel(size_m=(0.5, 0.4), position_m=(-1.0, 0.0), angle_rad=0.0, velocity_m_s=(0.5, 0.0))
    plant = solved(heyoka(), body, pitch_m=0.125, rows=4, columns=40)
    events = []
    for until in range(tick_ns, SECOND + 1, tick_ns):
        events += plant.advance(drive(plant, 0.5), until)[1]
    for kind in ("support_gained", "support_lost"):
        times = [event.time_s for event in events if event.kind == kind]
        assert times == pytest.approx(np.repeat([0.125, 0.375, 0.625, 0.875], 4), abs=1e-14)


@pytest.mark.parametrize("over_m", [1e-9, 1e-12])
def test_an_edge_that_hardly_passes_a_column_before_it_turns_back_gains_and_loses_it(over_m: float) -> None:
    """The two roots are no farther apart than heyoka itself, left to choose, would look away."""
    kappa = 0.2 * 9.81
    turn = np.sqrt(kappa * 2.0 - 0.25 * kappa**2)
    farthest = 0.3 * np.exp(-0.5 * kappa * np.pi / turn)
    body = parcel(size_m=(2.0 * (0.35 + over_m - farthest), 0.3), position_m=(-0.3, 0.0), angle_rad=0.0)
    plant = solved(heyoka(), body, rows=3)
    _, events = plant.advance(elliptic(plant, -2.0, -2.0), round(1.3 * np.pi / turn * SECOND))
    kinds = [event.kind for event in events if event.cells[0][1] == 13]
    assert kinds == ["support_gained"] * 3 + ["support_lost"] * 3


def test_rolling_is_that_of_implicit() -> None:
    body = parcel(position_m=(0.05, 0.03), angle_rad=0.4, velocity_m_s=(0.02, -0.01))
    ends = []
    for solver in (heyoka(), {"name": "implicit", "tolerance": 1e-8}):
        plant = solved(solver, body, law=ROLLING)
        _, events = plant.advance(elliptic(plant, -4.0, -8.0), SECOND // 5)
        ends.append((plant.state[0], [(event.kind, event.cells) for event in events]))
    assert ends[0][0] == pytest.approx(ends[1][0], abs=1e-7)
    assert ends[0][1] == ends[1][1]
    assert len(ends[0][1]) >= 2


def test_chatter_ends_as_support_changes_without_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(restarted, "CHANGES_PER_SECOND", 5)
    monkeypatch.setattr(restarted, "CHANGES_PER_MEMBER", 0)
    plant = solved(heyoka(), parcel(size_m=(0.68, 0.42), position_m=(0.0, 0.0), angle_rad=0.18))
    with pytest.raises(PlantUnstable, match="support changes without end, the last about cell"):
        plant.advance(elliptic(plant), 4 * SECOND)


def test_a_law_that_bends_is_refused() -> None:
    with pytest.raises(ValidationError, match="solves law viscous, rolling, not stick_slip"):
        solved({"name": "heyoka"}, law=STICK_SLIP)


def test_without_heyoka_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "heyoka", None)
    with pytest.raises(
        PlantError, match=r"heyoka is not installed; .* pip install 'mdms-emulator\[accuracy\]'"
    ):
        solved({"name": "heyoka"})
