"""``mdms control``: pause, step, pace and end a running system."""

from __future__ import annotations

import json
from enum import StrEnum
from typing import Annotated, Any

import typer

from deploy.commands.options import (
    JsonOption,
    OperatorKeysOption,
    RunningAsOption,
    RunningAtOption,
    TimeoutOption,
    target_of,
)
from deploy.errors import InputError


class Action(StrEnum):
    """Actions on a running system."""

    PAUSE = "pause"
    STEP = "step"
    SPEED = "speed"
    RESUME = "resume"
    RESET = "reset"
    STOP = "stop"
    STATUS = "status"


ActionArgument = Annotated[Action, typer.Argument(help="See above.", show_default=False)]
ValueArgument = Annotated[
    str | None,
    typer.Argument(metavar="[VALUE]", help="Ticks of step, by default 1; factor of speed, or max."),
]


def control(
    action: ActionArgument,
    value: ValueArgument = None,
    *,
    connect: RunningAtOption = None,
    run: RunningAsOption = None,
    keys: OperatorKeysOption = None,
    timeout: TimeoutOption = 5.0,
    as_json: JsonOption = False,
) -> None:
    """Pause, step, speed up, reset or stop a running system, by default the newest below runs/.

    A run acts on a request between two ticks, and records it. A paused run waits without a deadline. Pauses, steps
    and the pace change nothing of the result.

    [cyan]pause[/cyan]: pause before the next tick.

    [cyan]step[/cyan] [cyan]N[/cyan]: run N ticks of a paused run, by default 1; returns when it has paused again.

    [cyan]resume[/cyan]: go on.

    [cyan]speed[/cyan] [cyan]X[/cyan]: keep to X simulated seconds per wall second; max: as fast as possible.

    [cyan]reset[/cyan]: end the run, and begin it again from tick 0 in a new folder, with the seed of before.

    [cyan]stop[/cyan]: end the run.

    [cyan]status[/cyan]: print its tick, state and speed.

    Start a run in one terminal, and control it in another:

      [cyan]mdms run elliptic --realtime[/cyan]
      [cyan]mdms control pause[/cyan]
      [cyan]mdms control step 100[/cyan]
      [cyan]mdms control speed 0.2[/cyan]
      [cyan]mdms control resume[/cyan]
    """
    request = {"op": action.value, **_value(action, value)}
    from deploy.control.client import ask_run

    endpoint, name = target_of(connect, run, keys)
    answer = ask_run(endpoint, request, timeout, keys, name)
    print(json.dumps(answer) if as_json else _line(action, answer))


def _value(action: Action, value: str | None) -> dict[str, Any]:
    """Return the request's field for the value on the command line.

    Raises:
        InputError: The action takes no value, needs one, or needs another.
    """
    if action is Action.STEP:
        if value is None:
            return {"ticks": 1}
        if value.isascii() and value.isdigit() and 0 < int(value) <= 1_000_000_000:
            return {"ticks": int(value)}
        raise InputError(f"control step {value}: must be a number of ticks from 1 to 1000000000")
    if action is Action.SPEED:
        if value == "max":
            return {"factor": None}
        try:
            factor = float(value or "")
        except ValueError:
            factor = 0.0
        if 0 < factor < float("inf"):
            return {"factor": factor}
        raise InputError(
            f"control speed{'' if value is None else f' {value}'}: must be a factor greater than 0, or max"
        )
    if value is not None:
        raise InputError(f"control {action.value}: takes no value")
    return {}


def _line(action: Action, answer: dict[str, Any]) -> str:
    """Describe the answer in a line."""
    at = f"before tick {answer['tick']:,} ({answer['time_s']:g} s)"
    if action in (Action.RESET, Action.STOP):
        done = "ends" if action is Action.STOP else "ends and begins again in a new folder"
        return f"{answer['run']}: {done}, {at}"
    if answer["state"] == "waiting":
        at = f"for {answer['waits_for']}{', begins paused' if answer['paused'] else ''}"
    pace = "as fast as possible" if answer["speed"] is None else f"{answer['speed']:g} × real time"
    measured = (
        "" if answer["state"] in ("paused", "waiting") else f", measured {answer['real_time_factor']:.3g}"
    )
    return f"{answer['run']}: {answer['state']} {at}, {pace}{measured}"
