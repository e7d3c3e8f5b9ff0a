"""Layers of the map at an instant: each a function that sets its part of the figure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np
from numpy.typing import NDArray

from bus.lattice import SIDES
from cell_firmware.shard import MESSAGES
from deploy.faults.fault_state import DEAD, FAULTY
from deploy.view.geometry import MOST_DETAILED, CellGrid, arrows, broken_line, closed, outline, trails

if TYPE_CHECKING:
    from deploy.view.map_figure import MapFigure
    from deploy.view.source import Floats, Instant, Ints, RunSource

LAYERS: Final = {
    "arrows": "arrows",
    "trails": "trails",
    "messages": "messages",
    "captured": "captured edges",
    "coming": "outlines to come",
}
"""Layers that can be switched: name and label."""

_TRAIL_S: Final = 3.0
"""Length of trails, simulated seconds."""
_COMING_S: Final = (0.25, 0.5, 1.0, 2.0)
"""Times ahead at which outlines to come are drawn, s."""


@final
class Captures:
    """Captures and releases among the events of a run, found once.

    Args:
        source: The run.
    """

    def __init__(self, source: RunSource) -> None:
        self._source = source
        self._seen = (0, 0)
        self._found: list[tuple[float, bool, tuple[int, int, int], tuple[float, float]]] = []

    def at(self, time_s: float) -> list[tuple[float, float]]:
        """Return the centres of the cells at whose edge a parcel is captured at a time, m."""
        self._look()
        held: dict[tuple[int, int, int], tuple[float, float]] = {}
        for at_s, begins, key, place in self._found:
            if at_s > time_s:
                break
            if begins:
                held[key] = place
            else:
                held.pop(key, None)
        return list(held.values())

    def _look(self) -> None:
        """Look through the events that are new."""
        events, (count, revision) = self._source.events, self._seen
        if revision != self._source.revision or count > len(events):
            self._found, count = [], 0
        for event in events[count:]:
            if event["kind"] in ("captured", "released"):
                x, y = event["position_m"]
                for row, column in event.get("cells") or ():
                    key = int(event["parcel"]), int(row), int(column)
                    self._found.append((float(event["time_s"]), event["kind"] == "captured", key, (x, y)))
        self._seen = len(events), self._source.revision


@final
@dataclass(frozen=True, slots=True, eq=False)
class Scenery:
    """Arguments of every layer.

    Attributes:
        source: The run.
        grid: Places of the cells.
        footprints: Corners of each parcel, ``(v, 2)``.
        index: The instant's number.
        instant: The instant.
        in_sight: Cells in sight, by index.
        fastest: Speed of an arrow as long as a cell, m/s.
        captures: Captures and releases of the run.
    """

    source: RunSource
    grid: CellGrid
    footprints: tuple[Floats, ...]
    index: int
    instant: Instant
    in_sight: Ints
    fastest: float
    captures: Captures

    @property
    def detailed(self) -> bool:
        """Whether cells are large enough to be drawn one by one."""
        return len(self.in_sight) <= MOST_DETAILED


def draw_marks(figure: MapFigure, scene: Scenery) -> None:
    """Draw the gaps between cells, and the marks of dead and faulty ones."""
    shown = scene.grid.centres[scene.in_sight if scene.detailed else []]
    figure.put("grid", x=shown[:, 0], y=shown[:, 1])
    for name, health in (("dead", DEAD), ("faulty", FAULTY)):
        cells = scene.in_sight[scene.instant.health[scene.in_sight] == health][:MOST_DETAILED]
        figure.put(name, x=scene.grid.centres[cells, 0], y=scene.grid.centres[cells, 1])


def draw_arrows(figure: MapFigure, scene: Scenery) -> None:
    """Draw wheel velocities, of cells in sight if there are few enough."""
    cells = scene.in_sight if scene.detailed else scene.in_sight[:0]
    speeds = scene.instant.wheel_speeds[cells].astype(np.float64)
    figure.put("arrows", **arrows(scene.grid.centres[cells], speeds, scene.fastest, scene.grid.pitch_m))


def draw_trails(figure: MapFigure, scene: Scenery) -> None:
    """Draw the parcels' paths up to the instant."""
    first = int(np.searchsorted(scene.source.times_s, scene.instant.time_s - _TRAIL_S))
    x, y = broken_line(trails(scene.source.states, scene.index, max(1, scene.index - first)))
    figure.put("trails", x=x, y=y)


