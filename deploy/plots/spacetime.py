"""Space-time plot of a recording: a register of a line of cells over time, as colours."""

# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# (matplotlib leaves the keywords of its drawing methods untyped.)

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from deploy.errors import InputError
from deploy.plots.overview import subtitle_of
from deploy.plots.theme import DPI, draw_heading
from deploy.util.cell_ranges import select_cells

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from deploy.recordings.recording import Recording

_LABELLED: Final = 40
"""Most cells whose names are written along the axis."""
_PARTS: Final = 4
"""Most components of a register that are drawn."""
_HEAD_IN, _FOOT_IN, _LEFT_IN, _RIGHT_IN, _GAP_IN, _WIDE_IN, _BAR_IN = 1.05, 0.6, 0.85, 0.85, 0.3, 6.2, 0.16


def spacetime_figure(recording: Recording, register: str | None, cells: str | None) -> Figure:
    """Draw a register of cells over time, a panel a component that varies.

    Args:
        recording: Of a run with ``--registers``.
        register: Name of the register; None: of the program's, one with the fewest components, fractions first.
        cells: Line of cells, as ``deploy.util.cell_ranges`` has them; None: the middle row.

    Raises:
        InputError: The recording has no registers, or no such register.
    """
    from matplotlib.figure import Figure

    name = chosen_register(recording, register)
    places = [(int(row), int(column)) for row, column in recording.header["cells"]]
    if cells is None:
        rows = sorted({row for row, _ in places})
        chosen = np.array([i for i, (row, _) in enumerate(places) if row == rows[len(rows) // 2]])
    else:
        chosen = select_cells(cells, places, "--cells")
    values = recording.registers[name][:, chosen].reshape(len(recording.register_tick), len(chosen), -1)
    values = values.astype(np.float64)
    found = [part for part in range(values.shape[2]) if np.ptp(values[:, :, part]) != 0.0][:_PARTS] or [0]
    parts = len(found)
    tall = min(max(0.16 * len(chosen), 1.6), 4.5)
    width = _LEFT_IN + _WIDE_IN + 0.15 + _BAR_IN + _RIGHT_IN
    height = _HEAD_IN + parts * tall + (parts - 1) * _GAP_IN + _FOOT_IN
    figure = Figure(figsize=(width, height), dpi=DPI, facecolor="white")
    edges = _edges(recording)
    for place, part in enumerate(found):
        bottom = height - _HEAD_IN - (place + 1) * tall - place * _GAP_IN
        axes = figure.add_axes((_LEFT_IN / width, bottom / height, _WIDE_IN / width, tall / height))
        field = np.ma.masked_invalid(values[:, :, part].T)
        mesh = axes.pcolormesh(
            edges, np.arange(len(chosen) + 1) - 0.5, field, cmap="viridis", rasterized=True
        )
        _label_cells(axes, [places[int(cell)] for cell in chosen])
        if place == parts - 1:
            axes.set_xlabel("time (s)")
        else:
            axes.set_xticklabels([])
        left = _LEFT_IN + _WIDE_IN + 0.15
        bar = figure.add_axes((left / width, bottom / height, _BAR_IN / width, tall / height))
        figure.colorbar(mesh, cax=bar, label=name if values.shape[2] == 1 else f"{name}[{part}]")
    track = recording.run_trace()
    note = f"{name} over cells and time"
    draw_heading(figure, track.title or track.scene, f"{subtitle_of(track)}  ·  {note}", 0.35)
    return figure


def chosen_register(recording: Recording, register: str | None) -> str:
    """Return the name of the register to draw: the one named, or one of the program's.

    Raises:
        InputError: The recording has no registers, or no such register.
    """
    registers = recording.registers
    names = sorted(name for name, array in registers.items() if array.dtype.kind in "biuf")
    if not names:
        raise InputError(f"{recording.path}: has no registers; record them with mdms run --registers")
    if register is None:
        own = [name for name in names if name.startswith("firmware.")] or names
        return min(own, key=lambda name: (registers[name].dtype.kind != "f", registers[name][0].size))
    if register not in names:
        raise InputError(f"--register {register}: must be one of {', '.join(names)}")
    return register


def _edges(recording: Recording) -> NDArray[np.float64]:
    """Return the bounds of the registers' ticks, s, ``(R + 1,)``."""
    seconds = recording.time_s
    period = float(seconds[1] - seconds[0]) if len(seconds) > 1 else 1.0
    ticks = recording.register_tick
    step = int(ticks[1] - ticks[0]) if len(ticks) > 1 else 1
    return np.append(ticks, ticks[-1] + step).astype(np.float64) * period


def _label_cells(axes: Any, cells: list[tuple[int, int]]) -> None:
    step = -(-len(cells) // _LABELLED)
    axes.set_yticks(range(0, len(cells), step))
    size = 6.5 if len(cells) > 12 else 8
    axes.set_yticklabels([f"{row},{column}" for row, column in cells[::step]], fontsize=size)
    axes.set_ylabel("cell")
