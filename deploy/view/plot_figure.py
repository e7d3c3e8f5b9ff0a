"""Figure of a time series below the map."""

# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false
# (Bokeh leaves the keywords of its drawing methods untyped.)

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, final

import numpy as np
from bokeh.models import ColumnDataSource, Range1d, Span
from bokeh.plotting import figure

from deploy.view.map_figure import paint_axes
from deploy.view.series import LINES

if TYPE_CHECKING:
    from deploy.view.palette import Theme
    from deploy.view.series import Series
    from deploy.view.source import Floats

_DASHES: Final = ("solid", "dashed", "dotdash", "dotted", "solid", "dashed")
"""Pattern of each line, so that lines differ not only by colour."""


@final
class PlotFigure:
    """Bokeh figure with up to `LINES` lines over time and a mark at the viewer's position.

    Attributes:
        figure: The Bokeh figure.
    """

    def __init__(self) -> None:
        self._span: Any = Range1d(start=0.0, end=1.0)
        self._height: Any = Range1d(start=0.0, end=1.0)
        self.figure = figure(
            name="plot",
            x_range=self._span,
            y_range=self._height,
            tools="",
            toolbar_location=None,
            sizing_mode="stretch_both",
            min_border=2,
            x_axis_label="s",
        )
        self._sources = [ColumnDataSource({"x": [], "y": []}) for _ in range(LINES)]
        self._lines: list[Any] = [
            self.figure.line("x", "y", source=source, line_width=1.8, line_dash=dash, visible=False)
            for source, dash in zip(self._sources, _DASHES, strict=True)
        ]
        self._now = Span(location=0.0, dimension="height", line_width=1.5)
        self.figure.add_layout(self._now)

    def show(self, series: Series, begin_s: float, end_s: float) -> None:
        """Draw a series over a span of time, s."""
        count = series.values.shape[1] if series.values.ndim == 2 else 0
        for k, (source, line) in enumerate(zip(self._sources, self._lines, strict=True)):
            line.visible = k < count and k < len(series.names)
            y = series.values[:, k] if line.visible else np.zeros(0)
            source.data = {"x": series.time_s if line.visible else np.zeros(0), "y": y}
        self._span.start, self._span.end = begin_s, max(end_s, begin_s + 1e-9)
        self._height.start, self._height.end = _limits(series.values[:, : len(series.names)])
        self.figure.yaxis[0].axis_label = series.unit or "value"

    def mark(self, time_s: float) -> None:
        """Move the mark of the viewer's position."""
        self._now.location = time_s

    def paint(self, theme: Theme) -> None:
        """Set the colours of a theme."""
        paint_axes(self.figure, theme)
        self._now.line_color = theme.ink
        for line, colour in zip(self._lines, theme.lines, strict=False):
            line.glyph.line_color = colour


def _limits(values: Floats) -> tuple[float, float]:
    """Return the limits of an axis for values, with some room; absent parcels have none."""
    known = values[np.isfinite(values)]
    if not len(known):
        return 0.0, 1.0
    low, high = float(known.min()), float(known.max())
    room = 0.08 * (high - low) or max(0.05 * abs(high), 1e-3)
    return low - room, high + room
