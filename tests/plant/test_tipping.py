"""Tipping: a physical outcome with an edge, a time and a place; never a singular matrix."""

from __future__ import annotations

import numpy as np
import pytest

from plant.errors import PlantError
from plant.parcel_spec import ParcelSpec
from plant.plant import Event, Plant
from tests.plant.reference import least_norm_loads
from tests.plant.scenes import MU, SECOND, TICK_NS, G, bench, elliptic, members, parcel, spec

KAPPA = MU * G


def carried(distance: float, speed: float, start: float = 0.0) -> float:
    """Time at which a parcel has been carried ``distance`` by wheels at ``speed``; ``start`` is its own speed."""
    low, high = 0.0, 1e4
    for _ in range(200):
        middle = 0.5 * (low + high)
        travelled = speed * middle + (start - speed) * -np.expm1(-KAPPA * middle) / KAPPA
        low, high = (middle, high) if travelled < distance else (low, middle)
    return low


def _uniform(plant: Plant, vx: float, vy: float) -> np.ndarray:
    return np.tile((vx, vy), (len(plant.array), 1))


def _last(events: list[Event]) -> Event:
    (tip,) = [event for event in events if event.kind in ("tipped", "off_array")]
    assert tip is events[-1]
    return tip


@pytest.mark.parametrize("ticked", [False, True])
def test_a_parcel_carried_over_the_rim_leaves_as_its_centre_crosses_the_last_row(ticked: bool) -> None:
    plant = Plant(spec(parcel(size_m=(0.32, 0.28), position_m=(0.1, 0.2), angle_rad=0.1)))
    drives, events = _uniform(plant, 0.0, 0.5), []
    for until in range(TICK_NS, 4 * SECOND, TICK_NS) if ticked else [4 * SECOND]:
        events += plant.advance(drives, until)[1]
    tip = _last(events)
    assert tip.kind == "off_array"
    assert tip.time_s == pytest.approx(carried(0.75, 0.5), abs=1e-7)
    assert tip.position_m == pytest.approx((0.1, 0.95), abs=1e-7)
    assert {row for row, _ in tip.cells} == {19}
    assert tip.detail.startswith("about the line through cells 19,")
    status = plant.status[0]
    assert (status.state, status.time_s, status.detail) == ("off_array", tip.time_s, tip.detail)


@pytest.mark.parametrize(
    ("drive", "line"), [((0.5, 0.0), 0.95), ((-0.5, 0.0), -0.95), ((0.0, 0.5), 0.95), ((0.0, -0.5), -0.95)]
)
def test_every_side_of_the_array_can_be_left(drive: tuple[float, float], line: float) -> None:
    plant = Plant(spec(parcel(size_m=(0.32, 0.28), position_m=(0.01, -0.02), angle_rad=0.3)))
    _, events = plant.advance(_uniform(plant, *drive), 4 * SECOND)
    axis = 0 if drive[0] else 1
    tip = _last(events)
    assert tip.kind == "off_array"
    assert tip.position_m[axis] == pytest.approx(line, abs=1e-7)
    assert tip.time_s == pytest.approx(carried(abs(line - (0.01, -0.02)[axis]), 0.5), abs=1e-7)


