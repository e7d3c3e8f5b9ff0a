"""Support changes at awkward instants: short, touching, simultaneous, on a boundary of steps or ticks."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import brentq

from plant.observations import Event
from plant.plant import Plant
from tests.plant.scenes import MU, SECOND, TICK_NS, G, cells_of, elliptic, parcel
from tests.stability.solvers import Claim, Solver, claiming

KAPPA = MU * G
CHANGES_OF_THE_STUDY = 86


def _names(events: list[Event]) -> list[tuple[str, tuple[tuple[int, int], ...]]]:
    return [(event.kind, event.cells) for event in events]


def _alternate(events: list[Event]) -> bool:
    """Whether no cell is gained twice or lost twice in a row."""
    last: dict[tuple[tuple[int, int], ...], str] = {}
    for event in events:
        if last.get(event.cells) == event.kind:
            return False
        last[event.cells] = event.kind
    return True


@claiming(Claim.EVENTS)
@pytest.mark.parametrize("tick_ns", [TICK_NS, 50_000_000, SECOND])
def test_a_corner_that_clips_a_cell_between_two_steps_is_seen_at_its_times(
    solver: Solver, tick_ns: int
) -> None:
    """H1, two crossings in one step: scipy #9228, diffrax #507, CyRK #98. SciPy loses this very pair."""
    plant = solver.plant(parcel())
    events: list[Event] = []
    for until in range(tick_ns, SECOND + tick_ns, tick_ns):
        events += plant.advance(elliptic(plant), until)[1]
    clipped = [event for event in events if cells_of(plant, event.cells) == [256]]
    assert [event.kind for event in clipped] == ["support_gained", "support_lost"]
    assert [event.time_s for event in clipped] == pytest.approx([0.8036, 0.8099], abs=1e-4)


@claiming(Claim.EVENTS)
@pytest.mark.parametrize("depth_m", [1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12])
def test_however_briefly_a_turning_corner_covers_a_cell_it_is_seen_in_and_out(
    solver: Solver, depth_m: float
) -> None:
    """H1, with closed-form times down to a stay of picoseconds; where sampling stops seeing is where it is refined."""
    events, cell = _sweep(solver, depth_m)
    half = np.array([0.27, np.sqrt((np.hypot(0.25, 0.15) + depth_m) ** 2 - 0.27**2)])
    far, azimuth = np.hypot(0.25, 0.15), np.arctan2(0.15, 0.25)
    gained, lost = azimuth - np.arcsin(half[1] / far), azimuth - np.arccos(half[0] / far)
    mine = [event for event in events if event.cells == (cell,)]
    assert [event.kind for event in mine] == ["support_gained", "support_lost"]
    assert [event.time_s for event in mine] == pytest.approx([gained, lost], abs=1e-13)
    if depth_m >= 1e-8:
        assert mine[1].time_s - mine[0].time_s == pytest.approx(lost - gained, rel=1e-6)


@claiming(Claim.EVENTS)
@pytest.mark.parametrize("depth_m", [-1e-12, -1e-9, -1e-6])
def test_a_turning_corner_that_passes_a_cell_without_covering_it_changes_nothing(
    solver: Solver, depth_m: float
) -> None:
    """H11, the other side of the graze: nothing may be reported that did not happen."""
    events, cell = _sweep(solver, depth_m)
    assert (cell,) not in {event.cells for event in events}


@claiming(Claim.EVENTS)
def test_a_corner_that_meets_a_cell_to_the_last_bit_leaves_it_as_it_was(solver: Solver) -> None:
    """H11, even multiplicity: LSODAR's manual says that such roots are "probably missed"; here rounding may decide."""
    events, cell = _sweep(solver, 0.0)
    mine = [event.kind for event in events if event.cells == (cell,)]
    assert mine in ([], ["support_gained", "support_lost"])
    assert len(events) >= 4


