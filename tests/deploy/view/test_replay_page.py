"""The page over a recording, in a browser."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import pytest

from deploy.recordings.recording import Recording
from deploy.view.forces import WheelForces
from deploy.view.replay import ReplaySource
from tests.deploy.view.browser import Watched, opened, served

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def url(recording: Recording) -> Iterator[str]:
    with served(ReplaySource(recording)) as address:
        yield address


@pytest.fixture(scope="module")
def shared(browser: Browser, url: str) -> Iterator[Watched]:
    with opened(browser, url) as watched:
        yield watched


@pytest.fixture
def page(shared: Watched) -> Watched:
    """The page as when it was opened: it takes a second to load."""
    shared.send("select_none")
    shared.send("tab", name="position")
    shared.send("colour", name="speed")
    shared.send("layer", name="arrows", on=True)
    shared.send("speed", factor=1)
    shared.send("reverse", on=False)
    shared.send("step", instants=0)
    shared.send("seek", index=0)
    shared.page.evaluate("document.activeElement?.blur(); document.getElementById('fit').click()")
    shared.settled()
    return shared


def test_the_parcel_moves_while_the_recording_plays_and_stands_while_it_is_paused(page: Watched) -> None:
    page.press("p")
    start = page.fact("Pose", "x")
    page.page.click("#toggle")
    page.until("mdms.page.state.time_s > 0.3")
    assert abs(page.fact("Pose", "x") - start) > 0.01
    page.page.click("#toggle")
    tick = page.settled()["tick"]
    assert page.settled()["tick"] == tick


def test_the_slider_reaches_the_recorded_pose(page: Watched, recording: Recording) -> None:
    page.press("p")
    for index in (0, 57, 200, len(recording.tick) - 1):
        page.page.locator("#slider").fill(str(index))
        page.until(f"mdms.page.state.index === {index}")
        page.settled()
        pose = [page.fact("Pose", name) for name in ("x", "y", "angle")]
        np.testing.assert_allclose(pose, recording.parcels[index, 0, :3], rtol=0, atol=1e-9)


def test_loads_sum_to_the_weight_and_are_in_the_inspector(page: Watched, recording: Recording) -> None:
    source = ReplaySource(recording)
    forces = WheelForces(source)
    loads_n = forces.loads_n(source.at(150))
    assert loads_n.sum() == pytest.approx(2.0 * 9.81, rel=1e-9)
    page.page.locator("#slider").fill("150")
    page.press("p")
    page.until("mdms.page.state.index === 150")
    page.settled()
    row, column = recording.header["cells"][int(np.argmax(loads_n))]
    assert page.fact(page.state()["selected"]["sections"][2]["name"], f"{row},{column}") == pytest.approx(
        loads_n.max()
    )
    page.page.select_option("#colour", "traction")
    page.until("mdms.page.state.legend.name === 'traction' && mdms.page.state.legend.high > 0")


def test_the_quantity_that_colours_cells_is_plotted_of_the_selected_cell(
    page: Watched, recording: Recording
) -> None:
    page.page.click("#tab-quantity")
    page.send("select_cell", row=14, column=15)
    page.page.select_option("#colour", "load")
    page.until("mdms.page.channel.lines?.title === 'load of cell 14,15'")
    line = "Bokeh.documents[0].get_model_by_name('plot').renderers[0].data_source.data.y"
    page.until(f"{line}.length > 100")
    most = max(recording.tractions(row).load_n[14 * 20 + 15] for row in range(0, len(recording.tick), 2))
    page.until(f"Math.abs(Math.max(...{line}) - {most}) < 1e-9")


def test_it_plays_both_ways_at_a_speed(page: Watched) -> None:
    page.page.locator("#slider").fill("200")
    page.until("mdms.page.state.index === 200")
    page.page.click("#reverse")
    page.page.select_option("#speed", "2")
    page.page.click("#toggle")
    page.until("mdms.page.state.index < 100")
    page.until("mdms.page.state.index === 0 && !mdms.page.state.playing")
    page.page.click("#reverse")
    page.page.click("#toggle")
    page.until("mdms.page.state.index === mdms.page.state.count - 1")


def test_keys_alone_step_select_colour_and_jump(page: Watched, recording: Recording) -> None:
    assert page.press("ArrowRight", "ArrowRight", "ArrowLeft")["index"] == 1
    first = page.press("w")["selected"]
    second = page.press("d", "w")["selected"]
    assert (second["row"], second["column"]) == (first["row"] + 1, first["column"] + 1)
    assert page.press("Escape")["selected"] is None
    assert page.press("p")["selected"]["title"] == "Parcel 0"
    assert page.press("3")["legend"]["name"] == "health"
    assert page.press("]")["time_s"] > 0
    assert page.press("End")["index"] == len(recording.tick) - 1
    assert page.press("Home")["index"] == 0
    page.press("Space")
    page.until("mdms.page.state.index > 3")
    assert not page.press("Space")["playing"]
    assert page.press("t")["dark"]


def test_a_tap_selects_a_cell_and_a_second_tap_the_parcel_above_it(
    page: Watched, recording: Recording
) -> None:
    x, y = page.place(*recording.header["positions_m"][3 * 20 + 7])
    page.page.mouse.click(x, y)
    page.until("mdms.page.state.selected?.title === 'Cell 3,7'")
    x, y = page.place(*recording.parcels[0, 0, :2])
    page.page.wait_for_timeout(400)  # two taps at once are a double tap
    page.page.mouse.click(x, y)
    page.until("mdms.page.state.selected?.kind === 'cell' && mdms.page.state.selected.row > 10")
    page.page.wait_for_timeout(400)
    page.page.mouse.click(x, y)
    page.until("mdms.page.state.selected?.kind === 'parcel'")


def test_events_and_faults_are_listed_and_a_click_jumps_there(page: Watched, recording: Recording) -> None:
    page.page.click("#tab-events")
    page.page.click("text=wheel stuck begins")
    page.until("Math.abs(mdms.page.state.time_s - 0.401408) < 1e-9")
    page.press("s")
    page.send("select_cell", row=5, column=5)
    page.until("mdms.page.state.selected?.faults.length === 1")
    assert page.fact("State", "health") == "faulty"
    page.send("select_cell", row=12, column=14)
    page.until("mdms.page.state.selected?.title === 'Cell 12,14'")
    page.settled()
    assert page.fact("State", "health") == "dead or lost"


def test_event_keys_go_to_the_nearest_event_either_way_and_the_list_follows(
    page: Watched, recording: Recording
) -> None:
    page.page.click("#tab-events")
    moments = sorted(float(record["time_s"]) for record in (*recording.events, *recording.faults))
    instants = np.searchsorted(recording.time_s, np.array(moments) - 1e-12)
    for start, key, wanted in (
        (100, "]", int(instants[instants > 100].min())),
        (100, "[", int(instants[instants < 100].max())),
    ):
        page.page.locator("#slider").fill(str(start))
        page.until(f"mdms.page.state.index === {start}")
        assert page.press(key)["index"] == wanted
        row = page.page.locator("#rows [aria-current]").inner_text()
        last = max(moment for moment in moments if moment <= recording.time_s[wanted])
        assert row.startswith(f"{last:.3f} s")
    assert page.page.is_hidden("#subject"), "of a plot that isn't there"
    page.press("Home", "[")
    assert page.state()["notice"]["text"] == "there is no event before this instant"


def test_space_and_arrows_keep_their_meaning_after_clicks(page: Watched) -> None:
    page.page.click("#layer-messages")
    page.page.locator("#colour").click(position={"x": 20, "y": 40})
    page.page.click("#tab-angle")
    page.press("ArrowRight", "ArrowRight")
    assert page.state()["index"] == 2
    assert page.press("Space")["playing"]
    assert not page.press("Space")["playing"]
    page.page.focus("#colour")
    assert page.press("w")["selected"] is None, "a list has its own keys"
    assert page.press("Escape", "w")["selected"] is not None
    assert page.press("Escape")["selected"] is None
    page.page.focus("#layer-messages")
    before = page.page.is_checked("#layer-messages")
    page.press("Space")
    assert page.page.is_checked("#layer-messages") is not before, "by keyboard alone boxes keep their key"
    page.page.uncheck("#layer-messages")


def test_arrows_are_drawn_for_the_cells_in_sight(page: Watched) -> None:
    count = "mdms.page.plot.document.get_model_by_name('arrows').data.x0.length"
    page.page.locator("#slider").fill("100")  # wheels stand at the first instant
    page.until(f"{count} > 350")
    page.page.evaluate("for (let k = 0; k < 6; k++) document.getElementById('in').click()")
    page.until(f"{count} > 0 && {count} < 100")
    page.page.uncheck("#layer-arrows")
    page.until(f"{count} === 0")


def test_errors_and_requests_beyond_loopback_would_be_noticed(browser: Browser, url: str) -> None:
    with opened(browser, url) as page:
        assert page.problems == []
        page.page.evaluate("console.error('wrong'); fetch('http://192.0.2.1/').catch(() => {}); 0")
        page.page.evaluate(
            "new WebSocket('ws://192.0.2.1/'); setTimeout(() => { throw Error('thrown'); }); 0"
        )
        page.page.wait_for_timeout(300)
        assert {"console error: wrong", "page: thrown", "request: http://192.0.2.1/"} <= set(page.problems)
        assert "request: ws://192.0.2.1/" in page.problems
        page.problems.clear()


RATIO = """(() => {
    const metres = (range, pixels) => (range.end - range.start) / pixels, plot = mdms.page.plot;
    return metres(plot.x_range, plot.inner_width) / metres(plot.y_range, plot.inner_height);
})()"""


def test_axes_stay_equal_when_the_window_changes(page: Watched) -> None:
    assert page.page.evaluate(RATIO) == pytest.approx(1.0, abs=1e-6)
    page.page.set_viewport_size({"width": 1500, "height": 700})
    page.until(f"mdms.page.plot.inner_width > 900 && Math.abs({RATIO} - 1) < 1e-6")
    page.page.set_viewport_size({"width": 1280, "height": 800})


def test_a_page_that_stalls_gets_no_more_frames_until_it_goes_on(page: Watched) -> None:
    page.page.click("#toggle")
    page.page.evaluate(
        "mdms.page.held = window.requestAnimationFrame; window.requestAnimationFrame = () => 0"
    )
    page.page.wait_for_timeout(300)
    first = page.state()["seq"]
    page.page.wait_for_timeout(500)
    assert page.state()["seq"] == first
    page.page.evaluate(
        "window.requestAnimationFrame = mdms.page.held; mdms.page.channel.seen = mdms.page.state.seq"
    )
    page.until(f"mdms.page.state.seq > {first} + 3")
