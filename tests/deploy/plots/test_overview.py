"""The picture of a run shows what happened."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.image import imread

from deploy.errors import DeployError
from deploy.plots.map_view import RAIL, affected_cells, event_annotations, extent
from deploy.plots.overview import draw_overview, draw_times
from deploy.recordings.reader import load
from deploy.recordings.trace import RunTrace
from deploy.util.colours import colour
from deploy.util.signals import Interrupted

Make = Callable[..., Any]


@pytest.fixture
def draw(tmp_path: Path) -> Callable[[Any], np.ndarray]:
    """Draws a run and gives the picture's ``(height, width, 3)`` colours."""

    def _draw(run: Any) -> np.ndarray:
        draw_overview(run, tmp_path / "overview.png")
        return imread(tmp_path / "overview.png")[..., :3]

    return _draw


@pytest.fixture
def track(tmp_path: Path, made_up_run: Make) -> RunTrace:
    return load(made_up_run().record(tmp_path)).run_trace()


def _like(picture: np.ndarray, shade: str, within: float) -> np.ndarray:
    """Which pixels have about this colour."""
    return np.abs(picture - mpl.colors.to_rgb(shade)).max(axis=2) < within


def pixels(picture: np.ndarray, shade: str) -> int:
    """How many pixels have about this colour."""
    return int(_like(picture, shade, 0.06).sum())


def test_guide_rails_are_drawn(draw: Callable[[Any], np.ndarray], track: RunTrace) -> None:
    shade, (x, y) = RAIL, track.positions_m.mean(axis=0)
    rails = [((x - 0.2, y), (x + 0.2, y)), ((x, y), (x + 0.1, y), (x, y + 0.1))]
    before = pixels(draw(track), shade)
    assert pixels(draw(dataclasses.replace(track, rails_m=rails)), shade) > before + 200


@pytest.mark.parametrize("parcels", [1, 3, 8, 30])
def test_every_parcel_is_drawn_in_its_colour(
    tmp_path: Path, made_up_run: Make, draw: Callable[[Any], np.ndarray], parcels: int
) -> None:
    run = made_up_run(rows=8, columns=8, parcels=parcels)
    run.states[:, :, :2] += np.linspace(0, 0.7, parcels)[None, :, None]
    picture = draw(load(run.record(tmp_path)))
    assert all(pixels(picture, colour(parcel)) > 100 for parcel in range(parcels))


def test_a_run_without_parcels_shows_its_array(
    tmp_path: Path, made_up_run: Make, draw: Callable[[Any], np.ndarray]
) -> None:
    picture = draw(load(made_up_run(parcels=0).record(tmp_path)))
    assert pixels(picture, "#eceff3") > 10_000


def test_a_recording_cut_before_its_first_instant_shows_its_array(
    tmp_path: Path, made_up_run: Make, draw: Callable[[Any], np.ndarray]
) -> None:
    path = made_up_run().record(tmp_path)
    recording = load(path)
    empty = dataclasses.replace(
        recording.run_trace(), time_s=np.zeros(0), parcels=np.zeros((0, 1, 6)), wheel_speeds=None, status=None
    )
    picture = draw(empty)
    assert pixels(picture, "#eceff3") > 10_000
    assert pixels(picture, colour(0)) == 0


LOST_CELL = "#fbd9d3"


def test_lost_cells_are_marked(track: RunTrace, draw: Callable[[Any], np.ndarray]) -> None:
    red = "#c1121f"
    assert pixels(draw(track), red) == 0
    faulty = dataclasses.replace(track, faults=[{"time_s": 0.01, "kind": "crash", "cell": [2, 3]}])
    assert pixels(draw(faulty), red) > 100


def test_a_cell_that_rejoined_is_marked_affected_and_not_lost(
    track: RunTrace, draw: Callable[[Any], np.ndarray]
) -> None:
    lost = {"time_s": 0.01, "kind": "disconnected", "cell": [2, 3], "detail": ""}
    back = {"time_s": 0.02, "kind": "respawn", "phase": "happens", "cell": [2, 3], "cells": [[2, 3]]}
    rejoined = dataclasses.replace(track, faults=[lost, back])
    assert affected_cells(rejoined) == {(2, 3)}
    assert pixels(draw(rejoined), "#c1121f") > 100
    gone = draw(dataclasses.replace(track, faults=[lost]))
    assert pixels(gone, LOST_CELL) > pixels(draw(rejoined), LOST_CELL) + 1_000


