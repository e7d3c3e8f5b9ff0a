"""Commands of the page: a function each, by name."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from deploy.view.fault_menu import fault_request
from deploy.view.inspector import supports
from deploy.view.layers import LAYERS

if TYPE_CHECKING:
    from deploy.view.session import Session

Command = Mapping[str, Any]


def handle(session: Session, command: Command) -> None:
    """Carry out a command; one that is malformed is shown as refused."""
    act = COMMANDS.get(str(command.get("op")))
    try:
        if act is None:
            raise ValueError("there is no such command")
        act(session, command)
    except (LookupError, TypeError, ValueError) as error:
        session.notify(f"{command.get('op')}: {error}", "error")


# --- time ------------------------------------------------------------------------------------------


def _controls(session: Session) -> bool:
    """Whether commands on time go to the run; else they move the viewer's position."""
    return session.player.following and session.source.allows("control")


def _toggle(session: Session, command: Command) -> None:
    del command
    if not _controls(session):
        session.player.toggle()
        return
    paused = session.source.run_state().state == "paused"
    session.ask({"op": "resume" if paused else "pause"})


def _step(session: Session, command: Command) -> None:
    instants = int(command.get("instants", 1))
    if not _controls(session):
        session.player.step(instants)
    elif instants < 0:
        session.player.step(instants)
        session.notify("the page shows an earlier instant; the run stays where it is: press End to return")
    elif session.source.run_state().state == "paused":
        session.ask({"op": "step", "ticks": instants})
    else:
        session.ask({"op": "pause"}, lambda _: session.ask({"op": "step", "ticks": instants}))


def _speed(session: Session, command: Command) -> None:
    factor = command["factor"]
    if factor is not None and not 0 < float(factor) <= 1e6:
        raise ValueError(f"{factor}: must be greater than 0")
    if _controls(session):
        session.ask({"op": "speed", "factor": factor})
    elif factor is not None:
        session.player.speed = float(factor)


def _reverse(session: Session, command: Command) -> None:
    session.player.backwards = bool(command.get("on", not session.player.backwards))


def _reset(session: Session, command: Command) -> None:
    del command
    if _controls(session):
        session.ask({"op": "reset"})
    else:
        session.player.playing = False
        session.player.seek(0)


def _seek(session: Session, command: Command) -> None:
    if "time_s" in command:
        session.player.seek_time(float(command["time_s"]))
    else:
        session.player.seek(int(command["index"]))


def _event(session: Session, command: Command) -> None:
    """Move to the nearest earlier or later instant at which there is an event or a fault."""
    source, at, by = session.source, session.player.index, int(command["by"])
    moments = np.array([record["time_s"] for record in (*source.events, *source.faults)], dtype=np.float64)
    instants = np.searchsorted(source.times_s, moments - 1e-12)
    found = (
        instants[(instants > at) & (instants < len(source.times_s))] if by > 0 else instants[instants < at]
    )
    if not len(found):
        session.notify(f"there is no event {'after' if by > 0 else 'before'} this instant")
        return
    session.player.playing = False
    session.player.seek(int(found.min() if by > 0 else found.max()))


def _follow(session: Session, command: Command) -> None:
    del command
    session.player.follow()


# --- looks -----------------------------------------------------------------------------------------


def _theme(session: Session, command: Command) -> None:
    session.choice.dark = bool(command["dark"])
    session.paint()
    session.replot()


def _colour(session: Session, command: Command) -> None:
    session.colouring.choose(str(command["name"]))


def _layer(session: Session, command: Command) -> None:
    name = str(command["name"])
    if name not in LAYERS:
        raise ValueError(f"{name}: is no layer")
    (session.choice.layers.add if command["on"] else session.choice.layers.discard)(name)


def _tab(session: Session, command: Command) -> None:
    session.choice.tab = str(command["name"])
    if session.choice.tab == "register" and not session.choice.register:
        session.choice.register = next(iter(session.source.register_names()), "")


def _register(session: Session, command: Command) -> None:
    session.choice.register = str(command["name"])
    session.choice.tab = "register"


# --- selection -------------------------------------------------------------------------------------


def _select_cell(session: Session, command: Command) -> None:
    cells = session.source.header["cells"]
    place = [int(command["row"]), int(command["column"])]
    if place not in cells:
        raise ValueError(f"there is no cell {place[0]},{place[1]}")
    session.choice.cell, session.choice.parcel = cells.index(place), None


def _select_parcel(session: Session, command: Command) -> None:
    number = int(command["number"])
    if not 0 <= number < len(session.footprints):
        raise ValueError(f"there is no parcel {number}")
    session.choice.cell, session.choice.parcel = None, number


def _select_none(session: Session, command: Command) -> None:
    del command
    session.choice.cell = session.choice.parcel = None


def _pick(session: Session, command: Command) -> None:
    """Select what is at a place: the cell, or with a second tap there the parcel above it."""
    x, y = float(command["x"]), float(command["y"])
    cell, parcel = session.grid.cell_at(x, y), _parcel_at(session, x, y)
    again = cell is not None and cell == session.choice.cell
    if parcel is not None and (again or cell is None):
        session.choice.cell, session.choice.parcel = None, parcel
    else:
        session.choice.cell, session.choice.parcel = cell, None


