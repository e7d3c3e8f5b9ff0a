"""Chatter about an angle of rest: savings from capture, and its cost in accuracy."""

# pyright: reportUnknownMemberType=false
# (matplotlib leaves the keywords of its drawing methods untyped.)

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import NDArray

from deploy.plots.map_view import INK
from deploy.plots.theme import write_picture
from deploy.studies.accuracy.experiments.markdown import (
    Section,
    error,
    milliseconds,
    panels,
    picture,
    power,
    prose,
    table,
)
from deploy.studies.accuracy.experiments.runs import (
    ExperimentTrace,
    changes_at,
    max_displacement_m,
    run,
    scene_with,
)
from deploy.util.colours import colour
from plant.array import CellArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from deploy.scenes.scene import Scene
    from plant.wheels import Floats

SIZES_M = ((0.68, 0.42), (0.72, 0.42), (0.40, 0.42))
SECONDS = 20.0
AT_REST_S = 40.0
"""By then the centre is where it stays, to the last digit: it swings like e^(-t mu g / 2)."""
LOCATED_M = 1e-14
"""A capture so small that nothing is captured."""
CAPTURES_M = (1e-5, 1e-6, 1e-8, 1e-10)
TOLERANCE = 1e-12
FILE = "chatter.png"
_HEADING = (
    "parcel, m",
    "`capture_m`",
    "changes",
    "time",
    "apart from located, m",
    f"angle at {SECONDS:g} s, rad",
    f"off the closed form at {AT_REST_S:g} s, rad",
)
_SEEN = (
    "Left: changes of supports so far against time, exponential where none is captured. "
    "Right: how far a corner of the captured runs is from where it is with all located"
)
_SAMPLE_S = 0.02
_LEAST_M = 1e-15
"""Less is not drawn."""


@final
@dataclass(frozen=True, slots=True)
class ChatterRow:
    """Result for a parcel size and a ``capture_m``.

    Attributes:
        size_m: length and width.
        capture_m: ``LOCATED_M`` where every crossing is located.
        changes: of supports.
        spent_s: processor time.
        apart_m: the farthest that any corner is from where it is when every crossing is located.
        angle_rad: at the end.
        off_rad: how far it is, when the centre has come to rest, from where the cell lies on the edge, in closed form;
            None: not run that far.
        trace_s: ``(T,)`` times.
        so_far: changes until then, in a run that stops at each time; shorter than ``trace_s`` where that run ended as
            ``unstable``.
        trace_m: ``(T,)`` how far any corner is then from where it is when every crossing is located.
    """

    size_m: tuple[float, float]
    capture_m: float
    changes: int
    spent_s: float
    apart_m: float
    angle_rad: float
    off_rad: float | None
    trace_s: Floats
    so_far: NDArray[np.int64]
    trace_m: Floats


def measure(repeats: int) -> list[ChatterRow]:
    """Every size and capture."""
    return [row for size in SIZES_M for row in _size(size, repeats)]


def _size(size_m: tuple[float, float], repeats: int) -> list[ChatterRow]:
    scene = _scene(size_m, SECONDS)
    runs = {
        capture: run(scene, _solver(capture), sample_s=_SAMPLE_S, repeats=repeats)
        for capture in (*CAPTURES_M, LOCATED_M)
    }
    located = runs[LOCATED_M]
    array = CellArray(scene.array)
    last = next(event.cells[0] for event in reversed(located.events) if event.kind.startswith("support"))
    rest = resting_angle(array.positions_m[array.lattice.index(last)], size_m, float(located.state[-1, 2]))
    return [_row(size_m, capture, one, located, rest) for capture, one in runs.items()]


def _scene(size_m: tuple[float, float], duration_s: float) -> Scene:
    length, width = size_m
    return scene_with("elliptic", f"duration_s={duration_s}", f"parcels.0.size_m=[{length}, {width}]")


def _solver(capture_m: float) -> dict[str, Any]:
    return {"name": "exact", "tolerance": TOLERANCE, "capture_m": capture_m}


def resting_angle(cell_m: Floats, size_m: tuple[float, float], near_rad: float) -> float:
    """The angle at which a cell ``(2,)`` lies on an edge of a rectangle centred on the origin: closed form.

    Args:
        cell_m: where the cell is.
        size_m: of the rectangle.
        near_rad: which of the eight such angles: the one nearest to this.
    """
    distance, direction = float(np.hypot(*cell_m)), float(np.arctan2(cell_m[1], cell_m[0]))
    found: list[float] = []
    for half, turn in zip(size_m, (0.0, np.pi / 2.0), strict=True):
        if half / 2.0 <= distance:
            spread = float(np.arccos(half / 2.0 / distance))
            found += [direction - turn + side * np.pi + sign * spread for side in (0, 1) for sign in (-1, 1)]
    away = [float(np.mod(angle - near_rad + np.pi, 2.0 * np.pi) - np.pi) for angle in found]
    return near_rad + min(away, key=abs)


