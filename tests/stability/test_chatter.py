"""H5 and H6: stable orientations sit where the support set changes; chatter there is captured, and ends right.

OpenModelica #10387, #8461, #11006 and #12190 (four lines that chatter); Simulink stops after 1,000 crossings in a row.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import brentq

import plant.solvers.exact as exact
from plant.errors import PlantError, PlantUnstable
from plant.observations import Event
from plant.plant import Plant
from tests.plant.scenes import SECOND, TICK_NS, elliptic, parcel
from tests.stability.solvers import SOLVERS, Claim, Solver, claiming

PUBLISHED = {
    (0.68, 0.42): 0.17925400095,
    (0.72, 0.42): 0.149413822985,
    (0.40, 0.42): 1.125235075992,
}
MOST_CHANGES = 1_000
"""In 20 s; locating every crossing takes up to half a million."""
SIZES = [
    (2.0 * float(a), 2.0 * float(b)) for a in np.linspace(0.21, 0.37, 9) for b in np.linspace(0.19, 0.23, 5)
]
FIELDS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "elliptic": lambda p: p * (-1.0, -2.0),
    "squeeze": lambda p: np.stack([0.0 * p[:, 0], -0.3 * np.sign(p[:, 1])], axis=1),
    "vortex": lambda p: np.stack([-p[:, 0] - 0.8 * p[:, 1], 0.8 * p[:, 0] - 2.0 * p[:, 1]], axis=1),
    "cubic": lambda p: -4.0 * p * np.sum(p * p, axis=1, keepdims=True) * (1.0, 2.0),
}


def _sized(solver: Solver, size: tuple[float, float], **settings: float) -> Plant:
    """The study scene with a parcel of this size."""
    return solver.plant(parcel(size_m=size), solver=settings)


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


def _beside(plant: Plant, size: tuple[float, float]) -> float:
    """How far the plant's angle is from the nearest at which a cell near the parcel lies on its edge."""
    cells = plant.array.positions_m
    near = cells[np.hypot(*cells.T) <= np.hypot(*size) / 2.0]
    theta = float(plant.state[0, 2])
    return float(np.min(np.abs((_resting_angles(size, near) - theta + 0.5 * np.pi) % np.pi - 0.5 * np.pi)))


def _ends_captured(events: list[Event]) -> bool:
    """Whether the last capture was not followed by its release."""
    last = [event.kind for event in events if event.kind in ("captured", "released")]
    return bool(last) and last[-1] == "captured"


@claiming(Claim.CHATTER)
@pytest.mark.parametrize("size", PUBLISHED)
def test_chatter_of_the_study_scene_is_captured_in_bounded_events_at_the_published_angle(
    solver: Solver, size: tuple[float, float]
) -> None:
    plant = _sized(solver, size)
    _, events = plant.advance(elliptic(plant), 20 * SECOND)
    assert plant.support_changes <= MOST_CHANGES
    assert "captured" in {event.kind for event in events}
    assert plant.state[0, 2] == pytest.approx(PUBLISHED[size], abs=1e-6)
    assert _beside(plant, size) < 1e-6
    assert np.abs(plant.state[0, 3:]).max() < 1e-6


@claiming(Claim.CHATTER)
@pytest.mark.parametrize("size", PUBLISHED)
def test_chatter_is_captured_just_as_well_tick_by_tick(solver: Solver, size: tuple[float, float]) -> None:
    plant = _sized(solver, size, tolerance=1e-9)
    _tick(plant, 14 * SECOND)
    assert plant.support_changes <= MOST_CHANGES
    plant.advance(elliptic(plant), 20 * SECOND)
    assert plant.state[0, 2] == pytest.approx(PUBLISHED[size], abs=1e-6)


@pytest.mark.slow
@claiming(Claim.CHATTER)
@pytest.mark.parametrize("start", ["study", "centre"])
@pytest.mark.parametrize("field", FIELDS)
def test_every_size_of_the_sweep_settles_in_a_thousand_changes_where_its_chatter_has_its_limit(
    solver: Solver, field: str, start: str
) -> None:
    """45 sizes, a quarter of which chatter in the elliptic field; their crossings' number grows exponentially."""
    ended = 0
    for size in SIZES:
        place = (0.0, 0.0) if start == "centre" else (0.55, 0.5)
        plant = solver.plant(parcel(size_m=size, position_m=place))
        _, events = plant.advance(FIELDS[field](plant.array.positions_m), 20 * SECOND)
        assert plant.support_changes <= MOST_CHANGES, size
        assert np.all(np.isfinite(plant.state)), size
        at_rest = np.abs(plant.state[0, [0, 1, 3, 4, 5]]).max() < 1e-7
        if at_rest and _ends_captured(events):
            ended += 1
            assert _beside(plant, size) < 1e-6, size
    assert ended >= (8 if field == "elliptic" else 0)


