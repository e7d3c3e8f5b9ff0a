"""The page over a run that ends while it is watched, in a browser and in windows of several sizes."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from deploy.errors import DeployError
from deploy.live.frame import RunFrame
from deploy.recordings.recording import Recording
from deploy.view.live import LiveSource
from tests.deploy.view.browser import opened, served

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytestmark = pytest.mark.slow


class Ending:
    """A connection to a run that shows twenty frames of a recording, and is gone."""

    def __init__(self, recording: Recording) -> None:
        self.header = recording.header
        self._frames = self._of(recording)

    @staticmethod
    def _of(recording: Recording) -> Iterator[RunFrame]:
        for index in range(0, 200, 10):
            yield RunFrame(
                int(recording.tick[index]),
                float(recording.time_s[index]),
                recording.parcels[index],
                np.ones(1, dtype=np.bool_),
                ("moving",),
                recording.wheel_speeds[index].astype(np.float32),
                recording.presence[index],
                np.zeros(400, dtype=np.uint8),
                "running",
                1.0,
                1.0,
                0.0,
                (),
                (),
            )

    def frame(self) -> RunFrame:
        try:
            return next(self._frames)
        except StopIteration:
            raise DeployError("no run answers") from None

    def request(self, request: dict[str, Any]) -> dict[str, Any]:
        raise DeployError("no run answers")

    def registers(self) -> Any:
        return SimpleNamespace(tick=1, cells={(0, 0): {"firmware.a_register_with_a_long_name": 1.0}})

    def close(self) -> None:
        """Nothing is open."""


def test_a_run_that_has_ended_is_replayed(browser: Browser, recording: Recording) -> None:
    with served(LiveSource(lambda: Ending(recording))) as url, opened(browser, url) as page:
        page.until("!mdms.page.state.live", 20)
        state = page.settled()
        assert (state["run"], state["following"], state["tick"]) == ("ended", False, 190)
        assert page.page.inner_text("#rtf") == "ended"
        assert page.page.is_hidden("#follow")
        assert "the run has ended" in page.page.inner_text("#notice")
        page.press("Space")
        page.until("mdms.page.state.playing && mdms.page.state.tick < 190")
        page.press("Space")
        assert page.press("Home")["tick"] == 0


@pytest.mark.parametrize(("width", "height"), [(900, 600), (1280, 800), (1920, 1080)])
def test_everything_can_be_reached_in_windows_of_several_sizes(
    browser: Browser, recording: Recording, width: int, height: int
) -> None:
    with served(LiveSource(lambda: Ending(recording))) as url, opened(browser, url) as page:
        page.page.set_viewport_size({"width": width, "height": height})
        page.until("!document.getElementById('tab-register').hidden")
        page.page.click("#tab-register")
        page.until("document.querySelector('#subject b')")
        page.settled()
        for name in ("#subject b", "#tab-events", "#theme", "#help", "#toggle", "#speed", "#slider"):
            assert page.page.evaluate(
                """(name) => {
                    const element = document.querySelector(name), box = element.getBoundingClientRect();
                    const seen = [[box.left + 3, box.top + 3], [box.right - 3, box.bottom - 3]];
                    return seen.every(([x, y]) => element.contains(document.elementFromPoint(x, y)));
                }""",
                name,
            ), name
