"""Stable orientations sit where the support set changes: chatter there is captured, and ends right."""

from __future__ import annotations

import time

import numpy as np
import pytest
from scipy.optimize import brentq

import plant.solvers.exact as exact
from plant.errors import PlantError, PlantUnstable
from plant.plant import Plant
from tests.plant.scenes import SECOND, TICK_NS, elliptic, parcel, spec, study

PUBLISHED = {
    (0.68, 0.42): 0.17925400095,
    (0.72, 0.42): 0.149413822985,
    (0.40, 0.42): 1.125235075992,
}


def _resting_angles(size: tuple[float, float], cells: np.ndarray) -> np.ndarray:
    """Angles in (0, pi) at which some cell lies on an edge of a rectangle centred on the origin."""
    found = []
    for x, y in cells:
        for half, a, b in ((size[1] / 2.0, -x, y), (size[0] / 2.0, y, x)):

            def off(t: float, half: float = half, a: float = a, b: float = b) -> float:
                return abs(a * np.sin(t) + b * np.cos(t)) - half

            grid = np.linspace(0.0, np.pi, 400)
            values = [off(t) for t in grid]
            for low, high, left, right in zip(grid, grid[1:], values, values[1:], strict=False):
                if left * right < 0.0:
                    found.append(brentq(off, low, high, xtol=1e-14))
    return np.array(found)


@pytest.mark.parametrize("size", PUBLISHED)
def test_chatter_of_the_study_scene_is_captured_in_bounded_events_at_the_published_angle(
    size: tuple[float, float],
) -> None:
    plant = Plant(spec(parcel(size_m=size)))
    _, events = plant.advance(elliptic(plant), 20 * SECOND)
    assert plant.support_changes <= 1000
    assert "captured" in {event.kind for event in events}
    theta = plant.state[0, 2]
    assert theta == pytest.approx(PUBLISHED[size], abs=1e-6)
    roots = _resting_angles(size, plant.array.positions_m)
    assert np.min(np.abs(roots - theta % np.pi)) < 1e-6
    assert np.abs(plant.state[0, 3:]).max() < 1e-6


@pytest.mark.parametrize("size", PUBLISHED)
def test_chatter_is_captured_just_as_well_tick_by_tick(size: tuple[float, float]) -> None:
    plant = Plant(spec(parcel(size_m=size), tolerance=1e-9))
    _tick(plant, 14 * SECOND)
    assert plant.support_changes <= 1000
    plant.advance(elliptic(plant), 20 * SECOND)
    assert plant.state[0, 2] == pytest.approx(PUBLISHED[size], abs=1e-6)


def test_chatter_located_event_by_event_agrees_with_chatter_captured() -> None:
    located = study_of((0.68, 0.42), capture_m=1e-12)
    captured = study_of((0.68, 0.42), capture_m=1e-6)
    a = located.trajectory(elliptic(located), 12 * SECOND, 100_000_000)
    b = captured.trajectory(elliptic(captured), 12 * SECOND, 100_000_000)
    assert located.support_changes > captured.support_changes + 200
    # the angle by which a lever of 0.2 m moves the edge by capture_m
    assert np.abs(a.state[:, 0, 2] - b.state[:, 0, 2]).max() < 1e-6 / 0.2
    assert a.state[:, 0, :2] == pytest.approx(b.state[:, 0, :2], abs=1e-10)


def study_of(size: tuple[float, float], **settings: float) -> Plant:
    return Plant(spec(parcel(size_m=size), **settings))  # type: ignore[arg-type]


@pytest.mark.parametrize("capture_m", [1e-4, 1e-6, 1e-8])
def test_a_smaller_capture_ends_at_the_same_angle(capture_m: float) -> None:
    plant = study_of((0.68, 0.42), capture_m=capture_m)
    plant.advance(elliptic(plant), 20 * SECOND)
    assert plant.state[0, 2] == pytest.approx(PUBLISHED[0.68, 0.42], abs=max(1e-6, capture_m))


@pytest.mark.parametrize("width", [0.2, 0.26, 0.32, 0.38, 0.44, 0.56, 0.62])
@pytest.mark.parametrize("length", [0.4, 0.52, 0.64, 0.76, 0.88])
def test_ordinary_sizes_settle_in_bounded_events(length: float, width: float) -> None:
    plant = study_of((length, width))
    plant.advance(elliptic(plant), 20 * SECOND)
    assert plant.support_changes <= 2000
    assert np.all(np.isfinite(plant.state))
    assert np.abs(plant.state[0, :2]).max() < 1e-6


@pytest.mark.parametrize("field", [(-1.0, -2.0), (-1.0, -1.5), (-0.5, -0.7)])
@pytest.mark.parametrize("size", [(0.5, 0.3), (0.6, 0.3), (0.4, 0.3), (0.9, 0.7), (0.88, 0.5), (0.5, 0.5)])
def test_sizes_whose_edges_can_lie_on_whole_rows_of_cells_come_to_rest(
    size: tuple[float, float], field: tuple[float, float]
) -> None:
    """At rest every cell of a row, and those under the corners, sit on an edge: all surfaces at once."""
    plant = Plant(spec(parcel(size_m=size), tolerance=1e-9))
    plant.advance(elliptic(plant, *field), 100 * SECOND)
    assert plant.status[0].state in ("at_rest", "moving")
    assert np.abs(plant.state[0, :2]).max() < 1e-6
    assert np.abs(plant.state[0, 3:]).max() < 1e-3


