"""Time series for the page's plots."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from deploy.view.source import Floats, Ints, RunSource

POINTS: Final = 1_200
"""Most points of a line: as many as the plot has pixels."""
LINES: Final = 6
"""Most lines of a plot."""


class Series(NamedTuple):
    """Lines of a plot.

    Attributes:
        title: Subject of the plot.
        unit: Unit of the values.
        names: Names of the lines.
        time_s: ``(k,)`` times.
        values: ``(k, lines)`` values; NaN where there are none.
    """

    title: str
    unit: str
    names: tuple[str, ...]
    time_s: Floats
    values: Floats


def _rows(source: RunSource) -> Ints:
    """Return the instants to draw: all, or every k-th and the last."""
    count = len(source.times_s)
    step = max(1, -(-count // POINTS))
    rows = np.arange(0, count, step)
    return np.append(rows, count - 1) if count and rows[-1] != count - 1 else rows


def parcel_series(source: RunSource, parcel: int, tab: str) -> Series:
    """Return position, angle, velocity or spin of a parcel."""
    columns, names, unit = _PARCEL_TABS[tab]
    rows = _rows(source)
    values = source.states[rows, parcel][:, columns]
    return Series(f"parcel {parcel}", unit, names, source.times_s[rows], values)


def wheel_series(source: RunSource, cell: int) -> Series:
    """Return the wheel speeds of a cell."""
    rows = _rows(source)
    row, column = source.header["cells"][cell]
    return Series(
        f"cell {row},{column}", "m/s", ("x", "y"), source.times_s[rows], source.speeds_of(cell, rows)
    )


def register_series(source: RunSource, cell: int, name: str) -> Series:
    """Return the numbers of a register of a cell."""
    row, column = source.header["cells"][cell]
    title = f"{name} of cell {row},{column}"
    if name not in source.register_names():
        return Series(title, "", (), np.zeros(0), np.zeros((0, 0)))
    times, values = source.register_series(name, cell)
    step = max(1, -(-len(times) // POINTS))
    count = min(values.shape[1], LINES)
    names = (name.rpartition(".")[2],) if count == 1 else tuple(f"[{k}]" for k in range(count))
    return Series(title, "", names, times[::step], values[::step, :count])


_PARCEL_TABS: Final[dict[str, tuple[list[int], tuple[str, ...], str]]] = {
    "position": ([0, 1], ("x", "y"), "m"),
    "angle": ([2], ("angle",), "rad"),
    "velocity": ([3, 4], ("vx", "vy"), "m/s"),
    "spin": ([5], ("spin",), "rad/s"),
}
PARCEL_TABS: Final = tuple(_PARCEL_TABS)
"""Tabs with plots of a parcel."""