def test_cells_that_were_pulled_or_affected_are_marked(
    track: RunTrace, draw: Callable[[Any], np.ndarray]
) -> None:
    def with_fault(kind: str, *phases: str) -> RunTrace:
        fault = {"kind": kind, "cell": [2, 3], "cells": [[2, 3]], "number": 0, "fault": {}}
        records = [{**fault, "phase": phase, "time_s": 0.01 * step} for step, phase in enumerate(phases, 1)]
        return dataclasses.replace(track, faults=records, wheel_speeds=None)

    away, back = (draw(with_fault("remove", *phases)) for phases in (("begins",), ("begins", "ends")))
    assert pixels(away, "#8a5a00") > 20
    assert pixels(back, "#8a5a00") > 20
    assert pixels(away, "#ffffff") > pixels(back, "#ffffff") + 1_000
    stuck = with_fault("wheel_stuck", "begins")
    assert affected_cells(stuck) == {(2, 3)}
    assert pixels(draw(stuck), "#c1121f") > 100


def test_a_tipped_parcel_is_marked_and_changes_of_support_are_not(track: RunTrace) -> None:
    events = [
        {"time_s": 0.01, "kind": "support", "parcel": 0},
        {"time_s": 0.02, "kind": "tipped", "parcel": 0},
    ]
    assert event_annotations(dataclasses.replace(track, events=events)) == [(0.02, "tipped", 0)]


def test_missing_cells_leave_a_gap(track: RunTrace, draw: Callable[[Any], np.ndarray]) -> None:
    bare = dataclasses.replace(track, wheel_speeds=None, footprints_m=[], parcels=np.zeros((13, 0, 6)))
    fewer = dataclasses.replace(
        bare, cells=[*bare.cells[:5], *bare.cells[6:]], positions_m=np.delete(bare.positions_m, 5, axis=0)
    )
    share = pixels(draw(fewer), "#eceff3") / pixels(draw(bare), "#eceff3")
    assert share == pytest.approx(11 / 12, abs=0.01)


def test_the_view_holds_the_array_and_the_whole_trajectory(track: RunTrace) -> None:
    left, right, bottom, top = extent(track)
    assert left < -0.05
    assert right > 0.35
    assert bottom < -0.05
    assert top > 0.25
    far = track.parcels.copy()
    far[-1, 0, 0] = 0.45
    assert extent(dataclasses.replace(track, parcels=far))[1] > 0.45 + 0.1


COMES_AND_GOES = [
    {"time_s": 4 * 0.004096, "kind": "fed", "parcel": 1},
    {"time_s": 9 * 0.004096, "kind": "left", "parcel": 1},
]


def test_a_parcel_is_shown_from_when_it_is_fed_until_it_leaves(tmp_path: Path, made_up_run: Make) -> None:
    run = made_up_run(parcels=3, events=COMES_AND_GOES)
    run.extra = {
        "own_parcels": 1,
        "exits": [{"name": "e", "corners_m": [[0.0, 0.0], [0.2, 0.0], [0.2, 0.1]]}],
    }
    recording = load(run.record(tmp_path))
    track = recording.run_trace()
    there = np.isfinite(track.parcels).all(axis=2)
    assert there[:, 0].all()
    assert np.flatnonzero(there[:, 1]).tolist() == [4, 5, 6, 7, 8, 9]
    assert not there[:, 2].any()
    assert np.array_equal(track.parcels[there], recording.parcels[there])
    ((name, corners),) = track.exits
    assert (name, corners.tolist()) == ("e", [[0.0, 0.0], [0.2, 0.0], [0.2, 0.1]])


def test_waiting_parcels_are_not_drawn_and_those_that_left_only_along_their_path(
    tmp_path: Path, made_up_run: Make, draw: Callable[[Any], np.ndarray]
) -> None:
    run = made_up_run(rows=8, columns=8, parcels=3, events=COMES_AND_GOES)
    run.states[:, :, :2] += np.linspace(0, 0.7, 3)[None, :, None]
    always = draw(load(run.record(tmp_path)))
    run.extra = {"own_parcels": 1, "exits": []}
    picture = draw(load(run.record(tmp_path)))
    assert pixels(picture, colour(2)) == 0
    assert 100 < pixels(picture, colour(1)) < pixels(always, colour(1))
    # only who is still there is filled
    filled = mpl.colors.to_hex(
        0.22 * np.array(mpl.colors.to_rgb(colour(1))) + 0.78 * np.array(mpl.colors.to_rgb("#eceff3"))
    )
    track = load(tmp_path).run_trace()
    stays = draw(dataclasses.replace(track, events=COMES_AND_GOES[:1]))
    leaves = draw(dataclasses.replace(track, events=COMES_AND_GOES))
    assert _like(stays, filled, 0.01).sum() > 1000
    assert _like(leaves, filled, 0.01).sum() < 100


