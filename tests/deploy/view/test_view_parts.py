"""Parts of the page that need no browser: health over time, history, player, geometry, colours, faults, inspector."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from deploy.control.server import read_request
from deploy.faults.fault_state import ALIVE, DEAD, FAULTY, FaultState
from deploy.faults.registry import KINDS
from deploy.scenes.files import load_scene
from deploy.view.colouring import Colouring
from deploy.view.fault_menu import fault_menu, fault_request
from deploy.view.geometry import CellGrid, arrows, broken_line, outlines, trails
from deploy.view.history import History
from deploy.view.inspector import _register_sections, supports
from deploy.view.layers import Scenery, draw_arrows
from deploy.view.map_figure import MapFigure
from deploy.view.palette import DARK, LIGHT, rgba, scale_of
from deploy.view.player import Player
from deploy.view.plot_figure import PlotFigure
from deploy.view.series import Series
from deploy.view.source import Instant, RunSource
from plant.faults.base import WheelFault

CELLS = [[0, 0], [0, 1], [1, 0], [1, 2]]
PLACES = [[0.05, 0.05], [0.15, 0.05], [0.05, 0.15], [0.25, 0.15]]


def instant(tick: int, x: float = 0.0) -> Instant:
    states = np.array([[x, 0, 0, 0, 0, 0]], dtype=np.float64)
    speeds = np.array([[3.0, 4.0], [0, 0], [0, 0], [0, 1]]) * tick
    return Instant(
        tick, 0.1 * tick, states, speeds, np.zeros((4, 1), dtype=np.bool_), np.zeros(4, dtype=np.uint8)
    )


def source(ticks: int, *, live: bool = False) -> RunSource:
    history = History(4, 1)
    for tick in range(ticks):
        history.add(instant(tick))
    found = SimpleNamespace(
        live=live,
        times_s=history.times_s,
        states=history.states,
        at=history.at,
        register_names=list,
        faults=[],
        events=[],
    )
    return cast("RunSource", found)


# --- health ----------------------------------------------------------------------------------------


def test_cells_are_faulty_while_a_fault_is_active_and_dead_until_they_rejoin() -> None:
    state = FaultState(CELLS)
    state.add(
        [
            {"time_s": 1.0, "kind": "wheel_stuck", "phase": "begins", "number": 0, "cells": [[0, 1], [1, 2]]},
            {"time_s": 2.0, "kind": "timed_out", "cell": [0, 1]},
            {"time_s": 2.0, "kind": "crash", "phase": "begins", "number": 1, "cells": [[1, 0]]},
            {"time_s": 3.0, "kind": "wheel_stuck", "phase": "ends", "number": 0, "cells": [[0, 1], [1, 2]]},
        ]
    )
    state.add([{"time_s": 4.0, "kind": "respawn", "cells": [[0, 1]], "phase": "happens"}])
    assert state.health(0.9).tolist() == [ALIVE] * 4
    assert state.health(1.0).tolist() == [ALIVE, FAULTY, ALIVE, FAULTY]
    assert state.health(2.5).tolist() == [ALIVE, DEAD, DEAD, FAULTY]
    assert state.health(3.5).tolist() == [ALIVE, DEAD, DEAD, ALIVE]
    assert state.health(9.0).tolist() == [ALIVE, ALIVE, DEAD, ALIVE]
    assert state.active_at(1.5, 3) == [(0, "wheel_stuck")]


def test_thousands_of_faults_are_no_burden_and_are_found_in_any_order_of_time() -> None:
    begin = [
        {"time_s": float(k), "kind": "wheel_stuck", "phase": "begins", "number": k, "cells": [CELLS[k % 4]]}
        for k in range(20_000)
    ]
    end = [{**one, "time_s": one["time_s"] + 20_000.0, "phase": "ends"} for one in begin]
    state = FaultState(CELLS)
    state.add(begin)
    assert len(state.active(19_999.5)) == 20_000, "at once: a copy for each record would take gigabytes"
    state.add(end)
    for time_s, active in (
        (-1.0, 0),
        (0.0, 1),
        (30_000.5, 9_999),
        (3.5, 4),
        (39_999.0, 0),
        (20_000.0, 19_999),
    ):
        assert len(state.active(time_s)) == active
        assert (state.health(time_s) == FAULTY).sum() == min(active, 4)


# --- history ---------------------------------------------------------------------------------------


def test_a_history_drops_what_a_reset_has_undone_and_says_so() -> None:
    history = History(4, 1)
    assert all(history.add(instant(tick)) for tick in range(5))
    assert history.add(instant(4)), "the same tick of a paused run changes nothing"
    assert not history.add(instant(4, x=0.5)), "a parcel was moved"
    assert not history.add(instant(2, x=0.7))
    np.testing.assert_allclose(history.times_s, [0.0, 0.1, 0.2])
    assert history.states[-1, 0, 0] == 0.7


def test_a_full_history_keeps_its_ends_and_thins_out_the_older_half() -> None:
    history = History(4, 1, most=100)
    for tick in range(1_000):
        history.add(instant(tick))
    assert len(history.times_s) <= 100
    assert history.at(0).tick == 0
    assert [history.at(index).tick for index in (-2, -1)] == [998, 999]
    assert (np.diff(history.times_s) > 0).all()
    assert [history.at(k).time_s for k in range(len(history.times_s))] == history.times_s.tolist()


# --- player ----------------------------------------------------------------------------------------


def test_a_player_moves_at_its_speed_both_ways_and_stops_at_the_ends() -> None:
    player = Player(source(11))
    player.speed = 2.0
    player.toggle()
    player.advance(0.25)
    assert player.index == 5
    player.backwards = True
    player.advance(0.09)
    assert player.index == 3
    player.advance(10.0)
    assert (player.index, player.playing) == (0, False)
    player.toggle()
    assert player.index == 10, "backwards from the end"


def test_a_player_of_a_run_follows_until_it_looks_back() -> None:
    player = Player(source(11, live=True))
    assert player.index == 10
    player.step(-3)
    assert (player.index, player.following) == (7, False)
    player.seek_time(0.41)
    assert player.index == 5
    player.follow()
    assert player.index == 10
    player.step(-2)
    player.step(1)
    assert not player.following
    player.step(1)
    assert player.following, "whoever steps on to the newest instant has the run at hand again"


# --- geometry --------------------------------------------------------------------------------------


def test_a_grid_finds_cells_neighbours_and_holes() -> None:
    grid = CellGrid(CELLS, PLACES, 0.1)
    assert [grid.cell_at(x, y) for x, y in PLACES] == [0, 1, 2, 3]
    assert grid.cell_at(0.15, 0.15) is None
    assert grid.cell_at(0.35, 0.05) is None
    assert grid.neighbour(2, 0, 1) == 3, "over the hole"
    assert grid.neighbour(3, 1, 0) is None
    assert grid.beside(0) == {"north": 2, "east": 1}
    image = grid.image(np.array([1, 2, 3, 4], dtype=np.uint32))
    assert image.tolist() == [[1, 2, 0], [3, 0, 4]]


def test_the_fastest_arrow_is_as_long_as_a_cell_and_slow_wheels_have_none() -> None:
    found = arrows(np.array(PLACES[:2]), np.array([[2.0, 0.0], [0.001, 0.0]]), 2.0, 0.1)
    assert found["x1"] - found["x0"] == pytest.approx(0.084)
    assert len(found["x0"]) == 1


def test_outlines_are_lists_and_absent_parcels_have_no_corners() -> None:
    square = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    xs, ys = outlines([square, square], np.array([[1, 2, np.pi / 2, 0, 0, 0], [np.nan] * 6]))
    assert isinstance(xs[0], list)
    np.testing.assert_allclose(xs[0], [2, 2, 0, 0], atol=1e-12)
    np.testing.assert_allclose(ys[0], [1, 3, 3, 1], atol=1e-12)
    assert xs[1] == []


def test_trails_end_at_the_instant_and_lines_are_joined_with_gaps() -> None:
    states = np.zeros((500, 2, 6))
    states[:, 0, 0] = np.arange(500)
    paths = trails(states, 400, 300)
    assert (paths[0][-1, 0], len(paths)) == (400.0, 2)
    assert len(paths[0]) <= 62
    x, _ = broken_line([np.zeros((2, 2)), np.ones((3, 2))])
    assert np.isnan(x).tolist() == [False, False, True, False, False, False, True]


def test_supports_are_the_cells_under_a_turned_parcel() -> None:
    centres = np.array([[0.0, 0.0], [0.9, 0.0], [0.9, 0.9]])
    square = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    assert supports(square, np.zeros(6), centres).tolist() == [0, 1, 2]
    assert supports(square, np.array([0, 0, np.pi / 4, 0, 0, 0]), centres).tolist() == [0, 1]


def test_the_axis_of_a_plot_has_limits_while_its_parcel_is_absent() -> None:
    plot = PlotFigure()
    gone = Series("parcel 0", "m", ("x",), np.array([0.0, 1.0]), np.full((2, 1), np.nan))
    plot.show(gone, 0.0, 1.0)
    assert (plot.figure.y_range.start, plot.figure.y_range.end) == (0.0, 1.0)
    plot.show(gone._replace(values=np.array([[2.0], [4.0]])), 0.0, 1.0)
    assert plot.figure.y_range.start < 2.0 < 4.0 < plot.figure.y_range.end


# --- map -------------------------------------------------------------------------------------------


def test_parcels_have_their_numbers_where_there_are_several_and_a_rim_on_cells_of_their_colour() -> None:
    square = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    states = np.array([[1.0, 2, 0, 0, 0, 0], [np.nan] * 6, [3.0, 4, 0, 0, 0, 0]])
    for count, numbers in ((3, ["0", "2"]), (1, [])):
        figure = MapFigure(CellGrid(CELLS, PLACES, 0.1), [square] * count, [], [("out", square)])
        figure.paint(LIGHT)
        figure.put_parcels(states[:count], None)
        assert list(figure.sources["numbers"].data["text"]) == numbers
        casing, parcel = figure._glyphs["casings"].glyph, figure._glyphs["parcels"].glyph
        assert casing.line_color == LIGHT.paper != LIGHT.lines[0]
        assert casing.line_width > 3.5, "wider than the outline of the selected parcel"
        assert parcel.line_color == "colour"
    assert list(figure.sources["exit names"].data["text"]) == ["out"]
    assert (figure.figure.xaxis[0].axis_label, figure.figure.yaxis[0].axis_label) == ("m", "m")


@pytest.mark.parametrize(("seen", "drawn"), [(2_500, 2_500), (2_501, 0)])
def test_arrows_are_drawn_while_at_most_2500_cells_are_in_sight(seen: int, drawn: int) -> None:
    cells = [[0, k] for k in range(seen + 100)]
    grid = CellGrid(cells, [[0.1 * k, 0.0] for k in range(len(cells))], 0.1)
    figure = MapFigure(grid, [], [], [])
    speeds = np.ones((len(cells), 2))
    shown = Instant(
        0, 0.0, np.zeros((0, 6)), speeds, np.zeros((len(cells), 1), np.bool_), np.zeros(0, np.uint8)
    )
    in_sight = grid.in_sight(-0.05, 0.1 * (seen - 1), -1.0, 1.0)
    assert len(in_sight) == seen
    run: Any = None
    draw_arrows(figure, Scenery(run, grid, (), 0, shown, in_sight, 1.0, run))
    assert len(figure.sources["arrows"].data["x0"]) == drawn


# --- colours ---------------------------------------------------------------------------------------


def luminance(colour: str) -> float:
    parts = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ (0.2126, 0.7152, 0.0722))


@pytest.mark.parametrize("theme", [LIGHT, DARK])
def test_a_scale_is_told_apart_by_lightness_and_marks_stand_out(theme: Any) -> None:
    steps = np.diff([luminance(colour) for colour in theme.scale])
    assert (steps > 0).all() or (steps < 0).all()
    for colour in (theme.ink, theme.dead, theme.faulty):
        bright, dark = sorted((luminance(colour), luminance(theme.paper)), reverse=True)
        assert (bright + 0.05) / (dark + 0.05) > 3.0, colour


def test_the_limits_of_a_scale_are_those_of_the_whole_recording() -> None:
    colouring = Colouring(source(11))
    colouring.choose("speed")
    first = colouring.colours(10, instant(10), LIGHT)
    assert colouring.legend(LIGHT)["high"] == 50.0
    assert first.tolist()[:2] == [scale_of(LIGHT)[-1], rgba(LIGHT.scale[0])]


@pytest.mark.parametrize("motors", [False, True])
def test_every_kind_of_fault_has_a_button_whose_request_the_run_accepts(motors: bool) -> None:
    kinds = [entry["kind"] for entry in fault_menu(motors=motors)]
    assert sorted([*kinds, "add"]) == sorted(KINDS)
    effects = load_scene("prototype" if motors else "elliptic").effects
    for kind in kinds:
        request: Any = read_request(json.dumps(fault_request(kind, 3, 4, motors=motors)).encode())
        assert request.fault.kind == kind
        if isinstance(request.fault, WheelFault):
            assert list(request.fault.setting_problems(effects)) == []
    turned: Any = read_request(
        json.dumps(fault_request("link_down", 3, 4, {"side": "north"}, motors=motors)).encode()
    )
    assert turned.fault.side == "north"


# --- messages of a cell ----------------------------------------------------------------------------


def sections(registers: dict[str, np.ndarray], cell: int) -> dict[str, list[tuple[str, Any]]]:
    """Rows of the inspector's sections by name."""
    grid = CellGrid(CELLS, PLACES, 0.1)
    found = _register_sections(registers, cell, 0.5, grid.beside(cell))
    return {one["name"]: [(row["name"], row["value"]) for row in one["rows"]] for one in found}


def test_the_inspector_shows_the_messages_sent_by_a_cell_and_by_its_neighbours() -> None:
    sent = np.zeros((4, 4))
    sent[0, 0] = sent[1, 3] = 1.0  # from 0,0 to the north, and from 0,1 to the west
    sent[2] = np.nan  # 1,0 is dead
    number, pair = np.arange(16.0).reshape(4, 4), np.arange(32.0).reshape(4, 8)
    registers = {
        "message.sent": sent,
        "message.n": number,
        "message.pair": pair,
        "firmware.u": np.ones((4, 1)),
    }
    found = sections(registers, 0)
    assert found["Outbox"] == [("to north n", 0.0), ("to north pair", [0.0, 1.0]), ("to east", "none")]
    assert found["Inbox"] == [("from north", "none"), ("from east n", 7.0), ("from east pair", [14.0, 15.0])]
    assert found["Registers"] == [("firmware.u", 1.0)]
    assert set(sections({"firmware.u": np.ones((4, 1))}, 0)) == {"Registers"}
    key = {
        "firmware.key": np.full((4, 1), 2**63 + 5, dtype=np.uint64)
    }  # more digits than a browser's numbers
    assert sections(key, 0)["Registers"] == [("firmware.key", "9223372036854775813")]
