"""The observer's pieces beside other ways to come by the same numbers."""

import numpy as np
import pytest
from numpy.typing import NDArray

from cell_firmware.estimation import occupancy as pattern
from cell_firmware.estimation.footprint_residual import Pose, Sensors, rotate, total, worst_residual
from cell_firmware.estimation.observer import Belief, Observer, footing
from plant.loads import find_supports

PITCH_M, HALF_M = 0.1, (0.24, 0.15)


def around(pose: tuple[float, float, float], spacing_m: float = PITCH_M) -> Sensors:
    """What 16 x 16 sensors see of a rectangle."""
    steps = (np.arange(16) - 8).astype(np.float64) * spacing_m
    across_m, along_m = np.meshgrid(steps, steps)
    x: NDArray[np.float64] = across_m.reshape(1, -1)
    y: NDArray[np.float64] = along_m.reshape(1, -1)
    along = np.cos(pose[2]) * (x - pose[0]) + np.sin(pose[2]) * (y - pose[1])
    across = np.cos(pose[2]) * (y - pose[1]) - np.sin(pose[2]) * (x - pose[0])
    covered = (abs(along) <= HALF_M[0]) & (abs(across) <= HALF_M[1])
    return Sensors(x, y, np.ones_like(covered), covered, np.zeros(256))


def pose_of(x: float, y: float, angle: float) -> Pose:
    return Pose(np.array([[x, y]]), np.array([[np.cos(angle), np.sin(angle)]]), np.zeros((1, 3)))


HALF = np.array([HALF_M])


def test_the_worst_contradiction_s_slope_is_its_derivative() -> None:
    chance = np.random.default_rng(1)
    for _ in range(20):
        truth, guess = chance.normal(0.0, 0.05, 3), chance.normal(0.0, 0.05, 3)
        sensors = around((truth[0], truth[1], 4 * truth[2]))
        wrong, slope = worst_residual(sensors, pose_of(guess[0], guess[1], 4 * guess[2]), HALF)
        for axis in range(3):
            step = np.zeros(3)
            step[axis] = 1e-7
            there = worst_residual(
                sensors, pose_of(guess[0] + step[0], guess[1] + step[1], 4 * guess[2] + step[2]), HALF
            )
            assert (there[0] - wrong)[0] / 1e-7 == pytest.approx(slope[0, axis], abs=1e-5)


def test_nothing_contradicts_the_truth() -> None:
    for angle in (0.0, 0.4, 1.2):
        assert (
            worst_residual(around((0.013, -0.021, angle)), pose_of(0.013, -0.021, angle), HALF)[0][0] <= 0.0
        )


def test_a_first_guess_contradicts_hardly_and_is_within_half_a_cell() -> None:
    chance = np.random.default_rng(2)
    observer = Observer(HALF_M, PITCH_M, 0.004, 0.5)
    for _ in range(12):
        x, y, angle = *chance.uniform(-0.05, 0.05, 2), chance.uniform(-1.5, 1.5)
        belief, wrong = observer.begun(around((x, y, angle)))
        assert wrong[0] < 0.15 * PITCH_M
        assert np.hypot(*(belief.pose.centre_m[0] - (x, y))) < 0.5 * PITCH_M


def test_a_parcel_in_motion_is_followed_to_a_tenth_of_a_cell_and_two_degrees() -> None:
    period = 0.004
    observer = Observer(HALF_M, PITCH_M, period, 0.5)
    x, y, angle = -0.2, -0.1, 0.5
    belief: Belief = observer.begun(around((x, y, angle)))[0]
    velocity = np.array([[0.15, 0.08, 0.0]])
    for _ in range(500):
        x, y = x + period * velocity[0, 0], y + period * velocity[0, 1]
        belief = observer.moved(belief, velocity, np.ones(1))
        belief, _ = observer.corrected(belief, around((x, y, angle)))
    found = belief.pose
    off = np.degrees(np.arctan2(found.direction[0, 1], found.direction[0, 0]) - angle)
    assert np.hypot(*(found.centre_m[0] - (x, y))) < 0.1 * PITCH_M
    assert abs((off + 90.0) % 180.0 - 90.0) < 2.0


def test_loads_are_shared_as_the_plant_shares_them() -> None:
    chance = np.random.default_rng(3)
    compared = 0
    for _ in range(30):
        x, y, angle = *chance.uniform(-0.05, 0.05, 2), chance.uniform(-1.5, 1.5)
        wheels = around((x, y, angle))
        alive = chance.random(256) < 0.7
        under = wheels.covered[0]
        offsets = np.stack((wheels.x_m[0] - x, wheels.y_m[0] - y), axis=1)[under]
        supports = find_supports(offsets, np.ones(len(offsets), dtype=np.bool_), PITCH_M)
        if supports is None or not supports.carrying.all():
            continue
        loads: NDArray[np.float64] = supports.plane @ np.array([1.0, *-supports.centroid_m])
        living = alive[under]
        foot = footing(wheels._replace(known=alive[None]), pose_of(x, y, angle), HALF)
        assert foot.grip[0] == pytest.approx(loads[living].sum(), abs=1e-12)
        assert foot.shift_m[0] == pytest.approx(
            loads[living] @ offsets[living] / loads[living].sum(), abs=1e-12
        )
        compared += 1
    assert compared > 20


def test_sums_do_not_depend_on_how_many_are_summed_at_once() -> None:
    values = np.random.default_rng(4).normal(size=(50, 771))
    together = total(values)
    assert all(together[i] == total(values[i : i + 1])[0] for i in range(50))
    assert together == pytest.approx(values.sum(axis=1), rel=1e-12, abs=1e-12)


def test_turning_keeps_the_length_and_turns() -> None:
    found = rotate(np.array([[0.6, 0.8]]), np.array([0.01]))
    assert np.hypot(*found[0]) == pytest.approx(1.0, abs=1e-15)
    assert np.arctan2(found[0, 1], found[0, 0]) - np.arctan2(0.8, 0.6) == pytest.approx(0.01, abs=1e-6)


def test_a_map_is_read_where_its_cells_are_seen_from_any_of_them() -> None:
    rows, columns = np.array([14, 15, 16, 17, 20]), np.array([30, 31, 32, 33, 36])
    presence = np.array([[True, False], [False, True], [True, True], [False, False], [True, False]])
    maps = pattern.own(rows, columns, presence, np.array([True, True, True, True, False]))
    known = np.bitwise_or.reduce(maps.known, axis=0)[None]
    covered = np.bitwise_or.reduce(maps.covered, axis=0)[None]
    for i in range(4):
        seen = pattern.unfolded(known, rows[i : i + 1], columns[i : i + 1])[0]
        over = pattern.unfolded(covered, rows[i : i + 1], columns[i : i + 1])[0]
        assert seen.sum() == 8
        for j in range(4):
            place = (slice(None), 8 + rows[j] - rows[i], 8 + columns[j] - columns[i])
            assert seen[place].all()
            assert np.array_equal(over[place], presence[j])
