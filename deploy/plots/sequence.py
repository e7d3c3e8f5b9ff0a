"""Message sequence chart of a recording: a line a cell, an arrow a message."""

# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# (matplotlib leaves the keywords of its drawing methods untyped.)

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any, Final

from bus.wire.message_type import ITEMS, LENGTH
from deploy.errors import InputError
from deploy.plots.overview import subtitle_of
from deploy.plots.theme import DPI, draw_heading
from deploy.util.cell_ranges import ALL, select_cells
from deploy.util.formatting import plural

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from deploy.recordings.message_trace import TracedMessage
    from deploy.recordings.recording import Recording

Cell = tuple[int, int]
TICKS: Final = 12
"""Ticks that are drawn by default."""
_MOST_TICKS: Final = 200
_MOST_CELLS: Final = 24
_LABELLED: Final = 48
"""Most messages whose values are written beside their arrows."""
_LABEL_WIDTH: Final = 15
"""Most characters in a line of these values; there are two lines."""
_WIDE: Final = 10**8
"""Integers from which on labels round them."""
_COLOURS: Final = {
    "read": "#2f6f9f",
    "late": "#c77d0a",
    "altered": "#8a3fb0",
    "lost": "#c0392b",
    "repeated": "#8a3fb0",
    "made up": "#8a3fb0",
    "under way": "#8b95a1",
    "not traced": "#8b95a1",
}
"""Colour by fate; the ends of the arrows differ, too."""
_PAPER: Final[dict[str, Any]] = {"boxstyle": "square,pad=0.1", "fc": "white", "ec": "none"}
_LINE, _TEXT = "#aab3bd", "#3a424c"
_TICK_IN, _LABELLED_TICK_IN, _CELL_IN, _LABELLED_CELL_IN, _HEAD_IN, _FOOT_IN, _SIDE_IN, _KEY_IN = (
    0.36,
    0.6,
    1.15,
    1.7,
    1.25,
    0.35,
    0.85,
    1.35,
)


def sequence_figure(recording: Recording, cells: str | None, ticks: tuple[int, int] | None) -> Figure:
    """Draw the traced messages between cells; time runs downwards.

    Args:
        recording: Of a run with ``--trace-messages``.
        cells: Cells to draw, as ``deploy.util.cell_ranges`` has them; None: the traced cells.
        ticks: First and last tick to draw; None: the first 12 traced.

    Raises:
        InputError: The recording has no trace of the cells or the ticks, or they are too many for a chart.
    """
    from matplotlib.figure import Figure

    if not len(recording.trace_tick):
        raise InputError(
            f"{recording.path}: has no trace of messages; record one with mdms run --trace-messages"
        )
    names: list[Cell] = [(int(row), int(column)) for row, column in recording.header["cells"]]
    chosen = (
        recording.trace["cell"][0] if cells in (None, ALL) else select_cells(str(cells), names, "--cells")
    )
    shown = [names[int(cell)] for cell in chosen]
    traced = [names[int(cell)] for cell in recording.trace["cell"][0]]
    if not set(shown) & set(traced):
        known = " ".join(f"{row},{column}" for row, column in traced[:_MOST_CELLS])
        raise InputError(f"--cells {cells}: no message of these cells was traced, but of {known}")
    if len(shown) > _MOST_CELLS:
        raise InputError(
            f"--cells: a chart has room for {_MOST_CELLS} cells, not {len(shown)}; name some of them"
        )
    first, last = ticks or (int(recording.trace_tick[0]), int(recording.trace_tick[0]) + TICKS - 1)
    if last - first >= _MOST_TICKS:
        raise InputError(
            f"--ticks {first}-{last}: a chart has room for {_MOST_TICKS} ticks, not {last - first + 1}"
        )
    if last < recording.trace_tick[0] or first > recording.trace_tick[-1]:
        span = f"{recording.trace_tick[0]} to {recording.trace_tick[-1]}"
        raise InputError(f"--ticks {first}-{last}: the recording has a trace of the ticks {span}")
    messages = [
        one for one in recording.traced_messages(set(shown)) if _is_shown(one, set(shown), first, last)
    ]
    labelled = len(messages) <= _LABELLED
    across = max((_LABELLED_CELL_IN if labelled else _CELL_IN) * (len(shown) - 1), 2.6)
    width = 2 * _SIDE_IN + across + _KEY_IN
    height = _HEAD_IN + (_LABELLED_TICK_IN if labelled else _TICK_IN) * (last - first + 1) + _FOOT_IN
    figure = Figure(figsize=(width, height), dpi=DPI, facecolor="white")
    plot = (width - 2 * _SIDE_IN - _KEY_IN, height - _HEAD_IN - _FOOT_IN)
    axes = figure.add_axes((_SIDE_IN / width, _FOOT_IN / height, plot[0] / width, plot[1] / height))
    _draw_lines(axes, shown, first, last)
    place = {cell: float(number) for number, cell in enumerate(shown)}
    for message in messages:
        _draw_message(axes, message, place, first, labelled=labelled)
    _draw_key(axes, {message.fate for message in messages}, across)
    period_s = float(recording.time_s[1] - recording.time_s[0]) if len(recording.time_s) > 1 else 0.0
    track = recording.run_trace()
    note = f"{plural(len(messages), 'message')}, ticks {first} to {last} of {1e3 * period_s:.4g} ms"
    draw_heading(figure, track.title or track.scene, f"{subtitle_of(track)}  ·  {note}", 0.35)
    return figure


