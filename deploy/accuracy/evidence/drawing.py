"""What the pictures of the page have in common."""

# pyright: reportUnknownMemberType=false
# (matplotlib leaves the keywords of its drawing methods untyped.)

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from deploy.picture import DPI, draw_heading

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_HEAD, _FOOT, _LEFT, _RIGHT, _GAP = 0.98, 0.58, 0.82, 0.3, 0.95
"""Space around and between the panels, inches."""
GRID = "#e3e7ec"


def panels(
    title: str, subtitle: str, *, widths_in: Sequence[float], height_in: float
) -> tuple[Figure, list[Axes]]:
    """A figure with a heading and panels of these widths side by side, each with a light grid."""
    from matplotlib.figure import Figure

    width = _LEFT + sum(widths_in) + _GAP * (len(widths_in) - 1) + _RIGHT
    height = _HEAD + height_in + _FOOT
    figure = Figure(figsize=(width, height), dpi=DPI, facecolor="white")
    axes: list[Axes] = []
    left = _LEFT
    for each in widths_in:
        axes.append(figure.add_axes((left / width, _FOOT / height, each / width, height_in / height)))
        axes[-1].grid(visible=True, color=GRID, lw=0.7)
        axes[-1].set_axisbelow(True)
        left += each + _GAP
    draw_heading(figure, title, subtitle, 0.35)
    return figure, axes
