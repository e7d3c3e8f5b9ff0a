"""The picture of a protocol, from what it is drawn of."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bus.lockstep.registers import RegisterSnapshot
from deploy.protocol_report.plot import _figure, _layout, _range, draw_protocol
from deploy.protocol_report.reporter import Reporter
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override


def watched(rows: int, columns: int, width: int, ticks: int = 60) -> Reporter:
    """A field of so many numbers a cell that dies out; one cell dies on the way."""
    changes = {"array.rows": rows, "array.columns": columns, "parcels": [], "cells.parameters": {}}
    scene = load_scene("heat", [Override(tuple(key.split(".")), value, "") for key, value in changes.items()])
    reporter = Reporter(scene, scene.lattice())
    live = np.ones(rows * columns, dtype=np.bool_)
    field = np.random.default_rng(3).normal(size=(rows * columns, width))
    for tick in range(ticks):
        live = live & (tick < 40 or np.arange(len(live)) > 0)
        reporter.take(RegisterSnapshot(tick, live, {"firmware.speed_m_s": field * 0.9**tick}))
    return reporter


@pytest.mark.parametrize(
    ("rows", "columns", "width"), [(1, 18, 2), (18, 1, 1), (40, 40, 2), (3, 4, 5), (1, 1, 1)]
)
def test_maps_of_any_array_and_width_lie_within_the_page(rows: int, columns: int, width: int) -> None:
    reporter = watched(rows, columns, width)
    figure = _figure(reporter, reporter.report(60, {(0, 0): 40}, {}))
    *maps, bar, curves = figure.axes
    assert [axes.get_title(loc="left") for axes in maps][0::5] == ["tick 0", "tick 59"]
    boxes = [axes.get_position() for axes in (*maps, bar, curves)]
    assert all(box.x0 > 0 and box.x1 < 1 and box.y0 > 0 and box.y1 < 0.95 for box in boxes)
    assert all(box.y0 > boxes[-1].y1 for box in boxes[:-1])
    inches = figure.get_size_inches()
    ratio = (boxes[0].width * inches[0]) / (boxes[0].height * inches[1])
    assert ratio == pytest.approx(columns / rows)
    colours = {axes.images[0].get_clim() for axes in maps}
    assert len(colours) == 1  # one scale for all


def test_dead_cells_and_holes_have_no_colour() -> None:
    figure = _figure(reporter := watched(2, 3, 1), reporter.report(60, {(0, 0): 40}, {}))
    first, last = (figure.axes[i].images[0].get_array() for i in (0, 5))
    assert not np.ma.getmaskarray(first).any()
    assert np.argwhere(np.ma.getmaskarray(last)).tolist() == [[0, 0]]


def test_a_number_that_stands_for_none_is_beyond_the_colours() -> None:
    assert _range([np.array([[0.0], [7.0], [255.0]])]) == (0.0, 7.0)
    assert _range([np.array([[0.0], [7.0], [9.0]])]) == (0.0, 9.0)
    assert _range([np.array([[0.0], [0.07], [2.55]])]) == (0.0, 2.55)
    assert _range([np.array([[np.nan], [4.0]])]) == (3.5, 4.5)
    assert _range([np.array([[3.0, 4.0], [np.inf, 0.0]])]) == (0.0, 5.0)


def test_long_rows_are_stacked_and_columns_stand_side_by_side() -> None:
    assert _layout(6, 18.0, 10.0)[0] == 1
    assert _layout(6, 1 / 18, 10.0)[0] == 6
    assert _layout(6, 2.0, 10.0)[0] in (2, 3)


def test_a_field_that_never_was_and_one_that_never_changes_are_drawn_too(tmp_path: Path) -> None:
    nothing = watched(2, 2, 1, ticks=0)
    draw_protocol(nothing, nothing.report(0, {}, {}), tmp_path / "nothing.png")
    still = watched(2, 2, 1, ticks=0)
    for tick in range(3):
        still.take(RegisterSnapshot(tick, np.ones(4, dtype=np.bool_), {"firmware.speed_m_s": np.zeros(4)}))
    draw_protocol(still, still.report(3, {}, {}), tmp_path / "still.png")
    assert len(list(tmp_path.glob("*.png"))) == 2