def _is_shown(message: TracedMessage, shown: set[Cell], first: int, last: int) -> bool:
    tick = message.read_tick if message.sent_tick is None else message.sent_tick
    return tick is not None and first <= tick <= last and {message.sender, message.receiver} <= shown


def _draw_lines(axes: Axes, cells: list[Cell], first: int, last: int) -> None:
    """Draw the cells' lines, with the ticks along the left."""
    for number, (row, column) in enumerate(cells):
        axes.plot([number, number], [first - 0.4, last + 0.6], color=_LINE, lw=1.0, zorder=1)
        axes.text(
            number, first - 0.6, f"{row},{column}", ha="center", va="bottom", color=_TEXT, weight="bold"
        )
    axes.set_xlim(-0.35, max(len(cells) - 1, 1) + 0.35)
    axes.set_ylim(last + 0.7, first - 0.5)
    step = max(1, (last - first + 1) // 25)
    axes.set_yticks(range(first, last + 1, step))
    axes.set_ylabel("tick")
    axes.set_xticks([])
    axes.spines["bottom"].set_visible(False)


def _draw_message(
    axes: Axes, message: TracedMessage, place: dict[Cell, float], first: int, *, labelled: bool
) -> None:
    """Draw an arrow from the sender's tick to the receiver's; a lost message ends half-way with a cross."""
    begin, end = place[message.sender], place[message.receiver]
    shade = _COLOURS[message.fate]
    sent = message.sent_tick
    read = message.read_tick
    if sent is None:
        assert read is not None, "this is a bug: a message neither sent nor read"
        start = (end + 0.35 * (1.0 if begin > end else -1.0), float(max(read - 1, first)))
    else:
        start = (begin, float(sent))
    if read is None:
        assert sent is not None, "this is a bug: a message neither sent nor read"
        stop = (begin + 0.5 * (end - begin), sent + 0.5)
        axes.plot([start[0], stop[0]], [start[1], stop[1]], color=shade, lw=1.1, ls=(0, (3, 2)), zorder=2)
        if message.fate == "lost":
            axes.plot(*stop, marker="x", ms=6, mew=1.6, color=shade, zorder=3)
    else:
        stop = (end, float(read))
        arrow: dict[str, Any] = {"arrowstyle": "-|>", "color": shade, "lw": 1.1, "shrinkA": 0, "shrinkB": 1}
        axes.annotate("", stop, start, arrowprops=arrow, zorder=2)
    if labelled:
        along = 0.5 if read is None else 0.25
        middle = (start[0] + along * (stop[0] - start[0]), start[1] + along * (stop[1] - start[1]))
        words = _words(message.read or message.sent)
        axes.text(*middle, words, size=6.5, color=shade, ha="center", va="center", bbox=_PAPER, zorder=4)


def _words(values: dict[str, Any]) -> str:
    """Return the values of a message in two short lines; of lists, the items that are used."""
    shown = list[str]()
    for name, value in values.items():
        stem, _, last = name.rpartition(".")
        length = values.get(f"{stem}.{LENGTH}") if last == ITEMS else None
        if last != LENGTH or f"{stem}.{ITEMS}" not in values:
            shown.append(_short(value if length is None else value[:length]))
    lines = textwrap.wrap(" ".join(shown), _LABEL_WIDTH, max_lines=2, placeholder="…", break_long_words=False)
    return "\n".join(lines)


def _short(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return f"[{','.join(_short(one) for one in value)}]"
    wide = isinstance(value, int) and abs(value) >= _WIDE
    return f"{value:.3g}" if wide or isinstance(value, float) else str(value)


def _draw_key(axes: Axes, fates: set[str], across_in: float) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=shade, lw=1.4, marker="x" if fate == "lost" else None, label=fate)
        for fate, shade in _COLOURS.items()
        if fate in fates
    ]
    if handles:
        right = 1.0 + 0.45 / across_in
        axes.legend(handles=handles, loc="upper left", bbox_to_anchor=(right, 1.0), frameon=False)
