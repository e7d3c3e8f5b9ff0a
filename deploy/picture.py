"""What all pictures have in common: how they look, their heading, and that their file is whole or not there."""

# pyright: reportUnknownMemberType=false
# (matplotlib leaves the keywords of its drawing methods untyped.)

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deploy.files import written_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 110
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
}
"""What a person's own matplotlibrc must not change."""


def write_picture(make: Callable[[], Figure], path: str | Path) -> None:
    """Write a figure as a PNG, without a display; the file is written whole or not at all.

    Args:
        make: Draws the figure.
        path: The file to write.

    Raises:
        DeployError: It can't be written.
    """
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    with mpl.rc_context(_STYLE):
        canvas = FigureCanvasAgg(make())
        with written_whole(Path(path)) as draft:
            canvas.print_png(str(draft))


def draw_heading(figure: Figure, title: str, subtitle: str, left_in: float) -> None:
    """Title and subtitle in the upper left corner, ``left_in`` inches from the edge."""
    width, height = figure.get_size_inches()
    for text, down, size, weight, shade in (
        (_shortened(title, 80), 0.34, 14, "bold", "#22272e"),
        (subtitle, 0.62, 9, "normal", "#5b6570"),
    ):
        figure.text(
            left_in / width,
            1 - down / height,
            text,
            size=size,
            weight=weight,
            color=shade,
            va="center",
            parse_math=False,
        )


def _shortened(text: str, length: int) -> str:
    return text if len(text) <= length else text[: length - 1].rstrip() + "…"