def _sweep(solver: Solver, depth_m: float) -> tuple[list[Event], tuple[int, int]]:
    """A parcel that turns at 1 rad/s on coasting wheels; a corner covers cell (11, 12) by ``depth_m``."""
    half = np.sqrt((np.hypot(0.25, 0.15) + depth_m) ** 2 - 0.27**2)
    body = parcel(size_m=(0.54, 2.0 * half), position_m=(0.0, 0.0), angle_rad=0.0, angular_velocity_rad_s=1.0)
    plant = solver.plant(body)
    plant.release_wheels(range(len(plant.array)), "coast")
    _, events = plant.advance(np.zeros((len(plant.array), 2)), 300_000_000)
    assert plant.state[0, 5] == pytest.approx(1.0, abs=1e-14)
    return events, (11, 12)


@claiming(Claim.EVENTS)
@pytest.mark.parametrize("overshoot_m", [1e-3, 1e-6, 1e-9, 1e-12])
def test_an_edge_that_turns_back_just_past_a_column_gains_and_loses_it(
    solver: Solver, overshoot_m: float
) -> None:
    """H11, grazing: the distance has two roots so close that it almost touches; chains of samples see neither."""
    events, peak = _turn_back(solver, overshoot_m)
    kinds = Counter(event.kind for event in events if event.cells[0][1] == 13)
    assert kinds == {"support_gained": 3, "support_lost": 3}
    gained, lost = (
        next(event.time_s for event in events if event.cells[0][1] == 13 and event.kind == kind)
        for kind in ("support_gained", "support_lost")
    )
    low = brentq(lambda t: _swing(t) - _swing(peak) + overshoot_m, 0.9 * peak, peak, xtol=1e-15)
    high = brentq(lambda t: _swing(t) - _swing(peak) + overshoot_m, peak, 1.2 * peak, xtol=1e-15)
    # near the turning point an error in place is its square root in time
    within = 1e-14 + 1e-14 / np.sqrt(overshoot_m)
    assert [gained, lost] == pytest.approx([low, high], abs=10.0 * within)


@claiming(Claim.EVENTS)
@pytest.mark.parametrize("shortfall_m", [1e-12, 1e-9, 1e-6])
def test_an_edge_that_turns_back_just_before_a_column_leaves_it(solver: Solver, shortfall_m: float) -> None:
    """H11, and the double root that is none."""
    events, _ = _turn_back(solver, -shortfall_m)
    assert 13 not in {event.cells[0][1] for event in events}


RATE, TURN = -0.5 * KAPPA, np.sqrt(KAPPA * 2.0 - 0.25 * KAPPA**2)
"""Of the damped swing ``x'' = kappa (-2 x - x')``."""


def _swing(t: float) -> float:
    """Where a parcel is at ``t`` that began at rest at -0.3 m in the field ``-2 x``."""
    return float(-0.3 * np.exp(RATE * t) * (np.cos(TURN * t) - RATE / TURN * np.sin(TURN * t)))


def _turn_back(solver: Solver, overshoot_m: float) -> tuple[list[Event], float]:
    """A swing whose leading edge goes ``overshoot_m`` past column 13 and back; its events until it has, and when."""
    peak = np.pi / TURN
    length = 2.0 * (0.35 + overshoot_m - _swing(peak))
    plant = solver.plant(parcel(size_m=(length, 0.3), position_m=(-0.3, 0.0), angle_rad=0.0), rows=3)
    _, events = plant.advance(elliptic(plant, -2.0, -2.0), round(1.3 * peak * SECOND))
    return events, peak


BINARY = {"pitch_m": 0.125, "rows": 4, "columns": 40}
"""Lengths that halves, quarters and eighths describe without rounding."""


def _carried(solver: Solver, x: float, speed: float = 0.5) -> tuple[Plant, np.ndarray]:
    """A parcel of 0.5 m that is carried along x at the wheels' own speed from ``x``, and its drives."""
    body = parcel(size_m=(0.5, 0.4), position_m=(x, 0.0), angle_rad=0.0, velocity_m_s=(speed, 0.0))
    plant = solver.plant(body, **BINARY)
    return plant, np.tile((speed, 0.0), (len(plant.array), 1))