def test_a_parcel_that_tipped_stays_where_it_tipped_and_carries_no_wheel() -> None:
    plant = Plant(spec(parcel(size_m=(0.32, 0.28), position_m=(0.1, 0.6), angle_rad=0.1)))
    plant.advance(_uniform(plant, 0.0, 0.5), 3 * SECOND)
    state, changes = plant.state, plant.support_changes
    assert plant.status[0].state == "off_array"
    assert np.all(state[0, 3:] == 0.0)
    sense, events = plant.advance(_uniform(plant, -1.0, -1.0), 9 * SECOND)
    assert np.array_equal(plant.state, state)
    assert events == []
    assert plant.support_changes == changes
    assert plant.status[0].time_s < 3.0
    trajectory = plant.trajectory(_uniform(plant, 1.0, 0.0), 10 * SECOND, SECOND // 4)
    assert np.all(trajectory.state == state)
    assert np.any(sense.presence)


def test_states_sampled_after_the_tip_stand_still_where_it_tipped() -> None:
    plant = Plant(spec(parcel(size_m=(0.32, 0.28), position_m=(0.1, 0.6), angle_rad=0.1)))
    trajectory = plant.trajectory(_uniform(plant, 0.0, 0.5), 3 * SECOND, 10_000_000)
    after = trajectory.time_ns * 1e-9 > plant.status[0].time_s
    assert 20 < int(after.sum()) < len(after) - 20
    assert np.all(trajectory.state[after] == plant.state)
    assert np.all(trajectory.state[~after][1:, 0, 4] > 0.0)


def test_over_a_hole_a_parcel_tips_about_the_holes_edge() -> None:
    hole = tuple((r, c) for r in range(6, 14) for c in range(8, 13))
    plant = Plant(spec(parcel(size_m=(0.3, 0.3), position_m=(-0.5, 0.02), angle_rad=0.0), missing=hole))
    _, events = plant.advance(_uniform(plant, 0.5, 0.0), 4 * SECOND)
    tip = _last(events)
    # the last column before the hole stands at (7 - 9.5) pitches
    assert tip.kind == "tipped"
    assert tip.position_m == pytest.approx((-0.25, 0.02), abs=1e-7)
    assert tip.time_s == pytest.approx(carried(0.25, 0.5), abs=1e-7)
    assert {column for _, column in tip.cells} == {7}
    assert plant.status[0].state == "tipped"
    assert plant.status[0].detail == tip.detail


def test_a_slanting_edge_of_supports_is_named_and_timed() -> None:
    """A triangle of three cells: the centre of mass leaves it across the slanting side."""
    cells = ((0, 0), (0, 1), (1, 0))
    body = parcel(size_m=(0.4, 0.4), position_m=(-0.03, -0.02), angle_rad=0.0)
    plant = Plant(spec(body, rows=2, columns=2, cells=cells))
    _, events = plant.advance(_uniform(plant, 0.2, 0.1), 2 * SECOND)
    tip = _last(events)
    # x + y grows from -0.05 to 0
    assert tip.time_s == pytest.approx(carried(0.05, 0.3), abs=1e-7)
    assert sum(tip.position_m) == pytest.approx(0.0, abs=1e-7)
    assert set(tip.cells) == {(0, 1), (1, 0)}
    assert tip.kind == "off_array"


def test_a_slanting_row_of_supports_is_left_sideways() -> None:
    diagonal = tuple((k, k) for k in range(7))
    body = parcel(size_m=(0.9, 0.05), position_m=(0.017, 0.017), angle_rad=np.pi / 4.0)
    plant = Plant(spec(body, rows=7, columns=7, cells=diagonal))
    _, events = plant.advance(_uniform(plant, 0.1, -0.1), SECOND)
    tip = _last(events)
    assert tip.time_s < 0.01
    assert set(tip.cells) == {(0, 0), (6, 6)}


@pytest.mark.parametrize("missing_above", [True, False])
def test_tipping_sideways_off_a_row_tests_the_side_it_tips_to(missing_above: bool) -> None:
    """Supports on one row, other rows on one side only: where the parcel falls decides its state."""
    rows = (0, 1) if missing_above else (1, 2)
    cells = tuple((r, c) for r in rows for c in range(5))
    body = parcel(size_m=(0.45, 0.05), position_m=(0.01, 0.0), angle_rad=0.0)
    for direction in (0.2, -0.2):
        plant = Plant(spec(body, rows=3, columns=5, cells=cells))
        _, events = plant.advance(_uniform(plant, 0.0, direction), SECOND)
        lands = (direction < 0.0) == missing_above
        assert _last(events).kind == ("tipped" if lands else "off_array")
        assert {row for row, _ in _last(events).cells} == {1}


def test_a_parcel_is_carried_along_a_single_row_to_its_end() -> None:
    body = parcel(size_m=(0.45, 0.05), position_m=(-0.3, 0.0), angle_rad=0.0)
    plant = Plant(spec(body, rows=1, columns=12))
    start = plant.state[0]
    reference = bench(plant, _uniform(plant, 0.3, 0.0))
    _, events = plant.advance(_uniform(plant, 0.3, 0.0), 5 * SECOND)
    tip = _last(events)
    assert tip.kind == "off_array"
    assert tip.cells == ((0, 11),)
    assert tip.detail == "about cell 0,11"
    assert tip.time_s == pytest.approx(carried(0.85, 0.3), abs=1e-7)
    assert tip.position_m == pytest.approx((0.55, 0.0), abs=1e-7)
    expected = reference.run(start, 1.5)
    fresh = Plant(spec(body, rows=1, columns=12))
    fresh.advance(_uniform(fresh, 0.3, 0.0), 1_500_000_000)
    assert fresh.state[0] == pytest.approx(expected, abs=1e-10)


def test_two_cells_carry_a_parcel_until_its_centre_passes_one_of_them() -> None:
    plant = Plant(spec(parcel(size_m=(0.3, 0.05), position_m=(0.0, 0.0), angle_rad=0.0), rows=1, columns=2))
    _, events = plant.advance(_uniform(plant, 0.2, 0.0), 2 * SECOND)
    tip = _last(events)
    assert (tip.kind, tip.cells) == ("off_array", ((0, 1),))
    assert tip.time_s == pytest.approx(carried(0.05, 0.2), abs=1e-7)


def test_an_edge_of_the_parcel_that_slides_along_rows_of_cells_keeps_them_on_both_sides() -> None:
    """Width a whole number of pitches: two rows lie exactly on its edges all the way."""
    body = parcel(size_m=(0.31, 0.2), position_m=(-0.5, 0.0), angle_rad=0.0)
    plant = Plant(spec(body, rows=3, columns=20))
    plant.advance(_uniform(plant, 0.3, 0.0), 2 * SECOND)
    assert plant.status[0].state == "moving"
    assert plant.state[0, [1, 2, 4, 5]] == pytest.approx(np.zeros(4), abs=1e-15)
    assert len(members(plant)) % 3 == 0


def test_a_parcel_standing_on_two_rows_under_its_edges_gains_the_cells_ahead() -> None:
    """Only while rounding leaves it straight, which is not for long: nothing holds it so."""
    body = parcel(size_m=(0.31, 0.1), position_m=(-0.5, 0.0), angle_rad=0.0)
    plant = Plant(spec(body, rows=2, columns=20))
    _, events = plant.advance(_uniform(plant, 0.3, 0.0), SECOND)
    assert plant.status[0].state == "moving"
    gained = [cells for event in events if event.kind == "support_gained" for cells in event.cells]
    assert sorted(gained) == [(0, 7), (1, 7)]


@pytest.mark.parametrize(
    ("body", "array", "text"),
    [
        (parcel(position_m=(5.0, 0.0)), {}, "stands on nothing: no cell's centre lies under it"),
        (
            parcel(size_m=(0.05, 0.05), position_m=(0.0, 0.0)),
            {},
            "stands on nothing: no cell's centre lies under it",
        ),
        (parcel(position_m=(1.0, 0.0), angle_rad=0.0), {}, "would tip: its centre of mass lies outside the"),
        (parcel(size_m=(0.05, 0.05), position_m=(0.06, 0.06)), {}, "would tip"),
    ],
)
def test_a_parcel_that_cannot_stand_at_the_start_is_refused(
    body: ParcelSpec, array: dict[str, object], text: str
) -> None:
    with pytest.raises(PlantError, match=r"parcels\[0\]\.position_m = \[.*\]: the parcel") as refusal:
        Plant(spec(body, **array))  # type: ignore[arg-type]
    assert text in str(refusal.value)


def test_the_refused_parcel_is_named_among_several() -> None:
    with pytest.raises(
        PlantError, match=r"parcels\[1\]\.position_m = \[7, 0\]: the parcel stands on nothing"
    ):
        Plant(spec(parcel(), parcel(position_m=(7.0, 0.0))))


def test_other_parcels_go_on_when_one_tips() -> None:
    falling = parcel(size_m=(0.32, 0.28), position_m=(0.7, -0.6), angle_rad=0.1)
    staying = parcel(size_m=(0.32, 0.28), position_m=(-0.5, 0.4), angle_rad=0.1)
    both, alone = Plant(spec(falling, staying)), Plant(spec(staying))
    for plant in (both, alone):
        plant.advance(_uniform(plant, 0.3, 0.0), 2 * SECOND)
    assert [status.state for status in both.status] == ["off_array", "moving"]
    assert np.array_equal(both.state[1], alone.state[0])


def test_random_drives_tip_parcels_exactly_where_the_loads_end() -> None:
    """Whenever a parcel tips there are no loads that balance it any more, and a moment before there were."""
    draw = np.random.default_rng(14)
    cells = [(r, c) for r in range(10) for c in range(10)]
    tips = 0
    for _ in range(60):
        holes = tuple(cells[i] for i in draw.choice(100, int(draw.integers(0, 45)), replace=False))
        body = parcel(
            size_m=tuple(draw.uniform(0.2, 0.5, 2)),
            position_m=tuple(draw.uniform(-0.2, 0.2, 2)),
            angle_rad=float(draw.uniform(-3.0, 3.0)),
        )
        try:
            plant = Plant(spec(body, rows=10, columns=10, missing=holes))
        except PlantError:
            continue
        angle = float(draw.uniform(-3.0, 3.0))
        drives = _uniform(plant, 0.6 * np.cos(angle), 0.6 * np.sin(angle))
        trajectory = plant.trajectory(drives, 3 * SECOND, 1_000_000)
        if plant.status[0].state not in ("tipped", "off_array"):
            continue
        tips += 1
        outward = 1e-7 * np.array([np.cos(angle), np.sin(angle)])
        under = plant.array.positions_m[members(plant)]
        place = plant.state[0, :2]
        assert len(under) == 0 or least_norm_loads(under, place + outward) is None
        before = trajectory.state[trajectory.time_ns * 1e-9 < plant.status[0].time_s][-1, 0]
        stood = bench(plant, drives).under(before)
        assert least_norm_loads(plant.array.positions_m[stood], before[:2]) is not None
    assert tips > 25


def test_the_study_scene_never_tips() -> None:
    plant = Plant(spec(parcel()))
    plant.advance(elliptic(plant), 60 * SECOND)
    assert plant.status[0].state in ("moving", "at_rest")