def _row(
    size_m: tuple[float, float],
    capture_m: float,
    one: ExperimentTrace,
    located: ExperimentTrace,
    rest_rad: float,
) -> ChatterRow:
    end = float(one.state[-1, 2])
    apart = max_displacement_m(one, located)
    off = None
    if capture_m != LOCATED_M:
        settled = run(_scene(size_m, AT_REST_S), _solver(capture_m), sample_s=AT_REST_S)
        off = abs(float(settled.state[-1, 2]) - rest_rad)
    return ChatterRow(
        size_m=size_m,
        capture_m=capture_m,
        changes=one.changes,
        spent_s=one.spent_s,
        apart_m=float(apart.max()),
        angle_rad=end,
        off_rad=off,
        trace_s=one.time_s,
        so_far=changes_at(_scene(size_m, SECONDS), _solver(capture_m), one.time_s),
        trace_m=apart,
    )


def section(repeats: int) -> Section:
    """The section of the page."""
    return describe(measure(repeats), repeats)


def describe(rows: Sequence[ChatterRow], repeats: int) -> Section:
    """Describe the measurements in Markdown."""
    first = [row for row in rows if row.size_m == SIZES_M[0]]
    located, captured = first[-1], next(row for row in first if row.capture_m == 1e-6)
    text = prose(
        "chatter",
        length=f"{SIZES_M[0][0]:g}",
        width=f"{SIZES_M[0][1]:g}",
        located=f"{located.changes:,}",
        captured=f"{captured.changes:,}",
        seconds=f"{SECONDS:g}",
        at_rest=f"{AT_REST_S:g}",
        sample=f"{_SAMPLE_S * 1e3:g}",
        stopped=f"{located.trace_s[len(located.so_far) - 1]:.2f}",
        picture=picture(FILE, _SEEN),
        table=table(_HEADING, [_line(row) for row in rows]),
        tolerance=power(TOLERANCE),
        repeats=str(repeats),
    )
    return Section(
        "Chatter, with and without capture", text, {FILE: partial(write_picture, partial(draw, first))}
    )


def _line(row: ChatterRow) -> tuple[str, ...]:
    none = row.capture_m == LOCATED_M
    return (
        f"{row.size_m[0]:.2f} × {row.size_m[1]:.2f}",
        "none" if none else power(row.capture_m),
        f"{row.changes:,}",
        milliseconds(row.spent_s),
        "–" if none else error(row.apart_m),
        f"{row.angle_rad:.10f}",
        "–" if row.off_rad is None else error(row.off_rad),
    )


def draw(rows: Sequence[ChatterRow]) -> Figure:
    """Changes so far, and what captured runs are off, against time; what is left of a coarser capture lies behind."""
    length, width = rows[0].size_m
    figure, (left, right) = panels(
        "Chatter about an angle of rest",
        f"elliptic, parcel {length:g} × {width:g} m  ·  crossings located one by one, and captured below capture_m",
        widths_in=(4.6, 4.6),
        height_in=3.4,
    )
    for number, row in enumerate(reversed(rows)):
        none = row.capture_m == LOCATED_M
        shade = INK if none else colour(number - 1)
        label = "all located" if none else f"capture_m = {power(row.capture_m)} m"
        so_far = np.maximum(row.so_far, 1)
        left.plot(row.trace_s[: len(so_far)], so_far, color=shade, lw=1.5, label=label)
        if len(so_far) < len(row.trace_s):
            left.plot(row.trace_s[len(so_far) - 1], so_far[-1], "X", ms=7, color=shade)
        if not none:
            right.plot(
                row.trace_s, np.maximum(row.trace_m, _LEAST_M), color=shade, lw=1.0, zorder=3 - 0.1 * number
            )
    left.set_ylabel("changes of supports so far")
    left.legend(frameon=False, fontsize=8, loc="upper left")
    right.set_ylabel("apart from all located (m)")
    right.set_ylim(bottom=_LEAST_M)
    for axes in (left, right):
        axes.set_yscale("log")
        axes.set_xlim(0.0, SECONDS)
        axes.set_xlabel("time (s)")
    return figure
