"""Registry of the plots of a recording: a new kind is a function and a line here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from deploy.errors import InputError
from deploy.plots.fields import field_figure, loads_figure
from deploy.plots.overview import draw_overview
from deploy.plots.panels import phase_figure, time_figure, torque_figure
from deploy.plots.sequence import sequence_figure
from deploy.plots.spacetime import spacetime_figure
from deploy.plots.theme import write_picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from deploy.recordings.recording import Recording

_OF_A_RUN: Final[Mapping[str, Callable[[Recording], Figure]]] = {
    "time": time_figure,
    "phase": phase_figure,
    "torque": torque_figure,
}
AT_AN_INSTANT: Final = ("loads", "field")
"""Kinds that draw all cells at an instant."""
OF_CELLS: Final = ("sequence", "spacetime")
"""Kinds that draw chosen cells over time."""
KINDS: Final = ("overview", *_OF_A_RUN, *AT_AN_INSTANT, *OF_CELLS)


class PlotSelection(NamedTuple):
    """Part of a recording that a plot draws; each goes with some kinds only.

    Attributes:
        at_s: Time of the instant of ``loads`` and ``field``, s; the nearest instant is drawn. None: the last one.
        cells: Cells of ``sequence`` and ``spacetime``, as ``deploy.util.cell_ranges`` has them. None: the traced cells;
            the middle row.
        ticks: First and last tick of ``sequence``. None: the first 12 traced.
        register: Name of the register of ``spacetime`` and ``field``. None: one of the program's variables; the wheels'
            speed.
    """

    at_s: float | None = None
    cells: str | None = None
    ticks: tuple[int, int] | None = None
    register: str | None = None


_ALL: Final = PlotSelection()


def draw_kind(recording: Recording, kind: str, path: str | Path, choice: PlotSelection = _ALL) -> None:
    """Draw a plot of a recording. The file is written whole or not at all.

    Args:
        recording: The recording, whole or cut.
        kind: One of ``KINDS``.
        path: The file to write, a PNG, SVG or PDF by its suffix.
        choice: Part of the recording to draw.

    Raises:
        InputError: There is no such kind, or the recording has nothing of what is to be drawn.
        DeployError: The file can't be written.
    """
    if kind == "overview":
        draw_overview(recording, path)
    elif kind in _OF_A_RUN:
        write_picture(lambda: _OF_A_RUN[kind](recording), path)
    elif kind in AT_AN_INSTANT:
        instant = _instant(recording, choice.at_s)
        if kind == "loads":
            write_picture(lambda: loads_figure(recording, instant), path)
        else:
            write_picture(lambda: field_figure(recording, instant, choice.register), path)
    elif kind == "sequence":
        write_picture(lambda: sequence_figure(recording, choice.cells, choice.ticks), path)
    elif kind == "spacetime":
        write_picture(lambda: spacetime_figure(recording, choice.register, choice.cells), path)
    else:
        raise InputError(f"kind {kind}: must be one of {', '.join(KINDS)}")


def _instant(recording: Recording, at_s: float | None) -> int:
    if not len(recording.tick):
        raise InputError(f"{recording.path}: has no instant to draw")
    if at_s is None:
        return len(recording.tick) - 1
    end_s = float(recording.time_s[-1])
    if not 0.0 <= at_s <= end_s:
        raise InputError(f"--at {at_s:g}: the recording has the time from 0 to {end_s:g} s")
    return int(np.argmin(np.abs(recording.time_s - at_s)))