def _round_scene(seed: int) -> tuple[Plant, np.ndarray] | None:
    """Numbers as people choose them: sizes, places and angles that put edges and corners onto whole rows of cells."""
    draw = np.random.default_rng(seed)
    rows, columns = (int(n) for n in draw.integers(6, 21, 2))
    body = parcel(
        size_m=tuple(draw.integers(2, 16, 2) * 0.05),
        position_m=tuple(draw.integers(-8, 9, 2) * 0.05),
        angle_rad=float(draw.choice([0.0, np.pi / 4.0, np.pi / 2.0, np.pi, 0.1, 0.5, 1.0])),
    )
    try:
        plant = Plant(spec(body, rows=rows, columns=columns, mu=float(draw.choice([0.1, 0.2, 0.5, 1.0]))))
    except PlantError:
        return None
    p, (a, b) = plant.array.positions_m, draw.choice([-0.5, -1.0, -2.0], 2)
    vortex = 0.5 * np.stack([-p[:, 1], p[:, 0]], axis=1)
    fields = [
        p * (a, b),
        np.stack([0.0 * p[:, 0], -0.2 * np.sign(p[:, 1])], axis=1),
        np.stack([-0.2 * np.sign(p[:, 0]), -0.1 * np.sign(p[:, 1])], axis=1),
        -0.2 * p / np.maximum(np.hypot(*p.T), 1e-12)[:, None],
        vortex,
        vortex + p * (a, b),
        np.tile(draw.choice([0.0, 0.1, -0.2], 2), (len(p), 1)),
    ]
    return plant, fields[int(draw.integers(len(fields)))]


@pytest.mark.parametrize("batch", range(6))
def test_scenes_in_round_numbers_never_escape(batch: int) -> None:
    ended = []
    for seed in range(40 * batch, 40 * batch + 40):
        scene = _round_scene(seed)
        if scene is not None:
            plant, drives = scene
            plant.advance(drives, 30 * SECOND)
            assert np.all(np.isfinite(plant.state))
            ended.append(plant.status[0].state)
    assert len(ended) > 20
    assert {"at_rest", "off_array"} <= set(ended)


def test_a_captured_parcel_whose_drives_turn_round_is_let_go() -> None:
    plant = study_of((0.68, 0.42))
    plant.advance(elliptic(plant), 20 * SECOND)
    rested = plant.state[0, 2]
    spin = 0.5 * np.stack([-plant.array.positions_m[:, 1], plant.array.positions_m[:, 0]], axis=1)
    plant.advance(elliptic(plant) + 5.0 * spin, 22 * SECOND)
    assert plant.state[0, 2] > rested + 0.5
    plant.advance(elliptic(plant), 50 * SECOND)
    roots = _resting_angles((0.68, 0.42), plant.array.positions_m)
    assert np.min(np.abs(roots - plant.state[0, 2] % np.pi)) < 1e-6
    assert np.abs(plant.state[0, 3:]).max() < 1e-6


def test_a_captured_parcel_carries_on_along_its_surface_as_if_chatter_had_no_amplitude() -> None:
    """Halving the capture must not change the motion by more than its amplitude explains."""
    coarse, fine = study_of((0.72, 0.42), capture_m=1e-5), study_of((0.72, 0.42), capture_m=1e-9)
    a = coarse.trajectory(elliptic(coarse), 20 * SECOND, 100_000_000).state[:, 0]
    b = fine.trajectory(elliptic(fine), 20 * SECOND, 100_000_000).state[:, 0]
    assert np.abs(a[:, :3] - b[:, :3]).max() < 1e-4
    assert a[:, :2] == pytest.approx(b[:, :2], abs=1e-10)


def _tick(plant: Plant, end_ns: int) -> None:
    for until in range(TICK_NS, end_ns, TICK_NS):
        plant.advance(elliptic(plant), until)


def _force_escape(monkeypatch: pytest.MonkeyPatch) -> None:
    """Chatter that is never captured, and a small allowance for it."""
    monkeypatch.setattr(exact, "EVENTS_PER_SECOND", 50)
    monkeypatch.setattr(exact, "EVENTS_PER_MEMBER", 0)


def test_chatter_that_escapes_stops_with_parcel_place_time_and_cell(monkeypatch: pytest.MonkeyPatch) -> None:
    _force_escape(monkeypatch)
    plant = study_of((0.68, 0.42), capture_m=1e-13)
    match = r"parcel 0 at t = \d+\.?\d* s, x = .* m, y = .* m: support changes without end, the last about cell \d+,\d+"
    with pytest.raises(PlantUnstable, match=match):
        plant.advance(elliptic(plant), 400 * SECOND)


def test_chatter_that_escapes_is_bounded_over_many_ticks_too(monkeypatch: pytest.MonkeyPatch) -> None:
    _force_escape(monkeypatch)
    plant = study_of((0.68, 0.42), capture_m=1e-13)
    with pytest.raises(PlantUnstable, match="support changes without end"):
        _tick(plant, 60 * SECOND)
    assert plant.support_changes < 60 * 60 * 2


def test_chatter_that_escapes_at_the_real_allowance_ends_within_seconds() -> None:
    plant = study_of((0.68, 0.42), capture_m=1e-14)
    begun = time.perf_counter()
    with pytest.raises(PlantUnstable, match="support changes without end"):
        plant.advance(elliptic(plant), 60 * SECOND)
    assert time.perf_counter() - begun < 30.0


def test_a_trajectory_of_the_study_scene_is_never_captured_before_it_chatters() -> None:
    plant = study()
    _, events = plant.advance(elliptic(plant), 10 * SECOND)
    assert "captured" not in {event.kind for event in events}
