"""A row of tiles with one parcel, without physics: the parcel moves as the wheels under it do on the average."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from bus.lattice import Lattice
from cell_firmware.firmware import Inputs, Outputs, State
from cell_firmware.protocols.reserve_path import ReservePath
from cell_firmware.protocols.route import Route
from cell_firmware.tiles import messages
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


def with_a_second_exit(tiles: int) -> dict[str, Any]:
    """Parameters in which the parcel's label, 1, makes a difference."""
    given = parameters(tiles)
    return {**given, "exits": [*given["exits"], {"tile": [0, 0], "side": "north"}]}


class OneParcel(ReservePath):
    """``reserve_path`` with the condition that holds for one parcel: no two tiles have it."""

    def invariants(self, view: ArrayView) -> Iterable[tuple[str, Any]]:
        tile = np.array([column // SIDE for _, column in view.cells])
        own = view["own"]
        words = [newest(np.where(tile == one, own, 0)[None])[0] for one in range(int(tile.max()) + 1)]
        having = [int(doing(np.array([word]))[0]) >= TileMode.HOLD for word in words]
        yield "a parcel is in one reservation at most", sum(having) <= 1


class OneLabelled(Route):
    """``route`` with the same condition; a parcel is labelled 1 wherever it is sensed, by no scanner."""

    invariants = OneParcel.invariants  # pyright: ignore[reportAssignmentType]

    def required_effects(self) -> tuple[str, ...]:
        return ()

    def labels(self, inputs: Inputs) -> np.ndarray:
        return np.ones(len(inputs.presence), dtype=np.int64)


class Passing(OneLabelled):
    """``route`` with a condition for a run in which no fault holds the parcel up."""

    def eventually(self, view: ArrayView) -> Iterable[tuple[str, Any, int]]:
        yield "the tiles get rid of the parcel", doing(view["own"]) <= TileMode.FREE, 90


class PlainVersions(Passing):
    """Mutant: versions are compared as numbers, so that after a wrap no word is newer than an old one."""

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        serial, messages._ahead = messages._ahead, lambda serials, known: np.where(known, serials, -1)
        try:
            return super().step(state, inputs)
        finally:
            messages._ahead = serial


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
