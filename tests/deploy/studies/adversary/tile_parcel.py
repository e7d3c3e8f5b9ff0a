"""A row of tiles with one parcel, without physics: the parcel moves as the wheels under it do on the average."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from bus.lattice import Lattice
from cell_firmware.protocols.reserve_path import ReservePath
from cell_firmware.tiles.messages import TileMode, doing, newest
from mdms import ArrayView

SIDE, PITCH_M, PERIOD_S = 3, 0.1, 0.016
HALF_M = np.array([0.14, 0.11])
GRID_M = 1e-4
"""Places are rounded to it, so that like states meet."""
Place = tuple[float, float]


def parameters(tiles: int) -> dict[str, Any]:
    lanes = " ".join(["e"] * (tiles - 1) + ["."])
    return {
        "lanes": [lanes], "exits": [{"tile": [0, tiles - 1], "side": "east"}], "tile_cells": SIDE, "settle_s": 0.0,
        "ttl_periods": 12,
    }  # fmt: skip


class OneParcel(ReservePath):
    """``reserve_path`` with the condition that holds for one parcel: no two tiles have it."""

    def invariants(self, view: ArrayView) -> Iterable[tuple[str, Any]]:
        tile = np.array([column // SIDE for _, column in view.cells])
        own = view["own"]
        words = [newest(np.where(tile == one, own, 0)[None])[0] for one in range(int(tile.max()) + 1)]
        having = [int(doing(np.array([word]))[0]) >= TileMode.HOLD for word in words]
        yield "a parcel is in one reservation at most", sum(having) <= 1


class TwoAtOnce(OneParcel):
    """Mutant: a tile that expects the parcel takes it for its own as soon as its cells sense it."""

    def _lead(self, state: Any, after: Any, own: Any, *others: Any) -> Any:
        found, leads, here = super()._lead(state, after, own, *others), others[2], others[4]
        taken = leads & (doing(found) == TileMode.EXPECT) & here
        return np.where(taken, found & ~(63 << 26) | int(TileMode.HOLD) << 26, found)


class ParcelOverTiles:
    """A parcel that begins at the entry, rides over the array, and leaves in the east."""

    def __init__(self, lattice: Lattice) -> None:
        self._place_m = (np.stack((lattice.columns, lattice.rows), axis=1) + 0.5) * PITCH_M
        self._end_m = float(self._place_m[:, 0].max()) - 0.05

    def start(self) -> Place | None:
        middle = 0.5 * SIDE * PITCH_M
        return (middle, middle)

    def covered(self, state: Place | None) -> Sequence[bool]:
        if state is None:
            return [False] * len(self._place_m)
        return (np.abs(self._place_m - state) <= HALF_M).all(axis=1).tolist()

    def after(self, state: Place | None, speeds_m_s: Sequence[tuple[float, float] | None]) -> Place | None:
        if state is None:
            return None
        pulls = [
            speed
            for speed, over in zip(speeds_m_s, self.covered(state), strict=True)
            if over and speed is not None
        ]
        if not pulls:
            return state
        x, y = np.round((np.array(state) + PERIOD_S * np.mean(pulls, axis=0)) / GRID_M) * GRID_M
        return None if x > self._end_m else (float(x), float(y))