@claiming(Claim.CHATTER)
@pytest.mark.parametrize("width", [0.2, 0.26, 0.32, 0.38, 0.44, 0.56, 0.62])
@pytest.mark.parametrize("length", [0.4, 0.52, 0.64, 0.76, 0.88])
def test_sizes_far_from_those_of_the_sweep_settle_too(solver: Solver, length: float, width: float) -> None:
    plant = _sized(solver, (length, width))
    plant.advance(elliptic(plant), 20 * SECOND)
    assert plant.support_changes <= 2 * MOST_CHANGES
    assert np.abs(plant.state[0, :2]).max() < 1e-6


@claiming(Claim.CHATTER)
def test_chatter_located_event_by_event_agrees_with_chatter_captured(solver: Solver) -> None:
    located = _sized(solver, (0.68, 0.42), capture_m=1e-12)
    captured = _sized(solver, (0.68, 0.42), capture_m=1e-6)
    a = located.trajectory(elliptic(located), 12 * SECOND, 100_000_000)
    b = captured.trajectory(elliptic(captured), 12 * SECOND, 100_000_000)
    assert located.support_changes > captured.support_changes + 200
    # the angle by which a lever of 0.2 m moves the edge by capture_m
    assert np.abs(a.state[:, 0, 2] - b.state[:, 0, 2]).max() < 1e-6 / 0.2
    assert a.state[:, 0, :2] == pytest.approx(b.state[:, 0, :2], abs=1e-10)


@claiming(Claim.CHATTER)
@pytest.mark.parametrize("capture_m", [1e-4, 1e-6, 1e-8])
def test_a_smaller_capture_ends_at_the_same_angle(solver: Solver, capture_m: float) -> None:
    plant = _sized(solver, (0.68, 0.42), capture_m=capture_m)
    plant.advance(elliptic(plant), 20 * SECOND)
    assert plant.state[0, 2] == pytest.approx(PUBLISHED[0.68, 0.42], abs=max(1e-6, capture_m))


@claiming(Claim.CHATTER)
@pytest.mark.parametrize("field", [(-1.0, -2.0), (-1.0, -1.5), (-0.5, -0.7)])
@pytest.mark.parametrize("size", [(0.5, 0.3), (0.6, 0.3), (0.4, 0.3), (0.9, 0.7), (0.88, 0.5), (0.5, 0.5)])
def test_sizes_whose_edges_can_lie_on_whole_rows_of_cells_come_to_rest(
    solver: Solver, size: tuple[float, float], field: tuple[float, float]
) -> None:
    """At rest every cell of a row, and those under the corners, sit on an edge: all surfaces at once."""
    plant = _sized(solver, size, tolerance=1e-9)
    plant.advance(elliptic(plant, *field), 100 * SECOND)
    assert plant.status[0].state in ("at_rest", "moving")
    assert np.abs(plant.state[0, :2]).max() < 1e-6
    assert np.abs(plant.state[0, 3:]).max() < 1e-3


def _round_scene(solver: Solver, seed: int) -> tuple[Plant, np.ndarray] | None:
    """Numbers as people choose them: sizes, places and angles that put edges and corners onto whole rows of cells."""
    draw = np.random.default_rng(seed)
    rows, columns = (int(n) for n in draw.integers(6, 21, 2))
    body = parcel(
        size_m=tuple(draw.integers(2, 16, 2) * 0.05),
        position_m=tuple(draw.integers(-8, 9, 2) * 0.05),
        angle_rad=float(draw.choice([0.0, np.pi / 4.0, np.pi / 2.0, np.pi, 0.1, 0.5, 1.0])),
    )
    mu = float(draw.choice([0.1, 0.2, 0.5, 1.0]))
    try:
        plant = solver.plant(body, rows=rows, columns=columns, mu=mu)
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