@claiming(Claim.EVENTS)
@pytest.mark.parametrize("tick_ns", [62_500_000, 125_000_000, 250_000_000, 500_000_000, 4 * SECOND])
def test_crossings_exactly_on_the_ticks_happen_once_each(solver: Solver, tick_ns: int) -> None:
    """H2, event on a step's end: DifferentialEquations.jl #258, DiffEqBase #266, scipy #19418 and #17066."""
    plant, drives = _carried(solver, -1.0)
    events: list[Event] = []
    for until in range(tick_ns, 4 * SECOND + 1, tick_ns):
        events += plant.advance(drives, until)[1]
    # the leading edge is 1/16 m short of a column at the start, the trailing one 1/16 m past one: 4 columns a second
    expected = {0.125 + 0.25 * k for k in range(16)}
    for kind in ("support_gained", "support_lost"):
        times = Counter(round(event.time_s, 9) for event in events if event.kind == kind)
        assert times == dict.fromkeys(expected, 4)
    assert plant.state[0] == pytest.approx([1.0, 0.0, 0.0, 0.5, 0.0, 0.0], abs=1e-13)


@claiming(Claim.EVENTS)
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_a_start_with_cells_exactly_under_both_edges_loses_one_side_once(
    solver: Solver, direction: float
) -> None:
    """H2, value zero at the start: it must neither fire again nor hide what follows (DifferentialEquations.jl #258)."""
    plant, drives = _carried(solver, -0.0625, 0.5 * direction)
    _, events = plant.advance(drives, 240_000_000)
    assert {event.kind for event in events} == {"support_lost"}
    assert [event.time_s for event in events] == pytest.approx([0.0] * 4, abs=1e-12)
    behind = {event.cells[0][1] for event in events}
    _, events = plant.advance(drives, 260_000_000)
    assert Counter(event.kind for event in events) == {"support_gained": 4, "support_lost": 4}
    assert [event.time_s for event in events] == pytest.approx([0.25] * 8, abs=1e-12)
    gained = {event.cells[0][1] for event in events if event.kind == "support_gained"}
    assert gained == {column + (5 if direction > 0 else -5) for column in behind}


@claiming(Claim.EVENTS)
@pytest.mark.parametrize("pull", [0.5, -0.5])
def test_at_rest_with_cells_under_an_edge_the_first_motion_decides(solver: Solver, pull: float) -> None:
    """H2 and H3: value and rate are zero at the start, the sign is in the second derivative."""
    body = parcel(size_m=(0.5, 0.4), position_m=(-0.0625, 0.0), angle_rad=0.0)
    plant = solver.plant(body, **BINARY)
    still, drives = np.zeros((len(plant.array), 2)), np.tile((pull, 0.0), (len(plant.array), 1))
    events = []
    for tick in range(1, 6):
        events += plant.advance(still, tick * TICK_NS)[1]
    assert events == []
    for tick in range(6, 30):
        events += plant.advance(drives, tick * TICK_NS)[1]
    assert [event.kind for event in events] == ["support_lost"] * 4
    assert [event.time_s for event in events] == pytest.approx([5 * TICK_NS * 1e-9] * 4, abs=1e-6)


@claiming(Claim.EVENTS)
def test_stopping_a_nanosecond_before_and_after_every_event_changes_none(solver: Solver) -> None:
    """H3, root on the wrong side: DifferentialEquations.jl #551; in FMPy #730 a sensor flipped back after its event."""
    whole = solver.plant(parcel())
    _, planned = whole.advance(elliptic(whole), 10 * SECOND)
    assert len(planned) == CHANGES_OF_THE_STUDY
    broken = solver.plant(parcel())
    events: list[Event] = []
    for event in planned:
        before = int(event.time_s * SECOND)
        events += broken.advance(elliptic(broken), max(before, broken.time_ns))[1]
        sense, found = broken.advance(elliptic(broken), before + 1)
        events += found
        cell = cells_of(broken, event.cells)[0]
        assert sense.presence[cell, 0] == (event.kind == "support_gained")
    broken.advance(elliptic(broken), 10 * SECOND)
    assert _names(events) == _names(planned)
    assert _alternate(events)
    assert [event.time_s for event in events] == pytest.approx([e.time_s for e in planned], abs=1e-10)
    assert broken.state == pytest.approx(whole.state, abs=1e-10)


