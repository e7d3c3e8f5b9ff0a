"""Figure of the map: the array as an image, its marks, and the parcels."""

# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false
# (Bokeh leaves the keywords of its drawing methods untyped.)

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final, cast, final

import numpy as np
from bokeh.models import ColumnDataSource, PanTool, Range1d, WheelZoomTool
from bokeh.plotting import figure

from deploy.view.geometry import outlines

if TYPE_CHECKING:
    from deploy.view.geometry import CellGrid
    from deploy.view.palette import Theme
    from deploy.view.source import Floats

_MARGIN: Final = 0.6
"""Space around the array, pitches."""
_FEW, _SOME = 64, 900
"""Up to so many cells in sight arrows have larger heads."""
_NUMBERED: Final = 64
"""Up to this many parcels have their numbers on the map."""
_EMPTY: Final[dict[str, list[Any]]] = {"x": [], "y": []}


@final
class MapFigure:
    """Bokeh figure of the map. Every layer is one data source, sent only when its data has changed.

    Args:
        grid: Places of the cells.
        footprints: Corners of each parcel about its centre, ``(v, 2)``, m.
        rails: Corners of each guide rail, m.
        exits: Name and corners of each exit, m.

    Attributes:
        figure: The Bokeh figure.
    """

    def __init__(
        self,
        grid: CellGrid,
        footprints: Sequence[Floats],
        rails: Sequence[Floats],
        exits: Sequence[tuple[str, Floats]],
    ) -> None:
        self._grid = grid
        self._footprints = footprints
        self._colours: list[str] = []
        low, high = grid.low - _MARGIN * grid.pitch_m, grid.low + grid.size + _MARGIN * grid.pitch_m
        pan, zoom = PanTool(), WheelZoomTool(zoom_on_axis=False)
        self.figure = figure(
            name="map",
            x_range=Range1d(start=float(low[0]), end=float(high[0])),
            y_range=Range1d(start=float(low[1]), end=float(high[1])),
            tools=[pan, zoom],
            active_drag=pan,
            active_scroll=zoom,
            toolbar_location=None,
            sizing_mode="stretch_both",
            min_border=4,
            lod_threshold=None,
            x_axis_label="m",
            y_axis_label="m",
        )
        self.sources: dict[str, ColumnDataSource] = {}
        self._sent: dict[str, dict[str, Any]] = {}
        self._glyphs: dict[str, Any] = {}
        self._build(rails, exits)

    def _build(self, rails: Sequence[Floats], exits: Sequence[tuple[str, Floats]]) -> None:
        """Add the layers, lowest first."""
        plot, pitch = self.figure, self._grid.pitch_m
        low, size = self._grid.low.tolist(), self._grid.size.tolist()
        image = self._source("image", {"image": []})
        plot.image_rgba("image", low[0], low[1], size[0], size[1], source=image)
        corners = [corners for _, corners in exits]
        self._shapes("exits", corners, fill_alpha=0.12, line_dash="dashed", line_width=1.5)
        self._square("grid", pitch, line_width=2.0)
        self._shapes("rails", rails, fill_alpha=0.9, line_width=2.0)
        for name, side in (("captured", 0.82), ("faulty", 0.8), ("selected", 0.96)):
            self._square(name, side * pitch, line_width=2.5)
        messages = self._source("messages", {"x0": [], "y0": [], "x1": [], "y1": []})
        self._glyphs["messages"] = plot.segment(
            "x0", "y0", "x1", "y1", source=messages, line_width=3.0, line_alpha=0.8
        )
        arrow = self._source("arrows", {"x0": [], "y0": [], "x1": [], "y1": [], "angle": []})
        self._glyphs["shafts"] = plot.segment("x0", "y0", "x1", "y1", source=arrow, line_width=1.3)
        self._glyphs["heads"] = plot.scatter(
            "x1", "y1", angle="angle", marker="triangle", size=5, source=arrow, line_alpha=0.0
        )
        self._glyphs["dead"] = plot.scatter(
            "x", "y", marker="x", size=8, line_width=2.0, source=self._source("dead", _EMPTY)
        )
        self._glyphs["trails"] = plot.line(
            "x", "y", source=self._source("trails", _EMPTY), line_width=1.6, line_alpha=0.8
        )
        self._glyphs["coming"] = plot.line(
            "x", "y", source=self._source("coming", _EMPTY), line_width=1.2, line_dash="dotted"
        )
        parcels = self._source("parcels", {"xs": [], "ys": [], "colour": [], "width": []})
        # below the outline, so that a blue parcel is seen on blue cells
        self._glyphs["casings"] = plot.patches("xs", "ys", source=parcels, fill_alpha=0.0, line_width=4.5)
        self._glyphs["parcels"] = plot.patches(
            "xs",
            "ys",
            source=parcels,
            fill_color="colour",
            fill_alpha=0.45,
            line_color="colour",
            line_width="width",
        )
        fronts = self._source("fronts", {"x0": [], "y0": [], "x1": [], "y1": []})
        self._glyphs["fronts"] = plot.segment("x0", "y0", "x1", "y1", source=fronts, line_width=2.0)
        self._exit_names(exits)  # above the arrows
        self._source("numbers", {"x": [], "y": [], "text": []})
        self._text("numbers", x_offset=4, y_offset=-4)
        ghost = self._source("ghost", {"xs": [], "ys": []})
        self._glyphs["ghost"] = plot.patches(
            "xs", "ys", source=ghost, fill_alpha=0.15, line_dash="dashed", line_width=2.0
        )

    def _source(self, name: str, data: dict[str, Any]) -> ColumnDataSource:
        self.sources[name] = ColumnDataSource(dict(data), name=name)
        return self.sources[name]

    def _square(self, name: str, side: float, **style: Any) -> None:
        source = self._source(name, _EMPTY)
        self._glyphs[name] = self.figure.rect("x", "y", side, side, source=source, fill_alpha=0.0, **style)

    def _shapes(self, name: str, shapes: Sequence[Floats], **style: Any) -> None:
        columns = {
            "xs": [list(shape[:, 0]) for shape in shapes],
            "ys": [list(shape[:, 1]) for shape in shapes],
        }
        self._glyphs[name] = self.figure.patches("xs", "ys", source=self._source(name, columns), **style)

    def _exit_names(self, exits: Sequence[tuple[str, Floats]]) -> None:
        """Add the name of each exit in its upper right corner."""
        places = [corners[np.argmax(corners.sum(axis=1))].tolist() for _, corners in exits]
        names = {
            "x": [x for x, _ in places],
            "y": [y for _, y in places],
            "text": [name for name, _ in exits],
        }
        self._source("exit names", names)
        self._text("exit names", x_offset=-4, y_offset=4, text_align="right", text_baseline="top")

    def _text(self, name: str, **style: Any) -> None:
        """Add the texts of a source."""
        style |= {"background_fill_alpha": 0.75, "padding": 2, "border_radius": 3}
        self._glyphs[name] = self.figure.text(
            "x",
            "y",
            "text",
            source=self.sources[name],
            text_font_size="11px",
            text_font_style="bold",
            **style,
        )

    def put(self, name: str, **columns: Any) -> None:
        """Set the data of a layer, unless it is what the page has already."""
        before = self._sent.get(name)
        same = before is not None and before.keys() == columns.keys()
        if same and before is not None and all(_same(before[key], columns[key]) for key in columns):
            return
        self._sent[name] = columns
        self.sources[name].data = columns

    def clear(self, name: str) -> None:
        """Empty a layer."""
        columns = cast("dict[str, Any]", self.sources[name].data)
        self.put(name, **{key: [] for key in columns})

    def view(self) -> tuple[float, float, float, float]:
        """Return the part of the plane in sight: left, right, bottom, top, m."""
        x, y = cast("Any", self.figure.x_range), cast("Any", self.figure.y_range)
        return x.start, x.end, y.start, y.end

    def size_marks(self, cells: int) -> None:
        """Set the size of arrow heads and of crosses for a number of cells in sight."""
        head, cross = (9, 24) if cells <= _FEW else (5, 9) if cells <= _SOME else (4, 7)
        for name, size in (("heads", head), ("dead", cross)):
            if self._glyphs[name].glyph.size != size:
                self._glyphs[name].glyph.size = size

    def put_parcels(self, states: Floats, selected: int | None) -> None:
        """Set the outlines of the parcels, their fronts and numbers.

        Args:
            states: ``(m, 6)`` states; NaN: absent.
            selected: The selected parcel; None: none is.
        """
        # lists, not arrays: every array would be a message of its own
        xs, ys = outlines(self._footprints, states)
        width = [3.5 if i == selected else 1.5 for i in range(len(xs))]
        self.put("parcels", xs=xs, ys=ys, colour=self._colours, width=width)
        reach = np.array([0.8 * float(footprint[:, 0].max()) for footprint in self._footprints])
        there = np.isfinite(states).all(axis=1)
        x, y, angle = states[there, :3].T
        if 1 < len(states) <= _NUMBERED:
            self.put("numbers", x=x.tolist(), y=y.tolist(), text=[str(i) for i in np.flatnonzero(there)])
        self.put(
            "fronts",
            x0=x.tolist(),
            y0=y.tolist(),
            x1=(x + reach[there] * np.cos(angle)).tolist(),
            y1=(y + reach[there] * np.sin(angle)).tolist(),
        )

    def paint(self, theme: Theme) -> None:
        """Set the colours of a theme."""
        self._colours = [theme.lines[i % len(theme.lines)] for i in range(len(self._footprints))]
        paint_axes(self.figure, theme)
        self.figure.grid.grid_line_color = None
        lines = {
            "grid": theme.paper,
            "casings": theme.paper,
            "captured": theme.captured,
            "faulty": theme.faulty,
            "selected": theme.ink,
            "messages": theme.message,
            "shafts": theme.arrow,
            "dead": theme.dead,
            "trails": theme.soft,
            "coming": theme.ink,
            "fronts": theme.ink,
            "ghost": theme.ink,
            "rails": theme.soft,
            "exits": theme.message,
        }
        for name, colour in lines.items():
            self._glyphs[name].glyph.line_color = colour
        for name in ("ghost", "rails", "exits"):
            self._glyphs[name].glyph.fill_color = lines[name]
        self._glyphs["heads"].glyph.fill_color = theme.arrow
        for name, colour in (("numbers", theme.ink), ("exit names", theme.message)):
            self._glyphs[name].glyph.text_color = colour
            self._glyphs[name].glyph.background_fill_color = theme.paper


def paint_axes(plot: Any, theme: Theme) -> None:
    """Set the colours of a figure's background and axes."""
    plot.background_fill_color = theme.paper
    plot.border_fill_color = (
        None  # the page's own: a colour would leave a line of the theme before at the edge
    )
    plot.outline_line_color = None
    for axis in plot.axis:
        axis.axis_line_color = theme.line
        axis.major_tick_line_color = theme.line
        axis.minor_tick_line_color = None
        axis.major_label_text_color = theme.soft
        axis.major_label_text_font_size = "11px"
        axis.axis_label_text_color = theme.soft
        axis.axis_label_text_font_size = "11px"
        axis.axis_label_text_font_style = "normal"
    plot.grid.grid_line_color = theme.line


def _same(one: Any, other: Any) -> bool:
    """Whether two columns are equal."""
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        return bool(np.array_equal(one, other, equal_nan=True))
    if len(one) == len(other) and len(one) and isinstance(one[0], np.ndarray):
        return all(bool(np.array_equal(a, b)) for a, b in zip(one, other, strict=True))
    return bool(one == other)
