"""Parcels on a real plant, turned and brought home; and what the cells do about it alone and among many."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm

from bus.lattice import Lattice
from bus.partition import Partition
from bus.sensors import CameraFrame
from cell_firmware.board import Board
from cell_firmware.firmware import Cells
from cell_firmware.protocols.align import Align, AlignParameters
from cell_firmware.shard import Shard
from deploy.scenes.errors import SceneError
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from tests.benchmarks.protocols.align_case import Case, Start, off_deg, run

SIZE_M = (0.42, 0.26)
PITCH_M, PERIOD_S = 0.1, 0.004096
HOME = {"target_m": (0.0, 0.0)}
SEES = {"source": "camera", **HOME}
SHARP = {"period_s": 0.001}


def firmware(**parameters: Any) -> Align:
    return Align(AlignParameters.model_validate({"size_m": SIZE_M, "target_m": [0.3, 0.3], **parameters}))


def over(lattice: Lattice, pose: tuple[float, float, float]) -> NDArray[np.bool_]:
    """``(n, 1)``: which cells' centres are under a rectangle."""
    x, y = lattice.columns * PITCH_M - pose[0], lattice.rows * PITCH_M - pose[1]
    along, across = np.cos(pose[2]) * x + np.sin(pose[2]) * y, np.cos(pose[2]) * y - np.sin(pose[2]) * x
    return ((abs(along) <= SIZE_M[0] / 2) & (abs(across) <= SIZE_M[1] / 2))[:, None]


def path(ticks: int) -> list[tuple[float, float, float]]:
    return [(0.35 + 0.2 * k * PERIOD_S, 0.35, 0.3 - 0.3 * k * PERIOD_S) for k in range(ticks)]


@pytest.mark.slow
@pytest.mark.parametrize("shards", [3, 72])
def test_by_sensors_one_cell_does_alone_what_it_does_among_many(
    grid: Callable[..., Lattice], run: Callable[..., Any], shards: int
) -> None:
    lattice = grid(8, 9)
    presence = np.array([over(lattice, pose) for pose in path(45)])
    found = [
        run(firmware(), Partition.even(lattice, count), 45, presence=presence, dead={35: [(4, 4)]}).drives
        for count in (1, shards)
    ]
    assert found[0].tobytes() == found[1].tobytes()
    assert np.any(found[0])


def test_by_camera_one_cell_does_alone_what_it_does_among_many(grid: Callable[..., Lattice]) -> None:
    lattice = grid(8, 9)
    places = PITCH_M * np.stack((lattice.columns, lattice.rows), axis=1)
    cells = Cells.of(lattice, places, PERIOD_S)
    drives: list[list[NDArray[np.float64]]] = []
    for count in (1, 72):
        partition = Partition.even(lattice, count)
        shards = [Shard(Board(firmware(source="camera")), cells, partition, s) for s in range(count)]
        drives.append([])
        for tick, pose in enumerate(path(20)):
            shown = (
                CameraFrame(np.array([0, 3]), np.array([pose, (0.1, 0.7, 1.0)])) if tick % 5 == 2 else None
            )
            drive = np.zeros((72, 2))
            for shard in shards:
                presence = np.zeros((len(shard), 1), dtype=np.bool_)
                drive[shard.indices] = shard.step(tick, presence, camera=shown).drive
            drives[-1].append(drive)
    assert np.array(drives[0]).tobytes() == np.array(drives[1]).tobytes()
    assert np.any(drives[0][-1])
    assert not np.any(drives[0][1])  # before the first picture


def test_the_parcel_moves_as_the_law_says() -> None:
    """Place and angle against the exact solution of the law; the angle is small, and speeds are below the limit."""
    start = Start((0.54, 0.38), (0.1, -0.15), 0.1)
    times, states = run(Case([start], "align", SEES, 1, 6.0, SHARP))
    gain, mu_g = 0.5, 0.2 * 9.81
    for axis in (0, 1, 2):
        begun = states[0, 0, axis]
        exact = [(expm(t * np.array([[0.0, 1.0], [-gain * mu_g, -mu_g]])) @ (begun, 0.0))[0] for t in times]
        # of the angle, the moments of the wheels' loads about the centre make up what inertia does not know of
        within = 0.08 if axis == 2 else 0.02
        assert np.abs(states[:, 0, axis] - exact).max() < within * abs(begun)


def test_parcels_come_home_by_sensors_alone_and_then_everything_stands() -> None:
    begun = [
        Start((0.58, 0.42), (-0.16, -0.04), 2.24),
        Start((0.58, 0.42), (0.1, 0.12), 0.3),
        Start((0.58, 0.42), (0.05, -0.1), 1.2),
    ]
    _, states = run(Case(begun, "align", HOME, 1, 14.0))
    assert off_deg(states[-1], begun).max() < 2.0
    assert np.hypot(states[-1, :, 0], states[-1, :, 1]).max() < 0.01
    assert np.abs(states[-1, :, 3:]).max() < 1e-6  # m/s, rad/s: wheels stand, friction does the rest


def test_sides_that_are_nearly_alike_are_distinguished() -> None:
    """It is taken to lie across at first."""
    start = Start((0.42, 0.38), (0.109, -0.031), 0.934)
    _, states = run(Case([start], "align", HOME, 5, 12.0))
    assert off_deg(states[-1], [start])[0] < 2.0


def test_without_a_target_a_parcel_is_turned_where_it_is() -> None:
    start = Start((0.54, 0.38), (0.1, -0.05), 0.6)
    _, states = run(Case([start], "align", {"source": "camera", "angle_rad": 2.0}, 1, 10.0, SHARP))
    assert off_deg(states[-1], [start], 2.0)[0] < 0.5
    assert np.hypot(states[-1, 0, 0] - 0.1, states[-1, 0, 1] + 0.05) < 0.02


def test_too_large_a_gain_is_warned_of_and_the_parcel_swings_as_far_as_predicted() -> None:
    lattice = Lattice([(0, 0)])
    assert firmware().warnings(lattice) == ()
    parameters = {**SEES, "gain_per_s": 2.0, "speed_m_s": 10.0}
    (line,) = firmware(**parameters).warnings(lattice)
    assert line.startswith("gain_per_s times response_s is 1, above 1/4")
    assert "overshoot the target, first by 16% of the distance" in line
    _, states = run(Case([Start((0.54, 0.38), (0.2, 0.0), 0.0)], "align", parameters, 1, 4.0, SHARP))
    assert states[:, 0, 0].min() == pytest.approx(-0.16 * 0.2, rel=0.15)
    _, states = run(Case([Start((0.54, 0.38), (0.2, 0.0), 0.0)], "align", SEES, 1, 12.0, SHARP))
    assert states[:, 0, 0].min() > -0.001


def test_theory_has_the_slower_rate() -> None:
    slow = firmware(gain_per_s=0.1).theory(Lattice([(0, 0)]))
    assert "decays at 0.106 1/s" in slow.law  # the lesser root of s^2 - 2 s + 0.2
    assert "decays at 1 1/s" in firmware(gain_per_s=2.0).theory(Lattice([(0, 0)])).law


def test_a_scene_must_have_the_camera_that_align_is_to_use() -> None:
    with pytest.raises(SceneError, match=r"effects\.camera.*align needs it"):
        load_scene("align", [Override.parse("cells.parameters.source=camera")])
    both = ("cells.parameters.source=camera", "effects.camera={}")
    assert load_scene("align", [Override.parse(one) for one in both]).effects.camera
    assert firmware().required_effects() == ()
    assert not firmware().uses_camera()