@claiming(Claim.EVENTS)
def test_a_row_gained_at_one_instant_is_one_change_and_the_symmetric_scene_stays_symmetric(
    solver: Solver,
) -> None:
    """H4, simultaneous events: DiffEqBase #837 and #889 hang or lose one, DifferentialEquations.jl #844 is late."""
    plant = solver.plant(parcel(position_m=(0.55, 0.0), angle_rad=0.0))
    trajectory = plant.trajectory(elliptic(plant), 10 * SECOND, TICK_NS)
    assert np.abs(trajectory.state[:, 0, [1, 2, 4, 5]]).max() <= 1e-12
    # rows 8 to 11 lie under the parcel: every column that comes or goes is these four cells, at one instant
    instants: dict[tuple[float, str], set[tuple[int, int]]] = {}
    for event in trajectory.events:
        instants.setdefault((round(event.time_s, 9), event.kind), set()).update(event.cells)
    assert len(instants) >= 10
    for cells in instants.values():
        assert {row for row, _ in cells} == {8, 9, 10, 11}
        assert len({column for _, column in cells}) == 1


@claiming(Claim.EVENTS, Claim.SYMMETRY)
@pytest.mark.parametrize("motion", ["diagonal", "turning"])
def test_four_sides_that_change_at_one_instant_stay_alike(solver: Solver, motion: str) -> None:
    """H4 on both axes at once: a square on the diagonal, and one that turns in a field of fourfold symmetry."""
    place = (0.4, 0.4) if motion == "diagonal" else (0.0, 0.0)
    spin = 0.0 if motion == "diagonal" else 3.0
    body = parcel(size_m=(0.36, 0.36), position_m=place, angle_rad=0.0, angular_velocity_rad_s=spin)
    plant = solver.plant(body)
    trajectory = plant.trajectory(elliptic(plant, -1.0, -1.0), 4 * SECOND, TICK_NS)
    x, y, theta = trajectory.state[:, 0, :3].T
    assert len(trajectory.events) >= 8
    if motion == "diagonal":
        assert np.abs(x - y).max() <= 1e-12
        assert np.abs(theta).max() <= 1e-12
    else:
        assert max(np.abs(x).max(), np.abs(y).max()) <= 1e-12
        together = Counter(round(event.time_s, 9) for event in trajectory.events)
        assert all(count % 4 == 0 for count in together.values())


@claiming(Claim.EVENTS)
@pytest.mark.parametrize("tick_ns", [1_000_000, TICK_NS, 50_000_000, 333_333_333])
def test_events_inside_a_tick_are_neither_lost_nor_moved_to_its_end(solver: Solver, tick_ns: int) -> None:
    """H20: OMSimulator #1609 made none of nine events, FMPy #331 moved them to the communication step."""
    whole, ticked = solver.plant(parcel()), solver.plant(parcel())
    _, planned = whole.advance(elliptic(whole), 10 * SECOND)
    events: list[Event] = []
    for until in [*range(tick_ns, 10 * SECOND, tick_ns), 10 * SECOND]:
        begun = ticked.time_ns * 1e-9
        _, found = ticked.advance(elliptic(ticked), until)
        assert all(begun <= event.time_s <= until * 1e-9 for event in found)
        events += found
    assert len(events) == CHANGES_OF_THE_STUDY
    assert _names(events) == _names(planned)
    assert [event.time_s for event in events] == pytest.approx([e.time_s for e in planned], abs=1e-9)
    assert all(a.time_s <= b.time_s for a, b in pairwise(events))
