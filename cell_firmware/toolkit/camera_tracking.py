"""Tracking of the nearest parcel by camera frames."""

from __future__ import annotations

import math
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.firmware import Bools, Cells, Floats, Inputs, State

_MARGIN: Final = 1.5
"""Distance from a parcel's corner beyond which a cell ignores the parcel, pitches."""


@final
class CameraTracker:
    """Tracker of the parcel with the nearest centre in each frame, if it may be over the cell or next to it.

    Args:
        size_m: Length of the parcels along their x and y.
        patience_s: Validity of a frame, s.
    """

    def __init__(self, size_m: tuple[float, float], patience_s: float) -> None:
        self._corner_m = 0.5 * np.sqrt(size_m[0] ** 2 + size_m[1] ** 2)
        self._patience_s = patience_s

    def init(self, cells: Cells) -> State:
        """Return the initial state, without a tracked parcel."""
        n = len(cells)
        return {
            "position_m": cells.position_m,
            "reach_m": np.full(n, self._corner_m + _MARGIN * cells.pitch_m),
            "ttl_periods": np.full(n, max(1, round(self._patience_s / cells.period_s))),
            "counts": np.zeros(n, dtype=np.int64),
            "centre_m": np.zeros((n, 2)),
            "direction": np.tile((1.0, 0.0), (n, 1)),
        }

    def step(self, state: State, inputs: Inputs) -> dict[str, NDArray[Any]]:
        """One control period."""
        picture, place = inputs.camera, state["position_m"]
        if picture is None:
            return {**state, "counts": np.maximum(state["counts"], 1) - 1}
        if not len(picture.parcel):
            return {**state, "counts": np.zeros_like(state["counts"])}
        dx, dy = picture.pose[:, 0] - place[:, :1], picture.pose[:, 1] - place[:, 1:]
        square = dx * dx + dy * dy
        nearest = square.argmin(axis=1)
        close = square[np.arange(len(place)), nearest] <= state["reach_m"] * state["reach_m"]
        # of each parcel once, not of each cell: a cell alone gets the same bits
        angle = picture.pose[:, 2]
        direction = np.array([(math.cos(one), math.sin(one)) for one in angle])
        return {
            **state,
            "counts": np.where(close, state["ttl_periods"], 0),
            "centre_m": picture.pose[nearest, :2],
            "direction": direction[nearest],
        }

    def pose(self, state: State) -> tuple[Bools, Floats, Floats]:
        """Return whether a pose is known, ``(n,)``, the centre, ``(n, 2)``, and the unit vector along x, ``(n, 2)``."""
        return state["counts"] > 0, state["centre_m"], state["direction"]
