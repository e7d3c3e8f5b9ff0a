"""Queues and blocks of boxes that belts press against rails: they come to rest, and nothing overlaps."""

from __future__ import annotations

import numpy as np
import pytest

from plant.parcel_spec import ParcelSpec
from plant.plant import Plant
from tests.plant.effects.parcel_contact.benches import BOX, box, least_gap, plant, ticks

WIDE = 0.9
"""Place of the rails, m."""
SPEED = 0.3
"""Of the belts, m/s."""


def pressed(boxes: tuple[ParcelSpec, ...], friction: float, seconds: float, *, corner: bool) -> Plant:
    """Boxes after belts have pressed them against a rail, or into a corner, for a while."""
    rails = [((WIDE, -0.98), (WIDE, 0.98))]
    if corner:
        rails.append(((-0.98, WIDE), (0.98, WIDE)))
    bench = plant(*boxes, mu=0.5, rails=tuple(rails), friction=friction)
    drives = np.full((len(bench.array), 2), (SPEED, SPEED if corner else 0.0))
    for _ in ticks(bench, drives, round(seconds / 0.004)):
        assert len(boxes) == 1 or least_gap(bench) >= 0.0
    return bench


@pytest.mark.parametrize("friction", [0.0, 0.3])
@pytest.mark.parametrize(
    ("count", "aside_m"),
    [(2, 0.0), (6, 0.0), (6, 0.02), pytest.param(7, 0.05, marks=pytest.mark.slow)],
)
def test_a_queue_comes_to_rest_against_a_rail(count: int, aside_m: float, friction: float) -> None:
    places = [(WIDE - 0.5 * BOX - 0.001 - k * (BOX + 0.001), aside_m * (-1) ** k) for k in range(count)]
    bench = pressed(tuple(box(x, y) for x, y in places), friction, 0.4, corner=False)
    assert np.abs(bench.state[:, 3:]).max() < 1e-9
    front = bench.state[:, 0] + 0.5 * BOX
    assert front == pytest.approx(WIDE - BOX * np.arange(count), abs=1e-6 * count)


@pytest.mark.parametrize(
    "friction", [0.0, *(pytest.param(friction, marks=pytest.mark.slow) for friction in (0.05, 0.3))]
)
def test_a_block_of_nine_comes_to_rest_in_a_corner(friction: float) -> None:
    rows = [WIDE - 0.5 * BOX - 0.001 - k * (BOX + 0.001) for k in range(3)]
    bench = pressed(tuple(box(x, y) for x in rows for y in rows), friction, 0.4, corner=True)
    assert np.abs(bench.state[:, 3:]).max() < 1e-9
