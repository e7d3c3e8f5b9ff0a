"""Scanners: which parcel they read, what labels say, and the report when a parcel leaves by the wrong exit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from plant.array import CellArray
from plant.effects.feeders.spec import FeedersSpec, FeedSpec
from plant.effects.registry import PlantEffects
from plant.effects.scanners.scanners import Scanners
from plant.faults.base import WheelFaults
from plant.parcel_spec import ParcelSpec
from plant.plant import Plant
from plant.sampling import Timing
from plant.specs import PlantSpec
from tests.plant.scenes import SECOND, TICK_NS, spec

ARRAY = {"rows": 8, "columns": 20}
EXITS = [
    {"name": "east", "size_m": (0.2, 0.8), "position_m": (0.85, 0.0)},
    {"name": "south", "size_m": (0.2, 0.2), "position_m": (0.0, -0.4)},
]
BOX = {"size_m": (0.25, 0.25), "mass_kg": 1.0}


def scanning(
    *parcels: dict[str, Any], cells: list[tuple[int, int]], feed: list[dict[str, Any]] | None = None
) -> PlantSpec:
    """A belt of 8 x 20 cells with scanners at these cells."""
    effects = PlantEffects.model_validate(
        {"feeders": {"feed": feed or [], "exits": EXITS}, "scanners": {"cells": cells}}
    )
    own = [ParcelSpec.model_validate({**BOX, **parcel}) for parcel in parcels]
    return PlantSpec.model_validate(dict(spec(**ARRAY)) | {"effects": effects, "seed": 3, "parcels": own})


def everywhere() -> list[tuple[int, int]]:
    return [(r, c) for r in range(8) for c in range(20)]


def test_a_label_is_the_number_of_the_exit_from_1_and_0_without_one() -> None:
    plant = Plant(
        scanning(
            {"position_m": (-0.75, 0.05), "destination": "south"},
            {"position_m": (-0.25, 0.05), "destination": "east"},
            {"position_m": (0.25, 0.05)},
            cells=[(4, 2), (4, 7), (4, 12), (0, 0)],
        )
    )
    label = plant.sense().label
    assert label is not None
    grid = plant.array.grid
    assert [int(label[grid[cell]]) for cell in ((4, 2), (4, 7), (4, 12), (0, 0))] == [2, 1, 0, 0]
    assert np.count_nonzero(label) == 2  # cells without a scanner read nothing


def test_a_scanner_reads_exactly_where_a_presence_sensor_in_the_middle_sees() -> None:
    triangle = {"size_m": None, "vertices_m": [(-0.2, -0.1), (0.3, -0.1), (0.0, 0.25)]}
    parcels = [
        {"position_m": (-0.5, 0.0), "angle_rad": 0.4, "destination": "east"},
        {"position_m": (0.3, 0.02), "angle_rad": 2.0, "destination": "south", **triangle},
    ]
    plant = Plant(scanning(*parcels, cells=everywhere()))
    for _ in range(40):
        sense, _ = plant.advance(np.tile((0.1, 0.02), (160, 1)), plant.time_ns + 10 * TICK_NS)
        assert sense.label is not None
        assert ((sense.label > 0) == sense.presence[:, 0]).all()
        assert set(sense.label.tolist()) == {0, 1, 2}


def test_of_two_that_overlap_the_first_is_read_and_one_that_is_not_there_is_not() -> None:
    made = scanning(
        {"position_m": (-0.5, 0.0), "destination": "south"},
        {"position_m": (0.4, 0.0), "destination": "east"},
        cells=everywhere(),
    )
    feeders = made.effects.feeders
    assert made.effects.scanners is not None
    assert feeders is not None
    array = CellArray(made.array)
    scanners = Scanners(made.effects.scanners, feeders, array, made.parcels)
    state = np.zeros((2, 6))
    state[:, 0] = [-0.05, 0.05]
    read = {
        there: {
            float(x): int(label) for (x, y), label in zip(array.positions_m, labels, strict=True) if y == 0.05
        }
        for there in ((0, 1), (0,), (1,), ())
        for labels in [scanners.label(state, np.array(there, dtype=np.int64))]
    }
    middle = (-0.15, -0.05, 0.05, 0.15)
    at = {there: [line[min(line, key=lambda x: abs(x - m))] for m in middle] for there, line in read.items()}
    assert at == {(0, 1): [2, 2, 2, 1], (0,): [2, 2, 2, 0], (1,): [0, 1, 1, 1], (): [0, 0, 0, 0]}


def test_cells_with_instants_of_their_own_read_labels_as_they_read_presence() -> None:
    """A cell that does not read keeps what it read last."""
    plant = Plant(scanning({"position_m": (-0.75, 0.05), "destination": "south"}, cells=everywhere()))
    drives, none = np.tile((0.5, 0.0), (160, 1)), np.full(160, -1, dtype=np.int64)
    reads = none.copy()
    reads[80:] = SECOND // 2
    sense, _ = plant.advance(drives, SECOND, Timing(none, reads))
    assert sense.label is not None
    assert ((sense.label == 2) == sense.presence[:, 0]).all()
    assert sense.label[:80].any()
    halfway = Plant(scanning({"position_m": (-0.75, 0.05), "destination": "south"}, cells=everywhere()))
    then, _ = halfway.advance(drives, SECOND // 2)
    assert then.label is not None
    assert sense.label[80:].tolist() == then.label[80:].tolist()


def test_a_parcel_that_leaves_by_another_exit_than_its_own_is_counted_and_reported() -> None:
    plant = Plant(
        scanning(
            {"position_m": (0.5, 0.2), "destination": "south"},
            {"position_m": (0.5, -0.2), "destination": "east"},
            {"position_m": (0.0, 0.0)},
            cells=[(0, 0)],
        )
    )
    left: list[str] = []
    for _ in range(1500):
        _, events = plant.advance(np.tile((0.3, 0.0), (160, 1)), plant.time_ns + TICK_NS)
        left += [event.detail for event in events if event.kind == "left"]
    traffic = plant.traffic()
    assert traffic is not None
    assert [(one.name, one.left, one.misrouted) for one in traffic.exits] == [("east", 3, 1), ("south", 0, 0)]
    assert traffic.misrouted == 1
    assert [text.endswith("though meant for south") for text in left] == [True, False, False]


def feeding(**values: Any) -> FeedSpec:
    return FeedSpec.model_validate(
        {"name": "west", "position_m": (-0.7, 0.0), "every_s": 1.0, "count": 400, **BOX, **values}
    )


def test_fed_parcels_take_their_exits_in_turn_or_at_random_by_the_seed() -> None:
    turn = feeding(to=["a", "b", "c"])
    assert turn.destinations(1)[:5] == ["a", "b", "c", "a", "b"]
    assert [parcel.destination for parcel in turn.parcels(1)] == turn.destinations(1)
    random = feeding(to=["a", "b", "c"], order="random")
    assert random.destinations(1) == random.destinations(1) != random.destinations(2)
    counts = [random.destinations(1).count(name) for name in "abc"]
    assert min(counts) > 400 / 3 - 4 * (400 * 2 / 9) ** 0.5
    poses = [(p.position_m, p.angle_rad) for p in turn.parcels(1)]
    assert [(p.position_m, p.angle_rad) for p in random.parcels(1)] == poses
    assert set(feeding().destinations(1)) == {None}


def test_exits_that_are_none_are_refused_with_the_nearest() -> None:
    with pytest.raises(ValidationError, match=r"parcels.0.destination eats: .* nearest: east"):
        scanning({"position_m": (0.0, 0.0), "destination": "eats"}, cells=[(0, 0)])
    fed = {"name": "west", "position_m": (-0.7, 0.0), "every_s": 1.0, "count": 4, **BOX}
    with pytest.raises(ValidationError, match=r"feed.0.to.1 north: .* nearest: south"):
        scanning(cells=[(0, 0)], feed=[{**fed, "to": ["east", "north"]}])
    with pytest.raises(ValidationError, match=r"there are none"):
        PlantSpec.model_validate(
            {**dict(spec()), "parcels": [{**BOX, "position_m": (0, 0), "destination": "east"}]}
        )
    with pytest.raises(ValidationError, match="leave destination out"):
        feeding(destination="a")


def test_scanners_need_cells_that_exist_and_feeders() -> None:
    with pytest.raises(ValidationError, match="the array has no cell there"):
        scanning(cells=[(0, 0), (8, 0)])
    with pytest.raises(ValidationError, match="twice"):
        scanning(cells=[(0, 0), (0, 0)])
    effects = PlantEffects.model_validate({"scanners": {"cells": [(0, 0)]}})
    assert [path for path, _, _ in effects.problems()] == [("effects", "feeders")]
    with pytest.raises(ValidationError):
        PlantEffects.model_validate({"scanners": {"cells": []}, "feeders": {}})
    assert FeedersSpec.model_validate({"exits": EXITS}).number("south") == 2


def test_the_scanner_of_a_cell_that_is_pulled_reads_nothing_and_reads_again_when_it_is_back() -> None:
    plant = Plant(scanning({"position_m": (-0.5, 0.0), "destination": "south"}, cells=everywhere()))
    before = plant.sense().label
    assert before is not None
    read = np.flatnonzero(before)
    wheel_faults, drives = WheelFaults.healthy(160), np.zeros((160, 2))
    wheel_faults.gone[read[0]] = True
    plant.apply_faults(wheel_faults, drives)
    for label in (plant.last_readings.label, plant.sense().label):
        assert label is not None
        assert np.flatnonzero(label).tolist() == read[1:].tolist()
    plant.apply_faults(WheelFaults.healthy(160), drives)
    assert plant.last_readings.label is not None
    assert np.array_equal(plant.last_readings.label, before)


def test_a_parcel_is_fed_onto_the_cells_that_are_there_when_it_comes() -> None:
    feed = {
        "name": "west",
        "position_m": (-0.5, 0.0),
        "times_s": (0.01,),
        "size_m": (0.25, 0.25),
        "mass_kg": 1.0,
    }
    plant = Plant(scanning(cells=[(0, 0)], feed=[feed]))
    under = plant._solver.covered_cells(0)
    wheel_faults, drives = WheelFaults.healthy(160), np.zeros((160, 2))
    wheel_faults.gone[under[:1]] = True
    plant.apply_faults(wheel_faults, drives)
    _, events = plant.advance(drives, 10 * TICK_NS)
    assert [event.kind for event in events] == ["fed"]
    assert set(plant._solver.covered_cells(0)) == set(under[1:])
