"""The pattern of sensors under a parcel as a map of bits, gathered along a tree a slice at a time.

A cell's bits have a place by its row and column modulo 16: whoever reads the map and is in the group knows which cell
is meant, for no group is wider than that. A *slice* is four rows of one sensor: 64 cells in two words of 64 bits, one
that says of which cells something is known, one that says which of those sense a parcel.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cell_firmware.firmware import Bools, Floats

Words = NDArray[np.uint64]
Integers = NDArray[np.int64]

WINDOW: Final = 16
"""Rows and columns of the map."""
BANDS: Final = 4
"""Slices of a sensor."""
FIELDS: Final = [("slice", "u1"), ("known", "<u8"), ("covered", "<u8")]
"""What a message carries of it: 17 bytes."""
_BITS: Final = np.arange(64, dtype=np.uint64)
_ONE: Final = np.uint64(1)
_NONE: Final = np.uint64(0)


class Map(NamedTuple):
    """Maps, ``(..., slices)`` words each."""

    known: Words
    covered: Words


def own(row: Integers, column: Integers, presence: Bools, member: Bools) -> Map:
    """What cells know by themselves, ``(n, slices)``: members of a group their own bits, others nothing."""
    band = np.where(member, row % WINDOW // BANDS, -1)
    bit = np.left_shift(_ONE, (row % BANDS * WINDOW + column % WINDOW).astype(np.uint64))
    here = np.where(np.arange(BANDS) == band[:, None], bit[:, None], _NONE)
    sensors = range(presence.shape[1])
    covered = [np.where(presence[:, s, None], here, _NONE) for s in sensors]
    return Map(np.concatenate([here for _ in sensors], axis=1), np.concatenate(covered, axis=1))


def heard(before: Map, told: NDArray[Any], received: Bools, counts: Bools) -> Map:
    """The neighbours' maps ``(n, 4, slices)`` with the slices that have just come in; nothing of who is silent."""
    slices = int(before.known.shape[2])
    slice_: Integers = told["slice"].astype(np.int64)
    fresh = received[:, :, None] & (slice_[:, :, None] == np.arange(slices))
    known = np.where(fresh, told["known"][:, :, None], before.known)
    covered = np.where(fresh, told["covered"][:, :, None], before.covered)
    listened = counts[:, :, None]
    return Map(np.where(listened, known, _NONE), np.where(listened, covered, _NONE))


def gathered(mine: Map, theirs: Map, children: Bools) -> Map:
    """Maps ``(n, slices)``: one's own bits and those of the children."""
    return Map(_joined(mine[0], theirs[0], children), _joined(mine[1], theirs[1], children))


def _joined(mine: Words, theirs: Words, children: Bools) -> Words:
    of_children = np.where(children[:, :, None], theirs, _NONE)
    return mine | of_children[:, 0] | of_children[:, 1] | of_children[:, 2] | of_children[:, 3]


def next_slice(whole: Map, sent: Map, turn: Integers) -> Integers:
    """Which slice is told next, ``(n,)``: one that has changed since it was told, else the one whose turn it is."""
    slices = int(whole.known.shape[1])
    changed = (whole.known != sent.known) | (whole.covered != sent.covered)
    waits = (np.arange(slices) - turn[:, None]) % slices + np.where(changed, 0, slices)
    return waits.argmin(axis=1)


def noted(sent: Map, whole: Map, told: Integers) -> Map:
    """What has been told of each slice, now that one is told."""
    now = np.arange(int(whole.known.shape[1])) == told[:, None]
    return Map(np.where(now, whole.known, sent.known), np.where(now, whole.covered, sent.covered))


def unfolded(words: Words, row: Integers, column: Integers) -> Bools:
    """Maps ``(n, slices)`` as seen from the cells themselves, ``(n, sensors, 16, 16)``: their own place is [8, 8]."""
    n, slices = words.shape
    bits = (words[:, :, None] >> _BITS & _ONE).astype(np.bool_)
    grid = bits.reshape(n, slices // BANDS, WINDOW, WINDOW)
    steps = np.arange(WINDOW) - WINDOW // 2
    rows, columns = (row[:, None] + steps) % WINDOW, (column[:, None] + steps) % WINDOW
    return grid[
        np.arange(n)[:, None, None, None],
        np.arange(slices // BANDS)[None, :, None, None],
        rows[:, None, :, None],
        columns[:, None, None, :],
    ]


def places(sensors_m: Floats, pitch_m: float) -> Floats:
    """``(2, sensors * 256)``, m: where the sensors of ``unfolded`` are, from the cell's own centre."""
    steps = (np.arange(WINDOW) - WINDOW // 2) * pitch_m
    x, y = np.broadcast_arrays(steps[None, None, :], steps[None, :, None])
    across = x + sensors_m[:, 0, None, None]
    along = y + sensors_m[:, 1, None, None]
    return np.stack((across.reshape(-1), along.reshape(-1)))


def hops(sensors: int) -> Integers:
    """``(sensors * 256,)``: how many links away those are, if no cell is missing on the way."""
    steps = abs(np.arange(WINDOW) - WINDOW // 2)
    return np.tile((steps[:, None] + steps[None, :]).reshape(-1), sensors)