@claiming(Claim.CHATTER)
@pytest.mark.parametrize("batch", range(6))
def test_scenes_in_round_numbers_never_escape(solver: Solver, batch: int) -> None:
    ended = []
    for seed in range(40 * batch, 40 * batch + 40):
        scene = _round_scene(solver, seed)
        if scene is not None:
            plant, drives = scene
            plant.advance(drives, 30 * SECOND)
            assert np.all(np.isfinite(plant.state))
            ended.append(plant.status[0].state)
    assert len(ended) > 20
    assert {"at_rest", "off_array"} <= set(ended)


@claiming(Claim.CHATTER)
def test_a_captured_parcel_whose_drives_turn_round_is_let_go(solver: Solver) -> None:
    plant = _sized(solver, (0.68, 0.42))
    plant.advance(elliptic(plant), 20 * SECOND)
    rested = plant.state[0, 2]
    spin = 0.5 * np.stack([-plant.array.positions_m[:, 1], plant.array.positions_m[:, 0]], axis=1)
    plant.advance(elliptic(plant) + 5.0 * spin, 22 * SECOND)
    assert plant.state[0, 2] > rested + 0.5
    plant.advance(elliptic(plant), 50 * SECOND)
    assert _beside(plant, (0.68, 0.42)) < 1e-6
    assert np.abs(plant.state[0, 3:]).max() < 1e-6


@claiming(Claim.CHATTER)
def test_a_captured_parcel_carries_on_along_its_surface_as_if_chatter_had_no_amplitude(
    solver: Solver,
) -> None:
    """Halving the capture must not change the motion by more than its amplitude explains."""
    coarse, fine = (_sized(solver, (0.72, 0.42), capture_m=size) for size in (1e-5, 1e-9))
    a = coarse.trajectory(elliptic(coarse), 20 * SECOND, 100_000_000).state[:, 0]
    b = fine.trajectory(elliptic(fine), 20 * SECOND, 100_000_000).state[:, 0]
    assert np.abs(a[:, :3] - b[:, :3]).max() < 1e-4
    assert a[:, :2] == pytest.approx(b[:, :2], abs=1e-10)


@claiming(Claim.CHATTER)
def test_a_trajectory_of_the_study_scene_is_never_captured_before_it_chatters(solver: Solver) -> None:
    plant = solver.plant(parcel())
    _, events = plant.advance(elliptic(plant), 10 * SECOND)
    assert "captured" not in {event.kind for event in events}


def _tick(plant: Plant, end_ns: int) -> None:
    for until in range(TICK_NS, end_ns, TICK_NS):
        plant.advance(elliptic(plant), until)


def _escaping(capture_m: float) -> Plant:
    """Chatter that is never captured, with the solver that counts its crossings."""
    return _sized(SOLVERS["exact"], (0.68, 0.42), capture_m=capture_m)


def _allow_little(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exact, "EVENTS_PER_SECOND", 50)
    monkeypatch.setattr(exact, "EVENTS_PER_MEMBER", 0)


def test_chatter_that_escapes_stops_with_parcel_place_time_and_cell(monkeypatch: pytest.MonkeyPatch) -> None:
    _allow_little(monkeypatch)
    plant = _escaping(1e-13)
    match = r"parcel 0 at t = \d+\.?\d* s, x = .* m, y = .* m: support changes without end, the last about cell \d+,\d+"
    with pytest.raises(PlantUnstable, match=match):
        plant.advance(elliptic(plant), 400 * SECOND)


def test_chatter_that_escapes_is_bounded_over_many_ticks_too(monkeypatch: pytest.MonkeyPatch) -> None:
    _allow_little(monkeypatch)
    plant = _escaping(1e-13)
    with pytest.raises(PlantUnstable, match="support changes without end"):
        _tick(plant, 60 * SECOND)
    assert plant.support_changes < 60 * 60 * 2


@pytest.mark.slow
def test_chatter_that_escapes_at_the_real_allowance_ends_within_seconds() -> None:
    plant = _escaping(1e-14)
    begun = time.perf_counter()
    with pytest.raises(PlantUnstable, match="support changes without end"):
        plant.advance(elliptic(plant), 60 * SECOND)
    assert time.perf_counter() - begun < 30.0
