"""Queues and blocks of boxes that belts press against rails: they come to rest, and nothing overlaps."""

from __future__ import annotations

import numpy as np
import pytest

from plant.effects.parcel_contact.spec import ParcelContactSpec
from plant.effects.registry import PlantEffects
from plant.parcel_spec import ParcelSpec
from plant.plant import Plant
from plant.solver_specs import ImplicitSpec
from plant.specs import PlantSpec
from tests.plant.effects.parcel_contact.benches import BOX, box, least_gap, ticks
from tests.plant.laws import COULOMB
from tests.plant.scenes import spec

PITCH_M = 0.1
SPEED = 0.3
"""Of the belts, m/s."""
SPACE_M = 0.001
"""Between neighbours at the start."""
ROUGH = (0.0, 0.1, 0.3, 1.0)
"""Friction between boxes."""
LONG = [pytest.param(count, marks=pytest.mark.slow) for count in (3, 5, 10, 20, 50)]


def places(count: int) -> tuple[list[float], float]:
    """Places of so many boxes in a row up to a rail, and the rail's."""
    edge = 0.5 * PITCH_M * columns(count) - 0.08
    return [edge - 0.5 * BOX - SPACE_M - k * (BOX + SPACE_M) for k in range(count)], edge


def columns(count: int) -> int:
    """Columns of cells under such a row."""
    return max(20, round((count + 2) * BOX / PITCH_M) + 4)


def pressed(
    boxes: tuple[ParcelSpec, ...],
    size: tuple[int, int],
    rails: tuple[tuple[tuple[float, float], ...], ...],
    friction: float,
    drive: tuple[float, float],
    *,
    law: str = "viscous",
    seconds: float = 0.4,
) -> Plant:
    """Boxes after belts have pressed them against rails for a while; no two overlap in any tick."""
    values = dict(spec(*boxes, mu=0.5, rows=size[0], columns=size[1], pitch_m=PITCH_M)) | {
        "effects": PlantEffects(parcel_contact=ParcelContactSpec(rails=rails, friction=friction))
    }
    if law == "coulomb":
        values |= {"friction": COULOMB, "solver": ImplicitSpec(name="implicit", tolerance=1e-6)}
    bench = Plant(PlantSpec.model_validate(values))
    for events in ticks(bench, np.full((len(bench.array), 2), drive), round(seconds / 0.004)):
        assert "contact_residual" not in {event.kind for event in events}
        assert len(boxes) == 1 or least_gap(bench) >= 0.0
    return bench


def queue(count: int, aside_m: float, friction: float, law: str = "viscous") -> tuple[Plant, float]:
    """A queue pressed against a rail, and the rail's place."""
    row, edge = places(count)
    boxes = tuple(box(x, aside_m * (-1) ** k) for k, x in enumerate(row))
    rails = (((edge, -0.38), (edge, 0.38)),)
    return pressed(boxes, (8, columns(count)), rails, friction, (SPEED, 0.0), law=law), edge


def block(side: int, friction: float, law: str = "viscous", seconds: float = 0.4) -> Plant:
    """A square block of boxes pressed into a corner."""
    row, edge = places(side)
    boxes = tuple(box(x, y) for x in row for y in row)
    rails = (((edge, -0.98), (edge, edge + 0.05)), ((-0.98, edge), (edge + 0.05, edge)))
    size = (columns(side), columns(side))
    return pressed(boxes, size, rails, friction, (SPEED, SPEED), law=law, seconds=seconds)


@pytest.mark.parametrize(
    "friction", [0.0, 0.3, *(pytest.param(mu, marks=pytest.mark.slow) for mu in (0.1, 1.0))]
)
@pytest.mark.parametrize("aside_m", [0.0, 0.02])
@pytest.mark.parametrize("count", [2, 6, *LONG])
def test_a_queue_comes_to_rest_against_a_rail(count: int, aside_m: float, friction: float) -> None:
    bench, edge = queue(count, aside_m, friction)
    assert np.abs(bench.state[:, 3:]).max() < 1e-9
    front = bench.state[:, 0] + 0.5 * BOX
    assert front == pytest.approx(edge - BOX * np.arange(count), abs=1e-6 * count)


@pytest.mark.slow
@pytest.mark.parametrize("friction", ROUGH)
@pytest.mark.parametrize("count", [2, 6, 20])
def test_a_queue_comes_to_rest_under_coulomb(count: int, friction: float) -> None:
    bench, _ = queue(count, 0.02, friction, "coulomb")
    assert np.abs(bench.state[:, 3:]).max() < 1e-9


@pytest.mark.parametrize(
    ("side", "friction"),
    [
        (3, 0.0),
        *(pytest.param(3, mu, marks=pytest.mark.slow) for mu in (0.05, 0.1, 0.3, 0.5, 1.0)),
        *(pytest.param(5, mu, marks=pytest.mark.slow) for mu in (0.0, 0.3)),
        *(pytest.param(5, mu, marks=[pytest.mark.slow, pytest.mark.nightly]) for mu in (0.1, 0.5, 1.0)),
    ],
)
def test_a_block_comes_to_rest_in_a_corner(side: int, friction: float) -> None:
    # boxes as rough as that first stop askew, corner to edge, where speeds double every quarter of a second
    seconds = 10.0 if (side, friction) == (5, 1.0) else 0.2 * side
    assert np.abs(block(side, friction, seconds=seconds).state[:, 3:]).max() < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("friction", ROUGH)
@pytest.mark.parametrize("side", [3, 5])
def test_a_block_comes_to_rest_under_coulomb(side: int, friction: float) -> None:
    assert np.abs(block(side, friction, "coulomb").state[:, 3:]).max() < 1e-9


def sink(friction: float, law: str, count: int) -> int:
    """How many contacts of twenty parcels begin in so many ticks, while belts draw them together."""
    draw = np.random.default_rng(0)
    boxes = tuple(
        box(
            (k % 5 - 2) * 0.5,
            (k // 5 - 1.5) * 0.5,
            float(draw.uniform(0.0, 1.5)),
            size_m=(float(draw.uniform(0.25, 0.36)), float(draw.uniform(0.25, 0.36))),
        )
        for k in range(20)
    )
    values = dict(spec(*boxes, mu=0.5, rows=30, columns=30, pitch_m=PITCH_M)) | {
        "effects": PlantEffects(parcel_contact=ParcelContactSpec(friction=friction))
    }
    if law == "coulomb":
        values |= {"friction": COULOMB, "solver": ImplicitSpec(name="implicit", tolerance=1e-6)}
    bench = Plant(PlantSpec.model_validate(values))
    touched = 0
    for events in ticks(bench, -bench.array.positions_m, count):
        touched += sum(event.kind == "contact" for event in events)
        assert "contact_residual" not in {event.kind for event in events}
        assert least_gap(bench) >= 0.0
    return touched


@pytest.mark.slow
@pytest.mark.parametrize("friction", ROUGH)
def test_twenty_parcels_are_drawn_into_a_sink(friction: float) -> None:
    assert sink(friction, "viscous", 180) > 20


@pytest.mark.slow
@pytest.mark.parametrize("friction", ROUGH)
def test_twenty_parcels_are_drawn_into_a_sink_under_coulomb(
    friction: float, request: pytest.FixtureRequest
) -> None:
    # where they meet, and at night until they are pressed together
    count = 180 if request.config.getoption("nightly") else 100
    assert sink(friction, "coulomb", count) > 20
