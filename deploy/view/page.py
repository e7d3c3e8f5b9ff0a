"""Document of the page: template, figures, and the channel between its script and a session."""

# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false
# (Bokeh leaves the keywords of its methods untyped.)

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from bokeh.events import Tap
from bokeh.models import CustomJS

from deploy.view.channel import PageChannel
from deploy.view.commands import handle
from deploy.view.fault_menu import fault_menu
from deploy.view.layers import LAYERS
from deploy.view.player import SPEEDS
from deploy.view.session import Session

if TYPE_CHECKING:
    from bokeh.document import Document

    from deploy.view.source import RunSource

_ASSETS: Final = Path(__file__).parent / "assets"
FRAME_MS: Final = 80
"""Interval between two frames, wall milliseconds: 12 a second."""


def build_page(document: Document, source: RunSource, executor: Executor) -> Session:
    """Fill a new document, and keep it up to date until its browser leaves.

    Args:
        document: The document of one viewer.
        source: The run.
        executor: Runs requests to the run, which may wait.

    Returns:
        The session behind the document.
    """
    channel = PageChannel(name="channel")
    session = Session(document, source, channel, executor)
    channel.menu = {
        "faults": list(fault_menu(motors=session.motors)),
        "layers": [{"name": name, "label": label} for name, label in LAYERS.items()],
        "speeds": list(SPEEDS),
        "parcels": len(session.footprints),
    }

    def commands(name: str, old: object, new: Any) -> None:
        del name, old
        for command in new["commands"]:
            handle(session, command)
        session.handled = int(new["number"])

    channel.on_change("command", commands)
    on_tap(session.map.figure, lambda x, y: handle(session, {"op": "pick", "x": x, "y": y}))
    on_tap(session.plot.figure, lambda x, _: handle(session, {"op": "seek", "time_s": x}))
    document.js_on_event("connection_lost", CustomJS(code="window.mdms.lost()"))
    document.add_root(session.map.figure)
    document.add_root(session.plot.figure)
    session.map.figure.tags = [channel]  # a model of the document without a place on the page
    header = source.header
    document.title = f"{header['scene_name']} · mdms view"
    document.template = _template()
    document.template_variables.update(
        heading=header["title"],
        scene=header["scene_name"],
        style=(_ASSETS / "page.css").read_text(encoding="utf-8"),
        script=(_ASSETS / "page.js").read_text(encoding="utf-8"),
    )
    session.update()
    document.add_periodic_callback(session.update, FRAME_MS)
    return session


def on_tap(plot: Any, act: Callable[[float, float], None]) -> None:
    """Call ``act`` with the place of every tap on a figure, in its coordinates."""

    def tapped(event: Any) -> None:
        if event.x is not None and event.y is not None:
            act(event.x, event.y)

    plot.on_event(Tap, tapped)


def _template() -> Any:
    from bokeh.core.templates import get_env

    return get_env().from_string((_ASSETS / "page.html").read_text(encoding="utf-8"))
