"""Occupancy maps: readings of the sensors under a parcel as bit maps, gathered along a tree.

The position of a cell's bit is its row and column modulo 16, which is unique within a group, as no group is wider. Each
sensor has two maps, of 256 bits in four words: cells with a known reading, and cells that sense a parcel. A message
carries both maps of one sensor.
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
WORDS: Final = 4
"""Of a map, each for four rows."""
_KNOWN: Final = tuple(f"known_{word}" for word in range(WORDS))
_COVERED: Final = tuple(f"covered_{word}" for word in range(WORDS))
FIELDS: Final = [("sensor", "u1"), *((name, "<u8") for name in (*_KNOWN, *_COVERED))]
"""Fields of the maps in a message: 65 bytes."""
_BITS: Final = np.arange(64, dtype=np.uint64)
_ONE: Final = np.uint64(1)
_NONE: Final = np.uint64(0)


class OccupancyMap(NamedTuple):
    """Occupancy maps of n cells: ``(n, sensors, 4)`` words each, or ``(n, 4, sensors, 4)`` for neighbours."""

    known: Words
    covered: Words

    def take(self, rows: Integers) -> OccupancyMap:
        """Select the maps of ``rows``, in order."""
        return OccupancyMap(self.known[rows], self.covered[rows])


def own(row: Integers, column: Integers, presence: Bools, member: Bools) -> OccupancyMap:
    """Return each cell's own map: its own bits for members of a group, empty for others."""
    word = np.where(member, row % WINDOW // WORDS, -1)
    bit = np.left_shift(_ONE, (row % WORDS * WINDOW + column % WINDOW).astype(np.uint64))
    here = np.where(np.arange(WORDS) == word[:, None], bit[:, None], _NONE)
    known = np.repeat(here[:, None], presence.shape[1], axis=1)
    return OccupancyMap(known, np.where(presence[:, :, None], known, _NONE))


def update_neighbours(
    before: OccupancyMap, message: NDArray[Any], received: Bools, counts: Bools
) -> OccupancyMap:
    """Update the neighbours' maps with received messages; maps of silent neighbours are cleared."""
    sensors = int(before.known.shape[2])
    number: Integers = message["sensor"].astype(np.int64)
    fresh = (received[:, :, None] & (number[:, :, None] == np.arange(sensors)))[:, :, :, None]
    listened = counts[:, :, None, None]
    maps = [
        np.where(fresh, np.stack([message[name] for name in names], axis=2)[:, :, None], old)
        for names, old in ((_KNOWN, before.known), (_COVERED, before.covered))
    ]
    return OccupancyMap(np.where(listened, maps[0], _NONE), np.where(listened, maps[1], _NONE))


def merge(mine: OccupancyMap, theirs: OccupancyMap, children: Bools) -> OccupancyMap:
    """Merge each cell's own map with its children's maps."""
    return OccupancyMap(
        _joined(mine.known, theirs.known, children), _joined(mine.covered, theirs.covered, children)
    )


def _joined(mine: Words, theirs: Words, children: Bools) -> Words:
    of_children = np.where(children[:, :, None, None], theirs, _NONE)
    return mine | of_children[:, 0] | of_children[:, 1] | of_children[:, 2] | of_children[:, 3]


def next_sensor(whole: OccupancyMap, sent: OccupancyMap, turn: Integers) -> Integers:
    """Choose the sensor to send next, ``(n,)``: sensors with changed maps first, else by turn."""
    sensors = int(whole.known.shape[1])
    changed = ((whole.known != sent.known) | (whole.covered != sent.covered)).any(axis=2)
    waits = (np.arange(sensors) - turn[:, None]) % sensors + np.where(changed, 0, sensors)
    return waits.argmin(axis=1)


def mark_sent(sent: OccupancyMap, whole: OccupancyMap, sensor: Integers) -> OccupancyMap:
    """Return the sent maps after sending the maps of ``sensor``."""
    now = (np.arange(int(whole.known.shape[1])) == sensor[:, None])[:, :, None]
    return OccupancyMap(np.where(now, whole.known, sent.known), np.where(now, whole.covered, sent.covered))


def write_message(message: NDArray[Any], whole: OccupancyMap, sensor: Integers) -> None:
    """Put one sensor's maps into messages ``(n,)``."""
    every = np.arange(len(sensor))
    message["sensor"] = sensor
    for word in range(WORDS):
        message[_KNOWN[word]] = whole.known[every, sensor, word]
        message[_COVERED[word]] = whole.covered[every, sensor, word]


def unfolded(words: Words, row: Integers, column: Integers) -> Bools:
    """Unpack maps ``(n, sensors, 4)`` around the cells, ``(n, sensors, 16, 16)``: a cell's own place is [8, 8]."""
    n, sensors = words.shape[:2]
    bits = (words[:, :, :, None] >> _BITS & _ONE).astype(np.bool_)
    steps = np.arange(WINDOW) - WINDOW // 2
    rows, columns = (row[:, None] + steps) % WINDOW, (column[:, None] + steps) % WINDOW
    return bits.reshape(n, sensors, WINDOW, WINDOW)[
        np.arange(n)[:, None, None, None],
        np.arange(sensors)[None, :, None, None],
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
