"""The page over runs in progress, in a browser: the command as a user starts it, and its run's summary."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import pytest

from tests.deploy.view.browser import View, Watched, opened

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def view(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[View]:
    """A run of ``elliptic`` that lasts longer than the tests."""
    found = View(tmp_path_factory.mktemp("live"), "elliptic", "--duration", "1000", "--set", "seed=5")
    yield found
    with found.process:
        found.process.kill()


@pytest.fixture(scope="module")
def shared(browser: Browser, view: View) -> Iterator[Watched]:
    with opened(browser, view.url) as watched:
        yield watched


@pytest.fixture
def page(shared: Watched) -> Watched:
    """The page with nothing selected, while the run runs."""
    shared.send("select_none")
    shared.send("follow")
    if shared.settled()["run"] == "paused":
        shared.send("toggle")
    shared.until("mdms.page.state.run === 'running'")
    return shared


def test_keys_alone_pause_step_move_break_and_repair(page: Watched) -> None:
    page.until("mdms.page.state.tick > 5")
    page.press("p", "Space")
    page.until("mdms.page.state.run === 'paused'")
    tick = page.settled()["tick"]
    time.sleep(0.3)
    assert page.settled()["tick"] == tick
    page.press("ArrowRight")
    page.until(f"mdms.page.state.tick === {tick + 1}")
    x = page.fact("Pose", "x")
    page.press("l")
    page.until(f"Math.abs(JSON.parse(mdms.page.cells['Pose/x'].dataset.value) - {x} - 0.01) < 1e-9")
    page.press("w", "x", "ArrowRight")
    page.until("mdms.page.state.selected?.faults.length === 1")
    page.press("r", "ArrowRight")
    page.until("mdms.page.state.selected?.faults.length === 0")
    page.press("Space")
    page.until(f"mdms.page.state.run === 'running' && mdms.page.state.tick > {tick + 5}")


def test_a_parcel_is_dragged_with_the_modifier_while_the_run_is_paused(page: Watched) -> None:
    page.press("Space", "p")
    page.until("mdms.page.state.run === 'paused'")
    page.settled()
    before = np.array([page.fact("Pose", name) for name in ("x", "y", "angle")])
    start, end = page.place(*before[:2]), page.place(before[0] + 0.2, before[1] + 0.1)
    page.page.keyboard.down("Shift")
    page.page.mouse.move(*start)
    page.page.mouse.down()
    page.page.mouse.move(*end, steps=4)
    page.page.mouse.up()
    page.page.keyboard.up("Shift")
    page.until(f"Math.abs(JSON.parse(mdms.page.cells['Pose/x'].dataset.value) - {before[0]} - 0.2) < 0.01")
    after = np.array([page.fact("Pose", name) for name in ("x", "y", "angle")])
    np.testing.assert_allclose(after - before, (0.2, 0.1, 0.0), atol=0.01)  # a pixel is 4 mm
    page.press("Space")


def test_a_viewer_looks_back_and_returns_while_the_run_goes_on(page: Watched) -> None:
    page.until("mdms.page.state.count > 10")
    tick = page.press("Home")["tick"]
    last = page.settled()["last_s"]
    assert page.settled()["tick"] == tick
    page.until(f"mdms.page.state.last_s > {last}")
    assert page.press("End")["following"]


def test_a_viewer_that_stalls_leaves_or_comes_back_does_not_stall_the_run(
    page: Watched, browser: Browser, view: View
) -> None:
    with opened(browser, view.url) as other:
        other.page.evaluate("window.requestAnimationFrame = () => 0")
        tick = page.settled()["tick"]
        page.until(f"mdms.page.state.tick > {tick + 100} && mdms.page.state.lag_s < 0.2")
    tick = page.settled()["tick"]
    page.until(f"mdms.page.state.tick > {tick + 100} && mdms.page.state.lag_s < 0.2")
    with opened(browser, view.url) as again:
        assert again.settled()["tick"] > tick + 100


def test_a_reset_begins_the_run_again(page: Watched) -> None:
    page.until("mdms.page.state.tick > 300")
    page.press("Shift+R")
    page.until("mdms.page.state.index >= 0 && mdms.page.state.tick < 200", 30)
    assert page.settled()["count"] < 60
    page.until("mdms.page.state.run === 'running' && mdms.page.state.tick > 5")


def test_a_tap_and_crash_kill_the_cell_in_the_summary_and_ctrl_c_leaves_nothing(
    page: Watched, view: View
) -> None:
    x, y = page.place(0.35, -0.45)
    page.page.mouse.click(x, y)
    page.until("mdms.page.state.selected?.title === 'Cell 5,13'")
    page.page.click("[data-fault=crash]")
    page.until("mdms.page.state.selected.faults.length === 1")
    page.page.evaluate("window.mdms.lost = () => {}")  # the server ends before the page
    view.end()
    summary = view.summary()
    assert summary["status"] == "interrupted"
    assert [(fault["kind"], fault["cell"]) for fault in summary["faults"]] == [("crash", [5, 13])]
    assert list(view.folder.glob("runs/*/live.json")) == []
    page.problems.clear()  # the connection has ended
