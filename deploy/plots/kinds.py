"""Registry of the plots of a recording: a new kind is a function and a line here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from deploy.errors import InputError
from deploy.plots.fields import field_figure, loads_figure
from deploy.plots.overview import draw_overview
from deploy.plots.panels import phase_figure, time_figure, torque_figure
from deploy.plots.theme import write_picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from deploy.recordings.reader import Recording

_OF_A_RUN: Final[Mapping[str, Callable[[Recording], Figure]]] = {
    "time": time_figure,
    "phase": phase_figure,
    "torque": torque_figure,
}
_AT_AN_INSTANT: Final[Mapping[str, Callable[[Recording, int], Figure]]] = {
    "loads": loads_figure,
    "field": field_figure,
}
KINDS: Final = ("overview", *_OF_A_RUN, *_AT_AN_INSTANT)


def draw_kind(recording: Recording, kind: str, path: str | Path, at_s: float | None = None) -> None:
    """Draw a plot of a recording. The file is written whole or not at all.

    Args:
        recording: The recording, whole or cut.
        kind: One of ``KINDS``.
        path: The file to write, a PNG, SVG or PDF by its suffix.
        at_s: Time of the instant of ``loads`` and ``field``, s; the nearest instant is drawn. None: the last one.

    Raises:
        InputError: There is no such kind, the recording has no instant, or ``at_s`` is beyond it.
        DeployError: The file can't be written.
    """
    if kind == "overview":
        draw_overview(recording, path)
    elif kind in _OF_A_RUN:
        write_picture(lambda: _OF_A_RUN[kind](recording), path)
    elif kind in _AT_AN_INSTANT:
        instant = _instant(recording, at_s)
        write_picture(lambda: _AT_AN_INSTANT[kind](recording, instant), path)
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