def test_times_are_shown_from_the_start_to_the_end_whoever_is_there(track: RunTrace) -> None:
    from matplotlib.figure import Figure

    nobody = dataclasses.replace(track, parcels=np.full_like(track.parcels, np.nan))
    panels = Figure().subplots(3)
    draw_times(list(panels), nobody, stacked=True)
    assert panels[0].get_xlim() == (track.time_s[0], track.time_s[-1])


def test_exits_are_drawn(track: RunTrace, draw: Callable[[Any], np.ndarray]) -> None:
    green = "#4b7a3f"
    corners = np.array([[0.1, 0.1], [0.3, 0.1], [0.3, 0.2], [0.1, 0.2]])
    assert pixels(draw(track), green) == 0
    assert pixels(draw(dataclasses.replace(track, exits=[("$e$", corners)])), green) > 100


def test_a_parcel_flung_away_leaves_the_array_in_sight(
    track: RunTrace, draw: Callable[[Any], np.ndarray]
) -> None:
    flung = track.parcels.copy()
    flung[5:, 0, 0] = 1e6
    flung[8:] = np.nan
    thrown = dataclasses.replace(track, parcels=flung, status="unstable")
    left, right, _, _ = extent(thrown)
    assert right - left < 2.0
    assert pixels(draw(thrown), "#eceff3") > 10_000


def test_a_wide_array_has_its_panels_below(
    tmp_path: Path, made_up_run: Make, draw: Callable[[Any], np.ndarray]
) -> None:
    height, width, _ = draw(load(made_up_run(rows=2, columns=40).record(tmp_path))).shape
    assert width > 1.5 * height


def test_a_flat_view_leaves_no_blank_below_it(
    tmp_path: Path, made_up_run: Make, draw: Callable[[Any], np.ndarray]
) -> None:
    picture = draw(load(made_up_run(rows=10, columns=19, parcels=0).record(tmp_path)))
    below = np.flatnonzero((picture < 0.9).any(axis=(1, 2)))[-1]
    assert below > picture.shape[0] - 40


def test_arrows_of_every_other_cell_stay_inside_the_array(
    tmp_path: Path, made_up_run: Make, draw: Callable[[Any], np.ndarray]
) -> None:
    run = made_up_run(rows=40, columns=40, parcels=0)
    run.wheel_speeds[:] = (1.0, 0.0)
    picture = draw(load(run.record(tmp_path)))[150:-150]  # without title and axis
    cells = np.flatnonzero(_like(picture, "#eceff3", 0.02).sum(axis=0) > 100)
    arrows = np.flatnonzero(_like(picture, "#7d8a9a", 0.02).any(axis=0))
    assert arrows[-1] <= cells[-1]


def test_a_title_may_hold_dollar_signs_and_be_long(
    track: RunTrace, draw: Callable[[Any], np.ndarray]
) -> None:
    picture = draw(dataclasses.replace(track, title="costs $1 and \\frac{ $" + "x" * 300))
    assert pixels(picture, colour(0)) > 100


def test_the_same_run_gives_the_same_picture(tmp_path: Path, track: RunTrace) -> None:
    for name in ("one.png", "two.png"):
        draw_overview(track, tmp_path / name)
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()


def test_a_picture_that_can_t_be_written_is_named_with_the_cause(tmp_path: Path, track: RunTrace) -> None:
    with pytest.raises(DeployError, match=r"can't write .*overview\.png: No such file"):
        draw_overview(track, tmp_path / "absent" / "overview.png")


def test_a_picture_that_is_given_up_leaves_the_one_before(
    tmp_path: Path, track: RunTrace, monkeypatch: pytest.MonkeyPatch
) -> None:
    def give_up(canvas: FigureCanvasAgg, path: str, **_: object) -> None:
        Path(path).write_bytes(b"half")
        raise Interrupted

    (tmp_path / "overview.png").write_bytes(b"before")
    monkeypatch.setattr(FigureCanvasAgg, "print_png", give_up)
    with pytest.raises(Interrupted):
        draw_overview(track, tmp_path / "overview.png")
    assert (tmp_path / "overview.png").read_bytes() == b"before"
    assert not list(tmp_path.glob(".*"))
