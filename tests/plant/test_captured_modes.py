"""Captured chatter where supports lift: each side of the surface has loads of its own, and their motions mix."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import root

from plant.kernels.common import layout
from plant.plant import Plant
from tests.plant.reference import Bench
from tests.plant.scenes import SECOND, Floats, bench, elliptic, members, parcel, spec

SCENES: dict[str, dict[str, Any]] = {
    "seven": {"holes": (3, 5, 7), "size": (0.32, 0.28), "centre": (0.03, 0.06), "at": (0.1, 0.05, 2.1)},
    "five": {"holes": (1, 2, 5), "size": (0.44, 0.48), "centre": (0.0, -0.12), "at": (0.1, 0.2, 1.9)},
    "other five": {
        "holes": (1, 4, 5),
        "size": (0.48, 0.32),
        "centre": (-0.09, 0.03),
        "at": (-0.15, -0.15, 1.9),
    },
    "two edges": {"holes": (5, 2, 5), "size": (0.44, 0.44), "centre": (0.06, -0.03), "at": (0.05, 0.05, 0.6)},
    "three edges": {
        "holes": (4, 1, 5),
        "size": (0.36, 0.36),
        "centre": (-0.03, 0.03),
        "at": (-0.1, -0.05, 1.0),
    },
    "one side unloads": {
        "holes": (5, 4, 5),
        "size": (0.38, 0.44),
        "centre": (-0.09, 0.06),
        "at": (-0.2, -0.1, 2.5),
    },
}
"""Parcels with their weight off the centre on arrays with holes: a corner often stands clear of its cells."""
ONE_EDGE = ("seven", "five", "other five")


def _scene(name: str, capture_m: float, tolerance: float = 1e-11) -> tuple[Plant, Floats]:
    """A plant with a cell missing wherever ``row_step * row + column_step * column`` is a multiple of ``every``."""
    scene = SCENES[name]
    row_step, column_step, every = scene["holes"]
    missing = [
        (r, c) for r, c in product(range(20), repeat=2) if (row_step * r + column_step * c) % every == 0
    ]
    x, y, angle = scene["at"]
    body = parcel(size_m=scene["size"], centre_of_mass_m=scene["centre"], position_m=(x, y), angle_rad=angle)
    plant = Plant(spec(body, mu=0.5, tolerance=tolerance, capture_m=capture_m, missing=missing))
    return plant, -np.sign(plant.array.positions_m) * (0.3, 0.5)


@pytest.mark.parametrize("name", ONE_EDGE)
def test_a_smaller_capture_comes_nearer_to_chatter_followed_crossing_by_crossing(name: str) -> None:
    runs = {}
    for capture_m in (1e-5, 1e-6, 1e-8):
        plant, drives = _scene(name, capture_m)
        runs[capture_m] = plant.trajectory(drives, 6 * SECOND, 20_000_000).state[:, 0, :3]
    assert np.abs(runs[1e-5] - runs[1e-8]).max() < 1e-4
    assert np.abs(runs[1e-6] - runs[1e-8]).max() < 1e-5


def _by_hand(
    reference: Bench, y: Floats, listed: NDArray[np.int64], groups: int
) -> tuple[Floats, Floats, list[int]]:
    """Acceleration along the captured surfaces, from the loads of each side as SciPy finds them.

    Returns (acceleration, the groups' fractions, how many cells carry load in each mode).
    """
    side, group, cell = listed[:, layout.SIDE], listed[:, layout.GROUP], listed[:, layout.CELL]
    modes = list(product((False, True), repeat=groups))
    rates, carrying = {}, []
    for mode in modes:
        far = np.array([mode[h] for h in group % max(groups, 1)])
        under = np.sort(cell[(side == 0) | ((side > 0) == far)])
        loaded = reference.contact(y, under)
        assert loaded is not None
        rates[mode] = reference.rates(0.0, y, loaded)[3:]
        carrying.append(len(under) - len(loaded))

    def second(acceleration: Floats, h: int) -> float:
        """Second rate of the group's first cell's distance inside its edge, by differences."""
        first = cell[(side != 0) & (group == h)][0]
        step = 1e-4
        there = [
            reference.depth(
                np.concatenate([y[:3] + y[3:] * t + 0.5 * acceleration * t * t, y[3:]]),
                reference.cells[[first]],
            )[0]
            for t in (-step, 0.0, step)
        ]
        return (there[0] - 2.0 * there[1] + there[2]) / step**2

    seconds = {mode: np.array([second(a, h) for h in range(groups)]) for mode, a in rates.items()}

    def mixed(values: dict[tuple[bool, ...], Floats], fraction: Floats) -> Floats:
        return sum(
            np.prod([f if far else 1.0 - f for f, far in zip(fraction, mode, strict=True)]) * values[mode]
            for mode in modes
        )  # type: ignore[return-value]

    found = root(lambda f: mixed(seconds, f), np.full(groups, 0.5), tol=1e-14)
    return mixed(rates, found.x), found.x, carrying


@pytest.mark.parametrize(
    ("name", "groups_seen"), [*((name, 1) for name in ONE_EDGE), ("two edges", 2), ("three edges", 3)]
)
def test_captured_motion_is_the_mixture_of_its_sides_each_with_its_own_loads(
    name: str, groups_seen: int
) -> None:
    plant, drives = _scene(name, 1e-6)
    reference, inner = bench(plant, drives, mu=0.5), plant._solver.parcels[0]
    compared, lifted_on_one_side = {1: 0, 2: 0, 3: 0}, 0
    for tick in range(1, 1200):
        now = tick * 5_000_000
        plant.advance(drives, now)
        groups, events = int(inner.ctl[layout.N_GROUPS]), int(inner.ctl[layout.N_EVENTS])
        if groups == 0:
            continue
        listed, y = inner.mem[: inner.ctl[layout.N_MEMBERS]].copy(), plant.state[0]
        h = 10_000
        velocity = [y[3:]]
        for k in (1, 2):
            plant.advance(drives, now + k * h)
            velocity.append(plant.state[0, 3:])
        if int(inner.ctl[layout.N_EVENTS]) != events or int(inner.ctl[layout.N_GROUPS]) != groups:
            continue
        measured = (-3.0 * velocity[0] + 4.0 * velocity[1] - velocity[2]) / (2.0 * h * 1e-9)
        expected, fraction, clear = _by_hand(reference, y, listed, groups)
        assert measured == pytest.approx(expected, abs=2e-5 * (1.0 + np.abs(expected).max()))
        assert np.all(fraction > -1e-6)
        assert np.all(fraction < 1.0 + 1e-6)
        compared[groups] += 1
        lifted_on_one_side += len(set(clear)) > 1
    assert compared[groups_seen] > 10
    assert lifted_on_one_side > 10 or name == "three edges"


@pytest.mark.parametrize(
    ("name", "captured_ms", "spin"),
    [("other five", 4360, 0.0), ("two edges", 4020, 0.0), ("one side unloads", 6000, 0.3)],
)
def test_captured_motion_is_the_same_in_one_go_and_in_short_ticks(
    name: str, captured_ms: int, spin: float
) -> None:
    """Between ticks fractions change, and loads of either side vanish: nothing of that waits for the next look."""
    ends = []
    for tick_ms in (2000, 10):
        plant, drives = _scene(name, 1e-6)
        plant.advance(drives, captured_ms * 1_000_000)
        groups = int(plant._solver.parcels[0].ctl[layout.N_GROUPS])
        drives = drives + plant.array.positions_m @ np.array([[0.0, spin], [-spin, 0.0]])
        for until in range(captured_ms + tick_ms, captured_ms + 2001, tick_ms):
            plant.advance(drives, until * 1_000_000)
        assert groups == plant._solver.parcels[0].ctl[layout.N_GROUPS] > 0
        ends.append(plant.state)
    assert ends[0] == pytest.approx(ends[1], abs=1e-11)


@pytest.mark.parametrize("spin", [0.2, -0.2])
@pytest.mark.parametrize("size", [(0.68, 0.42), (0.72, 0.42), (0.4, 0.42)])
def test_a_capture_that_new_drives_end_is_let_go_to_the_side_on_which_the_parcel_goes_on(
    size: tuple[float, float], spin: float
) -> None:
    """On the other side the cell would have to cross its edge, back, at the very instant."""
    plant = Plant(spec(parcel(size_m=size)))
    plant.advance(elliptic(plant), 20 * SECOND)
    inner = plant._solver.parcels[0]
    listed = inner.mem[: inner.ctl[layout.N_MEMBERS]]
    held = [plant.array.lattice.cells[i] for i in listed[listed[:, layout.SIDE] != 0, layout.CELL]]
    assert held
    # faint enough that the cell's own pull keeps its sense, strong enough to leave it behind
    turning = plant.array.positions_m @ np.array([[0.0, spin], [-spin, 0.0]])
    _, events = plant.advance(elliptic(plant) + turning, 20 * SECOND + 2_000_000)
    assert inner.ctl[layout.N_GROUPS] == 0
    assert np.sign(plant.state[0, 5]) == np.sign(spin)
    if len(held) == 1:
        # of a pair that has merged but for nanometres one cell may have to be put right
        assert [event for event in events if event.cells[0] in held and event.kind != "released"] == []
    assert members(plant).tolist() == bench(plant, turning).under(plant.state[0]).tolist()


@pytest.mark.parametrize("size", [(0.46, 0.38), (0.5, 0.4)])
def test_a_pair_that_reaches_its_edges_all_but_together_is_captured_together(
    size: tuple[float, float],
) -> None:
    """Opposite cells of a parcel that centres itself: with one over its edge and the other not, neither side shows."""
    plant = Plant(spec(parcel(size_m=size)))
    plant.advance(elliptic(plant), 16 * SECOND)
    inner = plant._solver.parcels[0]
    listed = inner.mem[: inner.ctl[layout.N_MEMBERS]]
    rows = listed[listed[:, layout.SIDE] != 0]
    assert len(rows) == 2
    assert inner.ctl[layout.N_GROUPS] == 1
    # X and the cells' mean distance from their edges are what chatter of this amplitude leaves open
    depths = bench(plant, elliptic(plant)).depth(
        plant.state[0], plant.array.positions_m[rows[:, layout.CELL]]
    )
    assert abs(depths).max() < 1e-6
    assert plant.support_changes < 300
