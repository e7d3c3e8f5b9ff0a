"""Session of one viewer: position, choices, and updates of the page."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from deploy.errors import DeployError
from deploy.view.colouring import Colouring
from deploy.view.event_list import EventList
from deploy.view.forces import WheelForces
from deploy.view.geometry import CellGrid, outline
from deploy.view.inspector import cell_facts, parcel_facts
from deploy.view.layers import DRAW, Captures, Scenery, draw_marks
from deploy.view.map_figure import MapFigure
from deploy.view.outcomes import Outcomes
from deploy.view.palette import theme_of
from deploy.view.player import Player
from deploy.view.plot_figure import PlotFigure
from deploy.view.quantity_series import QuantitySeries
from deploy.view.series import PARCEL_TABS, Series, parcel_series, register_series, wheel_series

if TYPE_CHECKING:
    from bokeh.document import Document

    from deploy.view.channel import PageChannel
    from deploy.view.source import Floats, Instant, RunSource

_IN_FLIGHT: Final = 2
"""Most frames that the browser has not confirmed: a page that stalls gets no more until it goes on."""
_EVALUATION_S: Final = 0.02
"""Time for values of a plotted quantity in an update, wall seconds."""
_PLOT_S: Final = 1.0
"""Interval at which the plot of a run in progress is drawn again, wall seconds."""


@final
@dataclass(slots=True)
class ViewerChoice:
    """Choices of a viewer.

    Attributes:
        layers: Layers that are shown.
        cell: The selected cell, by index; None: none is.
        parcel: The selected parcel; None: none is.
        tab: Tab below the map.
        register: Register in the plot.
        dark: Whether the page is dark.
        ghost: Pose to which a parcel is being moved; None: none is.
    """

    layers: set[str] = field(default_factory=lambda: {"arrows", "trails", "captured"})
    cell: int | None = None
    parcel: int | None = None
    tab: str = "position"
    register: str = ""
    dark: bool = False
    ghost: Floats | None = None


@final
class Session:
    """State of one page, and its updates.

    Args:
        document: The page's document.
        source: The run.
        channel: Model through which the page and the session exchange state and commands.
        executor: Runs requests to the run, which may wait.

    Attributes:
        source: As given.
        grid: Places of the cells.
        footprints: Corners of each parcel, ``(v, 2)``, m.
        player: Position in the run.
        choice: Choices of the viewer.
        colouring: Colours of the cells.
        map: Figure of the map.
        plot: Figure below the map.
        handled: Number of the newest commands that were carried out.
        motors: Whether the scene has motors.
        held: From the pointer to the centre of the parcel that is being moved, m.
    """

    def __init__(
        self,
        document: Document,
        source: RunSource,
        channel: PageChannel,
        executor: Executor,
    ) -> None:
        header = source.header
        self._document, self._channel, self._executor = document, channel, executor
        self.source = source
        self.grid = CellGrid(header["cells"], header["positions_m"], header["pitch_m"])
        self.footprints = tuple(np.array(corners, dtype=np.float64) for corners in header["footprints_m"])
        effects: dict[str, Any] = header["scene"].get("effects") or {}
        self.motors = bool(effects.get("motors"))
        self.player = Player(source)
        self.choice = ViewerChoice()
        self._forces = WheelForces(source)
        self.colouring = Colouring(source, self._forces.quantities, WheelForces(source, rest=0.0).quantities)
        self.map = MapFigure(self.grid, self.footprints, *_surroundings(header))
        self.plot = PlotFigure()
        self._quantity_series = QuantitySeries(source)
        self._events = EventList(source)
        self._captures = Captures(source)
        self._outcomes = Outcomes(source)
        self._seq = 0
        self._last = time.monotonic()
        self._plotted: tuple[Any, ...] = ()
        self._plotted_s = 0.0
        self.held: Floats = np.zeros(2)
        self.handled = 0
        self._notice: dict[str, Any] = {"text": "", "kind": "", "number": 0}
        self.colouring.choose("speed")
        self.paint()

    # --- requests of the page ----------------------------------------------------------------------

    def paint(self) -> None:
        """Set the colours of the theme."""
        theme = theme_of(dark=self.choice.dark)
        self.map.paint(theme)
        self.plot.paint(theme)

    def notify(self, text: str, kind: str = "info") -> None:
        """Show a line to the viewer; ``kind``: info or error."""
        self._notice = {"text": text, "kind": kind, "number": self._notice["number"] + 1}

    def ask(self, request: dict[str, Any], then: Callable[[dict[str, Any]], None] | None = None) -> None:
        """Send a request to the run from another thread, and handle the answer here; refusals are shown."""
        after = then or _ignore

        def work() -> None:
            try:
                answer = self.source.request(request)
            except DeployError as error:
                text = str(error)
                self._document.add_next_tick_callback(lambda: self.notify(text, "error"))
            else:
                self._document.add_next_tick_callback(lambda: after(answer))

        self._executor.submit(work)

    def replot(self) -> None:
        """Draw the plot again with the next frame."""
        self._plotted = ()

    def instant(self) -> Instant | None:
        """Return the instant at the viewer's position; None if there is none yet."""
        index = self.player.index
        return None if index < 0 else self.source.at(index)

    # --- updates of the page -----------------------------------------------------------------------

    def update(self) -> None:
        """Advance the position, and send the page what has changed unless frames wait there."""
        now = time.monotonic()
        if self.player.following and not self.source.live:
            self.player.follow()
            self.notify("the run has ended; the page replays the frames that it has kept")
        self.player.advance(now - self._last)
        self._last = now
        if self._seq - int(self._channel.seen) >= _IN_FLIGHT:
            return
        index = self.player.index
        self._seq += 1
        if index >= 0:
            instant = self.source.at(index)
            self._draw(index, instant)
            self._draw_plot(instant.time_s, now)
        else:
            instant = None
        self._events.send(self._channel, now)
        self._channel.state = self._state(index, instant)

    def _draw(self, index: int, instant: Instant) -> None:
        """Set the layers of the map."""
        theme, choice = theme_of(dark=self.choice.dark), self.choice
        colours = self.colouring.colours(index, instant, theme)
        self.map.put("image", image=[self.grid.image(colours)])
        fastest = float(np.nanmax(np.hypot(*instant.wheel_speeds.T), initial=0.0))
        scene = Scenery(
            self.source,
            self.grid,
            self.footprints,
            index,
            instant,
            self.grid.in_sight(*self.map.view()),
            fastest,
            self._captures,
        )
        draw_marks(self.map, scene)
        self.map.size_marks(len(scene.in_sight))
        for name, draw in DRAW.items():
            if name in choice.layers:
                draw(self.map, scene)
            else:
                self.map.clear(name)
        self.map.put_parcels(instant.parcels, choice.parcel)
        selected = self.grid.centres[[] if choice.cell is None else [choice.cell]]
        self.map.put("selected", x=selected[:, 0], y=selected[:, 1])
        if choice.ghost is None or choice.parcel is None:
            self.map.clear("ghost")
        else:
            corners = outline(self.footprints[choice.parcel], choice.ghost)
            self.map.put("ghost", xs=[corners[:, 0].tolist()], ys=[corners[:, 1].tolist()])

    def _draw_plot(self, time_s: float, now: float) -> None:
        """Draw the plot again if its subject has changed, or a run has gone on; move its mark."""
        choice, times = self.choice, self.source.times_s
        subject: tuple[Any, ...] = (
            choice.tab,
            choice.cell,
            choice.parcel,
            choice.register,
            self.source.revision,
        )
        if choice.tab == "quantity":
            quantity = self.colouring.quantity.name
            self._quantity_series.advance(quantity, _EVALUATION_S)
            subject += (quantity, self._quantity_series.count)
        grown = self.source.live and now - self._plotted_s >= _PLOT_S
        if subject != self._plotted or grown:
            self._plotted, self._plotted_s = subject, now
            series = self._series()
            if series is not None:
                self._channel.lines = {
                    "title": series.title,
                    "unit": series.unit,
                    "names": list(series.names),
                    "colours": list(theme_of(dark=choice.dark).lines),
                }
                self.plot.show(series, float(times[0]), float(times[-1]))
        self.plot.mark(time_s)

    def _series(self) -> Series | None:
        choice = self.choice
        if choice.tab in PARCEL_TABS:
            return parcel_series(self.source, choice.parcel or 0, choice.tab) if self.footprints else None
        if choice.tab == "wheels":
            return wheel_series(self.source, choice.cell or 0)
        if choice.tab == "quantity":
            return self._quantity_series.series(self.colouring.quantity.name, choice.cell or 0)
        if choice.tab == "register" and choice.register:
            return register_series(self.source, choice.cell or 0, choice.register)
        return None

    def _state(self, index: int, instant: Instant | None) -> dict[str, Any]:
        """Return what the page shows in words and numbers."""
        run, times, choice = self.source.run_state(), self.source.times_s, self.choice
        return {
            "seq": self._seq,
            "handled": self.handled,
            "live": self.source.live,
            "run": run.state,
            "following": self.player.following,
            "playing": self.player.playing if not self._controls else run.state == "running",
            "backwards": self.player.backwards,
            "speed": run.speed if self._controls else self.player.speed,
            "real_time_factor": run.real_time_factor,
            "lag_s": run.lag_s,
            "index": index,
            "count": len(times),
            "first_s": float(times[0]) if len(times) else 0.0,
            "last_s": float(times[-1]) if len(times) else 0.0,
            "tick": -1 if instant is None else instant.tick,
            "time_s": 0.0 if instant is None else instant.time_s,
            "legend": self.colouring.legend(theme_of(dark=choice.dark)),
            "colours": self.colouring.options(),
            "layers": sorted(choice.layers),
            "tab": choice.tab,
            "register": choice.register,
            "dark": choice.dark,
            "allows": [name for name in ("control", "fault", "move") if self.source.allows(name)],
            "selected": None if instant is None else self._selected(index, instant),
            "notice": self._notice,
        }

    @property
    def _controls(self) -> bool:
        """Whether run, pause and speed act on the run itself."""
        return self.player.following and self.source.allows("control")

    def _selected(self, index: int, instant: Instant) -> dict[str, Any] | None:
        choice = self.choice
        if choice.parcel is not None:
            loads_n = self._forces.loads_n(instant).tolist()
            outcome = self._outcomes.at(instant.time_s, choice.parcel)
            return parcel_facts(self.source, self.grid, instant, choice.parcel, loads_n, outcome)
        if choice.cell is not None:
            load_n = float(self._forces.loads_n(instant)[choice.cell])
            return cell_facts(self.source, self.grid, instant, index, choice.cell, load_n)
        return None


def _ignore(answer: dict[str, Any]) -> None:
    """Do nothing with an answer."""


def _surroundings(header: Any) -> tuple[list[Floats], list[tuple[str, Floats]]]:
    """Return the guide rails and the exits of a run."""
    effects: dict[str, Any] = header["scene"].get("effects") or {}
    contact: dict[str, Any] = effects.get("parcel_contact") or {}
    rails = [np.array(rail, dtype=np.float64) for rail in contact.get("rails", ())]
    exits = [(e["name"], np.array(e["corners_m"], dtype=np.float64)) for e in header.get("exits", ())]
    return rails, exits
