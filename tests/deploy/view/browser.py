"""Headless chromium for the tests of the page, and a page whose requests and console are watched."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

    from deploy.view.source import RunSource

EXECUTABLE = shutil.which("chromium")
ARGUMENTS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)


@contextmanager
def chromium() -> Iterator[Browser]:
    """Debian's chromium; the test is skipped without it, or fails where it must be there."""
    if EXECUTABLE is None:
        if os.environ.get("MDMS_BROWSER") == "required":
            pytest.fail("chromium is not installed, though .ci/browser could install it")
        pytest.skip("chromium is not installed: run .ci/browser as root")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=EXECUTABLE, args=ARGUMENTS)
        yield browser
        browser.close()


@contextmanager
def served(source: RunSource) -> Iterator[str]:
    """Address of the page of a source, served by a thread."""
    from deploy.view.server import PageServer

    made: list[PageServer] = []
    ready = threading.Event()

    def serve() -> None:
        made.append(PageServer(source))
        ready.set()
        made[0].run()

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    assert ready.wait(30)
    try:
        yield made[0].url
    finally:
        made[0].stop()
        thread.join(30)
        assert not thread.is_alive()


class Watched:
    """A page, with short words for what tests do there; ``problems`` has its errors and requests beyond loopback."""

    def __init__(self, page: Page, url: str) -> None:
        self.page = page
        self.problems: list[str] = []
        page.on("console", lambda message: self._note(message.type, message.text))
        page.on("pageerror", lambda error: self.problems.append(f"page: {error}"))
        page.on("request", lambda request: self._request(request.url))
        page.on("websocket", lambda socket: self._request(socket.url))
        page.on("requestfailed", lambda request: self.problems.append(f"failed: {request.url}"))
        page.goto(url)
        self.until("window.mdms && mdms.page.frames > 1")

    def _note(self, kind: str, text: str) -> None:
        if kind in ("error", "warning"):
            self.problems.append(f"console {kind}: {text}")

    def _request(self, url: str) -> None:
        if not url.startswith(("http://127.0.0.1:", "ws://127.0.0.1:", "data:", "blob:")):
            self.problems.append(f"request: {url}")

    def until(self, expression: str, timeout_s: float = 10.0) -> None:
        """Wait until an expression of the page is true."""
        self.page.wait_for_function(expression, timeout=1_000 * timeout_s)

    def state(self) -> dict[str, Any]:
        """State that the page shows."""
        return self.page.evaluate("mdms.page.state")

    def send(self, op: str, **more: Any) -> None:
        """Send a command as the page's script does."""
        self.page.evaluate("([op, more]) => mdms.send(op, more)", [op, more])

    def settled(self) -> dict[str, Any]:
        """State after the server has taken all commands sent so far, and answered with frames."""
        self.until("mdms.page.state.handled === mdms.page.number")
        seen = self.page.evaluate("mdms.page.state.seq")
        self.until(f"mdms.page.state.seq > {seen}")
        return self.state()

    def fact(self, section: str, name: str) -> Any:
        """Value in the inspector, in full precision."""
        return self.page.evaluate(f"JSON.parse(mdms.page.cells['{section}/{name}'].dataset.value)")

    def press(self, *keys: str) -> dict[str, Any]:
        """Press keys one after another, and return the state after them."""
        for key in keys:
            self.page.keyboard.press(key)
        return self.settled()

    def place(self, x: float, y: float) -> tuple[float, float]:
        """Pixel of a place in the array, m."""
        return tuple(
            self.page.evaluate(
                """([x, y]) => {
                    const view = Bokeh.index.find_one(mdms.page.plot), edge = view.el.getBoundingClientRect();
                    return [edge.left + view.frame.x_scale.compute(x), edge.top + view.frame.y_scale.compute(y)];
                }""",
                [x, y],
            )
        )


@contextmanager
def opened(browser: Browser, url: str, **options: Any) -> Iterator[Watched]:
    """A page that must end without an error in its console and without a request beyond loopback."""
    context = browser.new_context(viewport={"width": 1280, "height": 800}, **options)
    watched = Watched(context.new_page(), url)
    yield watched
    assert watched.problems == []
    context.close()


class View:
    """``mdms view`` in a folder of its own."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.folder = folder
        command = [sys.executable, "-m", "deploy.cli", "view", *arguments, "--no-browser"]
        root = Path(__file__).parents[3]
        self.process = subprocess.Popen(
            command,
            cwd=folder,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": str(root)},
        )
        assert self.process.stdout is not None
        self.url = self.process.stdout.readline().strip()

    def end(self) -> None:
        self.process.send_signal(signal.SIGINT)
        with self.process:
            assert self.process.wait(30) == 0

    def summary(self) -> dict[str, Any]:
        """Summary of the newest run, once it has ended."""
        paths = sorted(self.folder.glob("runs/*/summary.json"), key=lambda path: path.stat().st_mtime)
        return json.loads(paths[-1].read_text())
