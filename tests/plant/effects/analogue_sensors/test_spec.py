"""Levels of analogue sensors: areas of discs under parcels, by closed forms and by quadrature."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError
from scipy.integrate import quad

from plant.effects.analogue_sensors.spec import AnalogueSensorsSpec
from plant.effects.feeders.spec import FeedersSpec
from plant.effects.registry import PlantEffects
from plant.parcel_spec import ParcelSpec
from plant.plant import Plant
from plant.solver_specs import SciPySpec
from plant.specs import PlantSpec
from tests.plant.scenes import SECOND, TICK_NS, elliptic, parcel, spec, turned

Floats = NDArray[np.float64]


def analogue(radius_m: float, *parcels: ParcelSpec, **settings: object) -> PlantSpec:
    """A plant whose sensors see spots."""
    plain = spec(*parcels, **settings)  # type: ignore[arg-type]
    effects = PlantEffects(analogue_sensors=AnalogueSensorsSpec(spot_radius_m=radius_m))
    return plain.model_copy(update={"effects": effects})


def level(plant: Plant) -> Floats:
    found = plant.sense().level
    assert found is not None
    return found


def segment(depth: Floats | float) -> Floats:
    """Share of a disc of radius 1 on one side of a line that lies ``depth`` beyond its centre."""
    inside = np.clip(depth, -1.0, 1.0)
    return 1.0 - (np.arccos(inside) - inside * np.sqrt(1.0 - inside**2)) / np.pi


def chords(corners: Floats, radius: float) -> float:
    """Share of the disc about the origin within a convex polygon: the common part of both chords, integrated."""
    edge = np.roll(corners, -1, axis=0) - corners

    def width(y: float) -> float:
        across = np.flatnonzero((corners[:, 1] - y) * (corners[:, 1] + edge[:, 1] - y) < 0.0)
        if len(across) != 2:
            return 0.0
        at = corners[across, 0] + edge[across, 0] * (y - corners[across, 1]) / edge[across, 1]
        reach = np.sqrt(max(radius**2 - y**2, 0.0))
        return max(min(at.max(), reach) - max(at.min(), -reach), 0.0)

    # where one chord overtakes the other the integrand has a corner
    breaks = [-radius, radius, *corners[:, 1].tolist()]
    for a, d in zip(corners, edge, strict=True):
        roots = np.roots([d @ d, 2.0 * a @ d, a @ a - radius**2])
        breaks += [float(a[1] + t.real * d[1]) for t in roots if abs(t.imag) == 0.0 and 0.0 < t.real < 1.0]
    inside = sorted({y for y in breaks if -radius <= y <= radius})
    pieces = [quad(width, low, high, epsabs=1e-13)[0] for low, high in pairwise(inside)]
    return sum(pieces) / (np.pi * radius**2)


@pytest.mark.parametrize("angle_rad", [0.0, 0.4])
def test_a_straight_edge_covers_the_segment_of_the_disc(angle_rad: float) -> None:
    # one sensor a cell is enough: the parcel is shifted past it
    shift = np.linspace(-0.024, 0.024, 49)
    for depth in shift:
        middle = turned(np.array([[0.3 - depth, 0.0]]), angle_rad)[0] + (0.05, 0.05)
        plant = Plant(
            analogue(0.02, parcel(size_m=(0.6, 0.6), position_m=tuple(middle), angle_rad=angle_rad))
        )
        (cell,) = np.flatnonzero(np.all(np.abs(plant.array.positions_m - 0.05) < 1e-9, axis=1))
        # the edge passes the cell's centre, the parcel reaching so deep over it
        assert level(plant)[cell, 0] == pytest.approx(segment(depth / 0.02), abs=1e-12)


def test_levels_are_the_areas_that_quadrature_finds_of_any_outline_and_spot() -> None:
    draw = np.random.default_rng(11)
    sensors = ((0.0, 0.0), (0.03, -0.02))
    partly = 0
    for radius in (0.011, 0.05, 0.1):
        outline = ((0.0, 0.0), (0.25, -0.06), (0.3, 0.12), (0.07, 0.2))
        place = tuple(draw.uniform(-0.1, 0.1, 2))
        turn = float(draw.uniform(-3.0, 3.0))
        plant = Plant(
            analogue(
                radius,
                parcel(vertices_m=outline, position_m=place, angle_rad=turn),
                sensors_m=sensors,
                missing=((10, 10),),
            )
        )
        corners = turned(plant.footprints_m[0], turn) + place
        found = level(plant)
        for cell in np.flatnonzero(np.hypot(*(plant.array.positions_m - place).T) < 0.5):
            for k, sensor in enumerate(sensors):
                wanted = chords(corners - plant.array.positions_m[cell] - sensor, radius)
                assert found[cell, k] == pytest.approx(wanted, abs=1e-9)
                partly += 0.01 < wanted < 0.99
    assert partly > 40


def test_a_spot_wider_than_a_parcel_has_the_parcel_s_share_of_its_area_and_a_corner_a_quarter() -> None:
    small = Plant(analogue(0.1, parcel(size_m=(0.11, 0.08), position_m=(0.05, 0.05))))
    whole = level(small).max()
    assert whole == pytest.approx(0.11 * 0.08 / (np.pi * 0.01), rel=1e-12)
    corner = Plant(
        analogue(0.01, parcel(size_m=(0.3, 0.3), position_m=(0.1, 0.1), angle_rad=0.0), rows=21, columns=21)
    )
    covered = level(corner)[:, 0].reshape(21, 21)[9:14, 9:14]
    # edges between cells: the parcel reaches from -0.05 to 0.25
    assert np.array_equal(covered, np.pad(np.ones((3, 3)), 1))
    on_cells = Plant(
        analogue(0.01, parcel(size_m=(0.2, 0.2), position_m=(0.1, 0.1), angle_rad=0.0), rows=21, columns=21)
    )
    covered = level(on_cells)[:, 0].reshape(21, 21)[10:13, 10:13]
    assert covered == pytest.approx(np.outer([0.5, 1.0, 0.5], [0.5, 1.0, 0.5]), abs=1e-12)


def test_what_is_beside_a_parcel_has_no_level_and_what_is_deep_under_it_all_of_it() -> None:
    plant = Plant(analogue(0.02, parcel(angle_rad=0.3)))
    corners = turned(plant.footprints_m[0], 0.3) + plant.state[0, :2]
    edge = np.roll(corners, -1, axis=0) - corners
    out = np.stack([edge[:, 1], -edge[:, 0]], axis=1) / np.hypot(*edge.T)[:, None]
    depth = np.min(
        np.sum(out * corners, axis=1) - plant.array.positions_m @ out.T,
        axis=1,
    )
    nearest = np.min(np.hypot(*(plant.array.positions_m[:, None] - corners[None]).transpose(2, 0, 1)), axis=1)
    found = level(plant)[:, 0]
    assert np.all(found[depth > 0.02] == 1.0)
    assert np.all(found[(depth < -0.02) | ((depth < 0.0) & (nearest > 0.3))] == 0.0)
    assert 0 < np.count_nonzero((found > 0.0) & (found < 1.0)) < 12


def test_parcels_add_up_but_not_to_more_than_all() -> None:
    left, right = ((-0.155, 0.05), (0.145, 0.05))
    halves = [parcel(size_m=(0.3, 0.3), position_m=place, angle_rad=0.0) for place in (left, right)]
    # their joint, at x = -0.005, goes through the spots of sensors east of the cells at x = -0.05
    plant = Plant(analogue(0.02, *halves, sensors_m=((0.05, 0.0),)))
    first, second = (level(Plant(analogue(0.02, one, sensors_m=((0.05, 0.0),)))) for one in halves)
    found = level(plant)
    assert found == pytest.approx(np.minimum(first + second, 1.0), abs=1e-15)
    shared = (first > 0.0) & (second > 0.0)
    assert shared.any()
    assert found[shared] == pytest.approx(1.0, abs=1e-12)
    # driven into each other they overlap, as parcels without the effect that lets them touch do
    plant.advance(np.sign(plant.array.positions_m) * (-0.2, 0.0), SECOND // 2)
    apart = [
        Plant(
            analogue(
                0.02, parcel(size_m=(0.3, 0.3), position_m=(x, y), angle_rad=theta), sensors_m=((0.05, 0.0),)
            )
        )
        for x, y, theta in plant.state[:, :3]
    ]
    assert np.sum([level(one) for one in apart], axis=0).max() > 1.5
    assert level(plant) == pytest.approx(
        np.minimum(np.sum([level(one) for one in apart], axis=0), 1.0), abs=1e-15
    )


def test_parcels_that_wait_to_be_fed_cover_nothing() -> None:
    feeders = {
        "feed": [
            {"name": "a", "times_s": [0.5], "size_m": [0.3, 0.3], "mass_kg": 1.0, "position_m": [0.0, 0.0]}
        ],
        "exits": [{"name": "out", "size_m": [0.1, 0.1], "position_m": [0.9, 0.9]}],
    }
    plain = analogue(0.02)
    effects = plain.effects.model_copy(update={"feeders": FeedersSpec.model_validate(feeders)})
    plant = Plant(plain.model_copy(update={"effects": effects}))
    still = np.zeros((400, 2))
    assert not level(plant).any()
    plant.advance(still, SECOND // 4)
    assert not level(plant).any()
    plant.advance(still, SECOND)
    assert level(plant).max() == 1.0


def test_levels_follow_the_parcel_and_are_the_same_for_every_solver() -> None:
    scene = analogue(0.03, parcel())
    plants = [Plant(scene), Plant(scene.model_copy(update={"solver": SciPySpec(name="scipy")}))]
    drives = elliptic(plants[0])
    for plant in plants:
        sense, _ = plant.advance(drives, SECOND // 2)
        assert sense.level is not None
        x, y, theta = plant.state[0, :3]
        there = Plant(analogue(0.03, parcel(position_m=(x, y), angle_rad=theta)))
        assert sense.level.tobytes() == level(there).tobytes()
    assert level(plants[0]) == pytest.approx(level(plants[1]), abs=1e-5)


def test_the_effect_moves_nothing_and_leaves_presence_as_it_is() -> None:
    plain, seeing = Plant(spec(parcel())), Plant(analogue(0.05, parcel()))
    drives = elliptic(plain)
    assert plain.sense().level is None
    for tick in range(1, 40):
        one, events = plain.advance(drives, tick * TICK_NS)
        other, same = seeing.advance(drives, tick * TICK_NS)
        assert one.presence.tobytes() == other.presence.tobytes()
        assert events == same
    assert plain.state.tobytes() == seeing.state.tobytes()


@pytest.mark.parametrize(("radius", "rule"), [(0.2, "at most the array's pitch_m"), (0.0, "greater than 0")])
def test_a_spot_has_a_radius_of_at_most_the_pitch(radius: float, rule: str) -> None:
    with pytest.raises(ValidationError, match=rule):
        PlantSpec.model_validate(
            {
                "array": {"rows": 3, "columns": 3, "pitch_m": 0.1},
                "friction": {"law": "viscous", "coefficient_s_per_m": 0.2},
                "effects": {"analogue_sensors": {"spot_radius_m": radius}},
            }
        )