def draw_coming(figure: MapFigure, scene: Scenery) -> None:
    """Draw outlines after the instant: as recorded, or where a parcel would be at its present velocity."""
    times, states = scene.source.times_s, scene.source.states
    pieces: list[Floats] = []
    for ahead_s in _COMING_S:
        index = int(np.searchsorted(times, scene.instant.time_s + ahead_s))
        if index < len(times):
            later = states[index]
        elif scene.source.live and scene.index == len(times) - 1:
            later = scene.instant.parcels.copy()
            later[:, :3] += ahead_s * later[:, 3:]
        else:
            continue
        pieces += [
            closed(outline(footprint, state))
            for footprint, state in zip(scene.footprints, later, strict=True)
            if np.isfinite(state).all()
        ]
    x, y = broken_line(pieces)
    figure.put("coming", x=x, y=y)


def draw_captured(figure: MapFigure, scene: Scenery) -> None:
    """Draw the cells at whose edge a parcel is captured."""
    places = np.array(scene.captures.at(scene.instant.time_s), dtype=np.float64).reshape(-1, 2)
    figure.put("captured", x=places[:, 0], y=places[:, 1])


def draw_messages(figure: MapFigure, scene: Scenery) -> None:
    """Draw the halves of links on which cells have sent since the registers before."""
    sides = sending_sides(scene)
    sent: NDArray[np.bool_] = np.logical_or.reduce(sides, axis=1)
    ends: dict[str, list[float]] = {"x0": [], "y0": [], "x1": [], "y1": []}
    for cell in scene.in_sight[sent[scene.in_sight]].tolist() if scene.detailed else ():
        x, y = scene.grid.centres[cell].tolist()
        for side, other in scene.grid.beside(cell).items():
            if not sides[cell, SIDES.index(side)]:
                continue
            to_x, to_y = scene.grid.centres[other].tolist()
            for key, at, to in (("x", x, to_x), ("y", y, to_y)):
                ends[f"{key}0"].append(at + 0.36 * (to - at))
                ends[f"{key}1"].append(at + 0.5 * (to - at))
    figure.put("messages", **{key: np.array(values) for key, values in ends.items()})


def sending_sides(scene: Scenery) -> NDArray[np.bool_]:
    """Return the sides to which cells send, ``(n, 4)``: those of the last tick where its messages are known.

    Cells that have sent since the registers before, and not in the last tick, have all sides.
    """
    cells = len(scene.instant.health)
    now_s, now = scene.source.registers(scene.index)
    grown = _grown(scene, cells, now_s, now)
    sides: NDArray[np.bool_] = np.repeat(grown[:, np.newaxis], len(SIDES), axis=1)
    last = now.get(f"{MESSAGES}sent")
    if last is not None:
        sent = last.reshape(cells, len(SIDES)) > 0  # not a number: of a dead cell
        known = sent.any(axis=1)
        sides[known] = sent[known]
    return sides


def _grown(scene: Scenery, cells: int, now_s: float, now: Mapping[str, NDArray[Any]]) -> NDArray[np.bool_]:
    """Return the cells whose count of sent messages has grown since the registers before, ``(n,)``."""
    if "messages.sent" not in now:
        return np.zeros(cells, dtype=np.bool_)
    earlier = int(np.searchsorted(scene.source.times_s, now_s - 1e-9)) - 1
    _, before = scene.source.registers(max(0, earlier))
    grown = now["messages.sent"].reshape(cells, -1).sum(axis=1)
    if "messages.sent" in before:
        grown = grown.astype(np.int64) - before["messages.sent"].reshape(cells, -1).sum(axis=1).astype(
            np.int64
        )
    return grown > 0


DRAW: Final[Mapping[str, Callable[[MapFigure, Scenery], None]]] = {
    "arrows": draw_arrows,
    "trails": draw_trails,
    "messages": draw_messages,
    "captured": draw_captured,
    "coming": draw_coming,
}
"""Function of each layer that can be switched."""
