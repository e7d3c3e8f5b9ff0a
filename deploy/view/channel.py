"""Model through which the page's script and the server exchange state and commands."""

# pyright: reportUnknownMemberType=false
# (Bokeh's properties are descriptors without types.)

from __future__ import annotations

from typing import Any as Value

from bokeh.core.properties import Any, Int
from bokeh.model import DataModel


class PageChannel(DataModel):
    """Exchange between page and server; each property is written by one side.

    Attributes:
        state: Of the server: state of the page in JSON's types, once a frame.
        events: Of the server: rows of the event list.
        lines: Of the server: legend of the plot.
        menu: Of the server: kinds of faults, layers, speeds.
        command: Of the page: the newest commands, ``{"number": n, "commands": [...]}``.
        seen: Of the page: number of the last state that is on the screen.
    """

    state: Value = Any(default=None)
    events: Value = Any(default=None)
    lines: Value = Any(default=None)
    menu: Value = Any(default=None)
    command: Value = Any(default=None)
    seen: Value = Int(default=0)
