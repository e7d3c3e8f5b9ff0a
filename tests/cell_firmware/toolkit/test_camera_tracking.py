"""Which parcel of a picture a cell takes for its own, and for how long."""

import numpy as np

from bus.lattice import Lattice
from bus.sensors import CameraFrame
from cell_firmware.firmware import Cells, Inputs
from cell_firmware.toolkit.camera_tracking import CameraTracker

LATTICE = Lattice((0, column) for column in range(10))
PLACES = np.stack((0.1 * LATTICE.columns, 0.1 * LATTICE.rows), axis=1)
CELLS = Cells.of(LATTICE, PLACES, 0.01)


def inputs(*poses: tuple[float, float, float]) -> Inputs:
    pose = np.array(poses).reshape(-1, 3)
    return Inputs(np.zeros((10, 1), dtype=np.bool_), camera=CameraFrame(np.arange(len(pose)), pose))


NOTHING = Inputs(np.zeros((10, 1), dtype=np.bool_))


def test_the_nearest_parcel_is_a_cell_s_own_if_it_may_reach_it() -> None:
    sightings = CameraTracker((0.16, 0.12), 0.05)  # a corner is 0.1 m from the centre, and 0.15 m on is near
    state = sightings.step(sightings.init(CELLS), inputs((0.0, 0.0, 0.5), (0.9, 0.0, -2.0)))
    known, centre, direction = sightings.pose(state)
    assert known.tolist() == [True] * 3 + [False] * 4 + [True] * 3
    assert centre[known, 0].tolist() == [0.0] * 3 + [0.9] * 3
    assert direction[0].tolist() == [np.cos(0.5), np.sin(0.5)]
    assert direction[9].tolist() == [np.cos(-2.0), np.sin(-2.0)]


def test_a_picture_counts_for_as_long_as_said_and_one_without_parcels_ends_it() -> None:
    sightings = CameraTracker((0.16, 0.12), 0.03)
    state = sightings.step(sightings.init(CELLS), inputs((0.0, 0.0, 0.5)))
    seen = [bool(sightings.pose(state)[0][0])]
    for _ in range(3):
        state = sightings.step(state, NOTHING)
        seen.append(bool(sightings.pose(state)[0][0]))
    assert seen == [True, True, True, False]
    state = sightings.step(sightings.init(CELLS), inputs((0.0, 0.0, 0.5)))
    assert not sightings.pose(sightings.step(state, inputs()))[0].any()


def test_a_cell_alone_remembers_what_it_does_among_others() -> None:
    sightings, shown = CameraTracker((0.4, 0.3), 0.05), inputs((0.31, 0.04, 1.1), (0.6, -0.1, 2.3))
    whole = sightings.step(sightings.init(CELLS), shown)
    for i in range(10):
        row = np.array([i])
        alone = sightings.step(sightings.init(CELLS.select(row)), shown.select(row))
        for name, array in alone.items():
            assert array.tobytes() == whole[name][row].tobytes(), name
