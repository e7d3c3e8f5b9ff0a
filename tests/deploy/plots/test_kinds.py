"""Every kind of plot: what it shows, that no text is clipped, and bad requests."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.quiver import QuiverKey
from matplotlib.text import Text
from PIL import Image

from deploy.cli import main
from deploy.plots import theme
from deploy.plots.animation import _AnimatedMap, draw_animation
from deploy.plots.arrows import round_below
from deploy.plots.cell_values import RegisterValues, WheelSpeedValues
from deploy.plots.kinds import KINDS, OF_CELLS, PlotSelection, draw_kind
from deploy.recordings.reader import load
from deploy.recordings.recording import Recording
from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.workers.plan import RunOptions

Make = Callable[..., Any]
FAULTS = (
    "faults=[{ kind = 'crash', at_s = 0.02, cell = [4, 4] }, { kind = 'wheel_weak', at_s = 0.03, cell = [5, 5], "
    "strength = 0.5 }, { kind = 'remove', at_s = 0.02, cell = [9, 9], until_s = 0.04 }]"
)


FIELD = "cells.parameters.field={kind='uniform',velocity_m_s=[0.1,0.0]}"


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Recording]:
    """Recordings of a scene with faults, one with sticking wheels, and one of three parcels."""
    found = {}
    for name, sets in (("elliptic", (FAULTS,)), ("coulomb", ()), ("carousel", ())):
        folder = tmp_path_factory.mktemp(name)
        scene = load_scene(name, [Override.parse(text) for text in ("duration_s=0.2", *sets)])
        run(scene, RunOptions(0, "memory", output=folder, picture=False), quiet=True)
        found[name] = load(folder)
    return found


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Figure, Any]]:
    """Every figure that is written, with its page in inches."""
    found: list[tuple[Figure, Any]] = []
    page = theme._page

    def spy(figure: Figure, renderer: Any) -> Any:
        found.append((figure, page(figure, renderer)))
        return found[-1][1]

    monkeypatch.setattr(theme, "_page", spy)
    return found


def clipped(figure: Figure, page: Any) -> list[str]:
    """Texts that are not wholly on the page."""
    renderer = FigureCanvasAgg(figure).get_renderer()
    found = [*figure.findobj(Text), *(key.text for key in figure.findobj(QuiverKey))]
    texts = [text for text in found if text.get_visible() and text.get_text()]
    dpi = figure.dpi
    return [
        text.get_text()
        for text in texts
        for box in [text.get_window_extent(renderer)]
        if not text.get_clip_on()
        and not (
            page.x0 * dpi <= box.x0 + 1
            and page.y0 * dpi <= box.y0 + 1
            and box.x1 <= page.x1 * dpi + 1
            and box.y1 <= page.y1 * dpi + 1
        )
    ]


@pytest.mark.slow
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in OF_CELLS])
def test_every_kind_is_drawn_with_all_texts_on_the_page(
    recordings: dict[str, Recording], drawn: list[tuple[Figure, Any]], kind: str, tmp_path: Path
) -> None:
    for name, recording in recordings.items():
        draw_kind(recording, kind, tmp_path / f"{name}.png")
        assert (tmp_path / f"{name}.png").stat().st_size > 5000
    for figure, page in drawn:
        assert clipped(figure, page) == []
        assert all(
            axes.get_xlabel() or axes.get_label() == "<colorbar>" or axes.get_ylabel() for axes in figure.axes
        )
    assert len(drawn) == 3


def test_a_map_has_a_legend_of_the_marks_that_occur_and_a_scale(
    recordings: dict[str, Recording], drawn: list[tuple[Figure, Any]], tmp_path: Path
) -> None:
    for name in ("elliptic", "coulomb"):
        draw_kind(recordings[name], "overview", tmp_path / "x.png")
    legends = [
        [text.get_text() for text in figure.axes[0].get_legend().get_texts()]  # type: ignore[union-attr]
        for figure, _ in drawn
    ]
    assert legends[0] == ["start", "end; line: front", "cell lost", "cell with a fault", "module pulled"]
    assert legends[1] == ["start", "end; line: front"]
    scales = [[key.text.get_text() for key in figure.findobj(QuiverKey)] for figure, _ in drawn]
    assert scales == [["wheels, 2 m/s"], ["wheels, 0.2 m/s"]]


def test_the_scale_is_round_and_never_longer_than_the_longest_arrow() -> None:
    values = np.random.default_rng(1).lognormal(size=500) * 10.0 ** np.arange(-4, 4).repeat(63)[:500]
    for value in values.tolist():
        assert 0.4 * value <= round_below(value) <= value * (1 + 1e-9)
    assert [round_below(value) for value in (0.2, 1.0, 4.99, 5.0, 9.99)] == [0.2, 1.0, 2.0, 5.0, 5.0]


def test_loads_are_drawn_at_the_instant_that_is_asked_for(
    recordings: dict[str, Recording], drawn: list[tuple[Figure, Any]], tmp_path: Path
) -> None:
    recording = recordings["elliptic"]
    draw_kind(recording, "loads", tmp_path / "x.png", PlotSelection(at_s=0.1))
    instant = int(np.argmin(np.abs(recording.time_s - 0.1)))
    (figure, _) = drawn[0]
    shown = np.ma.filled(figure.axes[0].collections[0].get_array(), 0.0)
    np.testing.assert_array_equal(shown, recording.tractions(instant).load_n)
    draw_kind(recordings["coulomb"], "loads", tmp_path / "x.png")
    assert any("wheels stick: no arrow" in text.get_text() for text in drawn[1][0].texts)


def test_the_torque_is_that_of_the_tractions(
    recordings: dict[str, Recording], drawn: list[tuple[Figure, Any]], tmp_path: Path
) -> None:
    recording = recordings["elliptic"]
    draw_kind(recording, "torque", tmp_path / "x.png")
    (line,) = drawn[0][0].axes[2].lines
    row = 20
    forces = recording.tractions(row)
    lever = np.array(recording.header["positions_m"]) - recording.parcels[row, 0, :2]
    torque = np.sum(lever[:, 0] * forces.traction_n[:, 1] - lever[:, 1] * forces.traction_n[:, 0])
    assert np.interp(recording.time_s[row], *line.get_data()) == pytest.approx(torque)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["time", "phase", "overview"])
def test_many_parcels_a_wide_array_and_no_parcel_fit_too(
    tmp_path: Path, made_up_run: Make, drawn: list[tuple[Figure, Any]], kind: str
) -> None:
    for number, shape in enumerate(
        ({"parcels": 40}, {"columns": 40, "parcels": 9}, {"parcels": 0}, {"ticks": 0})
    ):
        recording = load(made_up_run(**shape).record(tmp_path / str(number)))
        draw_kind(recording, kind, tmp_path / "x.svg")
    assert [clipped(figure, page) for figure, page in drawn] == [[]] * 4
    if kind != "overview":
        assert {axes.texts[0].get_text() for axes in drawn[2][0].axes} == {"no parcel"}


def test_the_scale_of_a_single_cell_ends_on_the_page_and_warns_of_nothing(
    tmp_path: Path, drawn: list[tuple[Figure, Any]]
) -> None:
    changes = ("array={rows=1,columns=1,pitch_m=0.1}", "parcels=[]", "duration_s=0.01")
    scene = load_scene("elliptic", [Override.parse(text) for text in (*changes, FIELD)])
    run(scene, RunOptions(0, "memory", output=tmp_path, picture=False), quiet=True)
    for kind in ("overview", "field"):
        draw_kind(load(tmp_path), kind, tmp_path / "x.png")
    for figure, _ in drawn:
        (key,) = figure.findobj(QuiverKey)
        left, right = figure.axes[0].get_xlim()
        assert key.X + key.U / key.Q.scale / (right - left) == pytest.approx(1.03)


@pytest.mark.slow
def test_forty_parcels_have_their_numbers(
    tmp_path: Path, made_up_run: Make, drawn: list[tuple[Figure, Any]]
) -> None:
    draw_kind(load(made_up_run(parcels=40).record(tmp_path)), "overview", tmp_path / "x.png")
    words = {text.get_text() for text in drawn[0][0].axes[0].texts}
    assert words >= {str(number) for number in range(40)}


@pytest.mark.slow
def test_an_animation_is_a_gif_of_the_whole_run(tmp_path: Path, made_up_run: Make) -> None:
    recording = load(made_up_run(ticks=60, parcels=2, wheels_change=True).record(tmp_path))
    draw_animation(recording, tmp_path / "run.gif")
    with Image.open(tmp_path / "run.gif") as picture:
        assert picture.n_frames == 5  # 0.246 s at 20 a second, both ends included
        first = np.asarray(picture.convert("RGB"), dtype=int)
        picture.seek(4)
        assert np.abs(np.asarray(picture.convert("RGB"), dtype=int) - first).max() > 100
    assert not list(tmp_path.glob("*.draft*"))


def test_cells_of_an_animated_field_have_the_value_recorded_last(tmp_path: Path) -> None:
    scene = load_scene("heat", [Override(("duration_s",), 0.1, "")])
    run(scene, RunOptions(0, "memory", output=tmp_path, picture=False, registers=4), quiet=True)
    recording = load(tmp_path)
    values = RegisterValues(recording, "firmware.speed_m_s")
    pairs = recording.registers["firmware.speed_m_s"]
    for row in (0, 7, 8, len(recording.tick) - 1):
        place = int(np.flatnonzero(recording.register_tick <= recording.tick[row])[-1])
        assert values.at(row).tolist() == [float(np.hypot(x, y)) for x, y in pairs[place]]
    assert values.limits(np.arange(len(recording.tick))) == (0.0, float(np.hypot(*pairs[-1].T).max()))
    speeds = WheelSpeedValues(recording)
    assert speeds.at(9).tolist() == np.hypot(*recording.held_wheel_speeds.at(9).T).tolist()
    draw_animation(recording, tmp_path / "field.gif", values)
    with Image.open(tmp_path / "field.gif") as picture:
        assert picture.n_frames == 3


def test_a_register_colours_the_field_of_an_instant(
    tmp_path: Path, drawn: list[tuple[Figure, Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    scene = load_scene("heat", [Override(("duration_s",), 0.05, "")])
    run(scene, RunOptions(0, "memory", output=tmp_path, picture=False, registers=4), quiet=True)
    words = ["plot", str(tmp_path), "--kind", "field", "--at", "0.03", "--register", "firmware.speed_m_s"]
    assert main(words) == 0
    recording = load(tmp_path)
    instant = int(np.argmin(np.abs(recording.time_s - 0.03)))
    row = int(np.flatnonzero(recording.register_tick <= recording.tick[instant])[-1])
    shown = np.ma.filled(drawn[0][0].axes[0].collections[0].get_array(), np.nan)
    np.testing.assert_array_equal(shown, np.hypot(*recording.registers["firmware.speed_m_s"][row].T))
    assert drawn[0][0].axes[1].get_ylabel() == "|firmware.speed_m_s|"
    capsys.readouterr()
    assert main([*words[:-1], "firmware.heat"]) == 2
    assert (
        "--register firmware.heat: must be one of firmware.counts, firmware.held" in capsys.readouterr().err
    )


def test_dead_cells_have_a_cross_at_an_instant_and_outlines_a_white_rim(
    recordings: dict[str, Recording], drawn: list[tuple[Figure, Any]], tmp_path: Path
) -> None:
    recording = recordings["elliptic"]
    for at_s in (0.01, 0.03, 0.1):
        draw_kind(recording, "field", tmp_path / "x.png", PlotSelection(at_s=at_s))
    crosses = [figure.axes[0].findobj(LineCollection) for figure, _ in drawn]
    index = recording.header["cells"].index([4, 4])
    counts = [len(found[0].get_segments()) // 2 for found in crosses]
    assert counts == [0, 2, 1], "the crashed cell, and the module while it was pulled"
    strokes = np.array(crosses[2][0].get_segments())
    np.testing.assert_allclose(strokes.mean(axis=(0, 1)), recording.header["positions_m"][index], atol=1e-12)
    assert ["cross: dead or lost" in figure.texts[1].get_text() for figure, _ in drawn] == [False, True, True]
    (outline,) = drawn[0][0].axes[0].patches
    assert outline.get_path_effects()


@pytest.mark.slow
def test_every_picture_names_scene_size_time_status_and_what_it_shows(
    recordings: dict[str, Recording], drawn: list[tuple[Figure, Any]], tmp_path: Path
) -> None:
    run_of = "carousel  ·  400 cells  ·  3 parcels  ·  0.2 s  ·  ok"
    wanted = {
        "overview": "",
        "time": "  ·  motion over time",
        "phase": "  ·  phase planes: ring = start, dot = end",
        "torque": "  ·  wheels' force and torque; gaps: a wheel sticks",
        "loads": "  ·  loads and tractions at 0.2 s",
        "field": "  ·  wheels at 0.2 s",
    }
    for kind in wanted:
        draw_kind(recordings["carousel"], kind, tmp_path / "x.png")
    for (figure, _), more in zip(drawn, wanted.values(), strict=True):
        title, *lines = [text.get_text() for text in figure.texts]
        assert title == "Three parcels are moved round and turned independently"[: len(title.rstrip("…"))] + (
            "…" if title.endswith("…") else ""
        )
        assert "  ·  ".join(lines) == run_of + more


@pytest.mark.slow
def test_an_mp4_has_the_frames_of_the_run_with_numbers_and_crosses(
    recordings: dict[str, Recording], tmp_path: Path
) -> None:
    imageio = pytest.importorskip("imageio_ffmpeg")
    path = tmp_path / "run.mp4"
    draw_animation(recordings["carousel"], path)
    frames, seconds = imageio.count_frames_and_secs(str(path))
    assert (frames, seconds) == (5, pytest.approx(0.25))  # 0.2 s at 20 a second, both ends included
    scene = _AnimatedMap(recordings["elliptic"])
    scene.show(len(recordings["elliptic"].tick) - 1)
    assert len(scene.figure.axes[0].findobj(LineCollection)[0].get_segments()) == 2
    scene = _AnimatedMap(recordings["carousel"], WheelSpeedValues(recordings["carousel"]))
    assert all(body.get_path_effects() for body in scene._bodies)
    scene.show(0)
    numbers = {text.get_text(): text.get_position() for text in scene.figure.axes[0].texts}
    assert numbers["1"] == tuple(recordings["carousel"].parcels[0, 1, :2])
    assert numbers.keys() >= {"0", "1", "2"}


@pytest.mark.parametrize(
    ("words", "rule"),
    [
        (["--kind", "time", "--at", "0.1"], "--at: goes with --kind loads or field, not time"),
        (["--kind", "field", "--at", "99"], "--at 99: the recording has the time from 0 to"),
        (
            ["--kind", "loads", "--register", "u"],
            "--register: goes with --kind spacetime or field, not loads",
        ),
        (["--animate", "x.avi"], "animation x.avi: its name must end in .mp4 or .gif"),
        (["--animate", "x.gif", "--kind", "time"], "--animate: goes without --output and --at, and"),
        (["--kind", "loads"], "its scene is not one of this version"),
    ],
)
def test_bad_requests_are_refused_in_one_line(
    tmp_path: Path, made_up_run: Make, capsys: pytest.CaptureFixture[str], words: list[str], rule: str
) -> None:
    made_up_run().record(tmp_path)
    assert main(["plot", str(tmp_path), *words]) == 2
    error = capsys.readouterr().err
    assert rule in error
    assert len(error.splitlines()) == 1


def test_an_mp4_without_an_encoder_is_refused_with_the_rule(
    tmp_path: Path, made_up_run: Make, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    made_up_run().record(tmp_path)
    monkeypatch.setattr("shutil.which", lambda name: None)
    monkeypatch.setitem(__import__("sys").modules, "imageio_ffmpeg", None)
    assert main(["plot", str(tmp_path), "--animate", str(tmp_path / "x.mp4")]) == 2
    assert (
        "MP4 needs ffmpeg: install ffmpeg, or the extra video: pip install 'mdms-emulator[video]'"
        in capsys.readouterr().err
    )
    assert not (tmp_path / "x.mp4").exists()
