"""A rectangle is moved over the cells by hand, and the cells are asked where they think that it is."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.protocols.parcel_estimate import ParcelEstimate, ParcelEstimateParameters

SIZE_M = (0.42, 0.26)
PITCH_M, PERIOD_S = 0.1, 0.004096


def firmware(**parameters: Any) -> ParcelEstimate:
    return ParcelEstimate(
        ParcelEstimateParameters.model_validate({"size_m": SIZE_M, "target_m": [0.7, 0.7], **parameters})
    )


def over(lattice: Lattice, pose: tuple[float, float, float]) -> NDArray[np.bool_]:
    """``(n, 1)``: which cells' centres are under a rectangle."""
    x, y = lattice.columns * PITCH_M - pose[0], lattice.rows * PITCH_M - pose[1]
    along, across = np.cos(pose[2]) * x + np.sin(pose[2]) * y, np.cos(pose[2]) * y - np.sin(pose[2]) * x
    return ((abs(along) <= SIZE_M[0] / 2) & (abs(across) <= SIZE_M[1] / 2))[:, None]


def path(ticks: int) -> list[tuple[float, float, float]]:
    """A rectangle that goes to the upper right, and turns a little."""
    return [
        (0.35 + 0.1 * k * PERIOD_S, 0.35 + 0.06 * k * PERIOD_S, 0.3 + 0.1 * k * PERIOD_S)
        for k in range(ticks)
    ]


@pytest.mark.parametrize("shards", [3, 71])
def test_one_cell_does_alone_what_it_does_among_many(
    grid: Callable[..., Lattice], run: Callable[..., Any], shards: int
) -> None:
    lattice = grid(8, 9, missing=[(5, 6)])
    presence = np.array([over(lattice, pose) for pose in path(100)])
    dead = {50: [(4, 4), (6, 3)]}
    found = [
        run(firmware(), Partition.even(lattice, count), 100, presence=presence, dead=dead).drives
        for count in (1, shards)
    ]
    assert found[0].tobytes() == found[1].tobytes()
    assert np.any(found[0])
