"""Common style of all plots: fonts and colours, headings, and atomic writes of image files."""

# pyright: reportUnknownMemberType=false
# (matplotlib leaves the keywords of its drawing methods untyped.)

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from deploy.errors import InputError
from deploy.util.files import atomic_write

if TYPE_CHECKING:
    from matplotlib.backend_bases import RendererBase
    from matplotlib.figure import Figure
    from matplotlib.transforms import Bbox

DPI = 110
FORMATS: Final = ("png", "svg", "pdf")
"""File formats of pictures, by the file's suffix."""
_NOT_DATED: Final[dict[str, dict[str, None]]] = {
    "png": {},
    "svg": {"Date": None},
    "pdf": {"CreationDate": None},
}
"""Metadata to leave out, so that the same picture is the same file."""
_PAD_IN: Final = 0.08
"""Space around text that runs beyond the page, inches."""
_TITLE: Final[dict[str, Any]] = {"size": 14, "weight": "bold", "color": "#22272e"}
_SUBTITLE: Final[dict[str, Any]] = {"size": 9, "weight": "normal", "color": "#5b6570"}
_BETWEEN: Final = "  ·  "
"""Separates the facts of a subtitle."""
_STYLE: Any = {
    "font.size": 9,
    "axes.edgecolor": "#8b95a1",
    "axes.labelcolor": "#3a424c",
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.color": "#6b7580",
    "ytick.color": "#6b7580",
    "xtick.labelcolor": "#3a424c",
    "ytick.labelcolor": "#3a424c",
    "text.usetex": False,
    "svg.hashsalt": "mdms",
}
"""What a person's own matplotlibrc must not change."""


def format_of(path: Path) -> str:
    """Return the format that a picture's file name asks for: one of `FORMATS`.

    Raises:
        InputError: The suffix names no format of pictures.
    """
    suffix = path.suffix.lower().removeprefix(".")
    if suffix not in FORMATS:
        known = ", ".join(f".{name}" for name in FORMATS[:-1])
        raise InputError(f"output {path}: a plot's name must end in {known} or .{FORMATS[-1]}")
    return suffix


def plot_style() -> AbstractContextManager[None]:
    """Return a context in which figures have the common style, whatever a person's own settings are."""
    import matplotlib as mpl

    return mpl.rc_context(_STYLE)


def write_picture(make: Callable[[], Figure], path: str | Path) -> None:
    """Write a figure in the format of the file's suffix, without a display.

    The file is written whole or not at all. Text that runs beyond the page widens the page.

    Args:
        make: Draws the figure.
        path: The file to write.

    Raises:
        InputError: The suffix names no format of pictures.
        DeployError: It can't be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    kind = format_of(Path(path))
    with plot_style():
        figure = make()
        canvas = FigureCanvasAgg(figure)
        page = _page(figure, canvas.get_renderer())
        with atomic_write(Path(path)) as draft:
            canvas.print_figure(
                str(draft),
                format=kind,
                dpi=DPI,
                facecolor="white",
                bbox_inches=page,
                metadata=_NOT_DATED[kind],
            )


def _page(figure: Figure, renderer: RendererBase) -> Bbox:
    """Return the figure's page, widened to whatever is drawn beyond its edges, inches."""
    from matplotlib.transforms import Bbox

    page = Bbox.from_bounds(0.0, 0.0, *figure.get_size_inches())
    drawn = figure.get_tightbbox(renderer)
    if page.x0 <= drawn.x0 and page.y0 <= drawn.y0 and drawn.x1 <= page.x1 and drawn.y1 <= page.y1:
        return page
    return Bbox.union([page, drawn.padded(_PAD_IN)])


def draw_heading(figure: Figure, title: str, subtitle: str, left_in: float) -> None:
    """Draw title and subtitle in the upper left corner, ``left_in`` inches from the edge.

    A title that is wider than the page is cut short, a subtitle goes on in further lines.
    """
    width, height = figure.get_size_inches()
    room = float(width) - 2 * left_in
    lines = _lines(subtitle, room)
    rise = 0.06 * min(len(lines) - 1, 2)
    texts = [(0.34 - rise, _shortened(title, room), _TITLE)]
    texts += [(0.62 - 1.5 * rise + 0.16 * number, line, _SUBTITLE) for number, line in enumerate(lines)]
    for down, text, style in texts:
        figure.text(left_in / width, 1 - down / height, text, va="center", parse_math=False, **style)


def _lines(subtitle: str, room_in: float) -> list[str]:
    """Break a subtitle between its facts, into lines that fit."""
    first, *others = subtitle.split(_BETWEEN)
    lines = [first]
    for fact in others:
        longer = f"{lines[-1]}{_BETWEEN}{fact}"
        if _width_in(longer, _SUBTITLE) <= room_in:
            lines[-1] = longer
        else:
            lines.append(fact)
    return lines


def _shortened(text: str, room_in: float) -> str:
    if _width_in(text, _TITLE) <= room_in:
        return text
    length = len(text) - 1
    while length > 1 and _width_in(f"{text[:length].rstrip()}…", _TITLE) > room_in:
        length -= 1
    return f"{text[:length].rstrip()}…"


def _width_in(text: str, style: dict[str, Any]) -> float:
    """Return the width of a line of text, inches."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    font = FontProperties(size=style["size"], weight=style["weight"])
    return text_to_path.get_text_width_height_descent(text, font, ismath=False)[0] / 72.0