def _parcel_at(session: Session, x: float, y: float) -> int | None:
    instant = session.instant()
    if instant is None:
        return None
    point = np.array([[x, y]])
    for parcel, (footprint, state) in enumerate(zip(session.footprints, instant.parcels, strict=True)):
        if len(supports(footprint, state, point)):
            return parcel
    return None


def _walk(session: Session, command: Command) -> None:
    """Select the neighbour of the selected cell; the middle cell if none is selected."""
    cell = session.choice.cell
    if cell is None:
        middle = session.grid.low + session.grid.size / 2
        nearest = int(np.argmin(((session.grid.centres - middle) ** 2).sum(axis=1)))
        session.choice.cell, session.choice.parcel = nearest, None
        return
    other = session.grid.neighbour(cell, int(command["rows"]), int(command["columns"]))
    if other is not None:
        session.choice.cell = other


def _next_parcel(session: Session, command: Command) -> None:
    """Select the next or the previous parcel on the array."""
    instant = session.instant()
    there = [] if instant is None else np.flatnonzero(np.isfinite(instant.parcels).all(axis=1)).tolist()
    if not there:
        session.notify("there is no parcel on the array at this instant")
        return
    by, before = int(command.get("by", 1)), session.choice.parcel
    if before is None:
        number = there[0]
    elif by > 0:
        number = next((parcel for parcel in there if parcel > before), there[0])
    else:
        number = next((parcel for parcel in reversed(there) if parcel < before), there[-1])
    session.choice.cell, session.choice.parcel = None, number


# --- faults ----------------------------------------------------------------------------------------


def _fault(session: Session, command: Command) -> None:
    cell = session.choice.cell
    if cell is None:
        raise ValueError("select a cell first")
    row, column = session.source.header["cells"][cell]
    settings = tomllib.loads("\n".join(str(command.get("settings") or "").split(";")))
    kind = str(command["kind"])
    request = fault_request(kind, row, column, settings, motors=session.motors)
    session.ask(
        request,
        lambda answer: session.notify(
            f"fault {answer['number']}: {kind} at {row},{column} from tick {answer['tick']}"
        ),
    )


def _repair(session: Session, command: Command) -> None:
    number = command.get("number")
    if number is None:
        instant, cell = session.instant(), session.choice.cell
        found = (
            []
            if instant is None or cell is None
            else session.source.fault_state.active_at(instant.time_s, cell)
        )
        if not found:
            raise ValueError("the selected cell has no fault that can be repaired")
        number = found[-1][0]
    session.ask(
        {"op": "repair", "number": int(number)},
        lambda answer: session.notify(f"fault {answer['number']} repaired from tick {answer['tick']}"),
    )


# --- moves -----------------------------------------------------------------------------------------


def _drag(session: Session, command: Command) -> None:
    """Take a parcel at its first place, show where it would be, and ask for the move at the last."""
    x, y, phase = float(command["x"]), float(command["y"]), str(command["phase"])
    instant = session.instant()
    if phase == "begin":
        parcel = _parcel_at(session, x, y)
        if instant is None or parcel is None:
            return
        if not _may_move(session):
            raise ValueError("a parcel can be moved while the run is paused")
        session.choice.cell, session.choice.parcel = None, parcel
        ghost = session.choice.ghost = instant.parcels[parcel].copy()
        session.held = ghost[:2] - np.array([x, y])
    elif session.choice.ghost is not None:
        session.choice.ghost[:2] = session.held + np.array([x, y])
        if phase == "end":
            _move(session, session.choice.ghost)


def _nudge(session: Session, command: Command) -> None:
    """Move the selected parcel by parts of a pitch, and by an angle."""
    instant, parcel = session.instant(), session.choice.parcel
    if instant is None or parcel is None:
        raise ValueError("select a parcel first")
    if not _may_move(session):
        raise ValueError("a parcel can be moved while the run is paused")
    pose = instant.parcels[parcel].copy()
    pose[:2] += np.array([float(command.get("x", 0)), float(command.get("y", 0))]) * session.grid.pitch_m
    pose[2] += float(command.get("angle_rad", 0))
    _move(session, pose)


def _may_move(session: Session) -> bool:
    return (
        _controls(session) and session.source.allows("move") and session.source.run_state().state == "paused"
    )


def _move(session: Session, pose: Any) -> None:
    parcel = session.choice.parcel
    session.choice.ghost = None
    x, y, angle = pose[:3].tolist()
    session.ask(
        {"op": "move", "parcel": parcel, "x_m": x, "y_m": y, "angle_rad": angle},
        lambda _: session.notify(f"parcel {parcel} moved to {x:.4f}, {y:.4f} m, {angle:.4f} rad"),
    )


COMMANDS: Final[Mapping[str, Callable[[Any, Command], None]]] = {
    "toggle": _toggle,
    "step": _step,
    "speed": _speed,
    "reverse": _reverse,
    "reset": _reset,
    "seek": _seek,
    "event": _event,
    "follow": _follow,
    "theme": _theme,
    "colour": _colour,
    "layer": _layer,
    "tab": _tab,
    "register": _register,
    "select_cell": _select_cell,
    "select_parcel": _select_parcel,
    "select_none": _select_none,
    "pick": _pick,
    "walk": _walk,
    "next_parcel": _next_parcel,
    "fault": _fault,
    "repair": _repair,
    "drag": _drag,
    "nudge": _nudge,
}
"""Function of every command, by its ``op``."""
