"""``mdms fault``: inject a fault into a running system."""

from __future__ import annotations

import json
import re
from inspect import cleandoc
from typing import Annotated, Any

import typer

from deploy.commands.completion import fault_kinds
from deploy.commands.options import (
    JsonOption,
    OperatorKeysOption,
    RunningAsOption,
    RunningAtOption,
    TimeoutOption,
    target_of,
)
from deploy.errors import InputError
from deploy.scenes.overrides import Override, apply
from deploy.util.formatting import plural

_CELL = re.compile(r"(\d{1,9}),(\d{1,9})")
_RECTANGLE = re.compile(r"(\d{1,9}),(\d{1,9})-(\d{1,9}),(\d{1,9})")
_SHARE = re.compile(r"(\d+(?:\.\d+)?)%")

KindArgument = Annotated[
    str,
    typer.Argument(
        metavar="KIND",
        autocompletion=fault_kinds,
        help="A kind of fault, listed above; or list: show the run's faults; or repair: repair faults by number.",
    ),
]
TargetArgument = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[TARGET]...",
        help="Cells as ROW,COLUMN; a rectangle of cells as ROW,COLUMN-ROW,COLUMN; or a share of all cells, as 10%.",
    ),
]
SideOption = Annotated[
    str | None,
    typer.Option("--side", help="Side of the affected links: north, east, south or west. Default: all."),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Any other key of the fault, in TOML. Repeatable."),
]
ForOption = Annotated[
    float | None,
    typer.Option("--for", metavar="SECONDS", help="Simulated time until the repair. Default: no repair."),
]


def fault(
    kind: KindArgument,
    target: TargetArgument = None,
    *,
    side: SideOption = None,
    sets: SetOption = None,
    for_s: ForOption = None,
    connect: RunningAtOption = None,
    run: RunningAsOption = None,
    keys: OperatorKeysOption = None,
    timeout: TimeoutOption = 5.0,
    as_json: JsonOption = False,
) -> None:
    """Inject a fault into a running system, or repair one.

    The fault is active from the next tick on, whose number is printed. The run's recording contains the fault, so
    that mdms run --replay repeats the run to the same digest.

    Start a run in one terminal, and inject faults in another:

      [cyan]mdms run heat --duration 60 --realtime[/cyan]
      [cyan]mdms fault crash 3,4 --for 2[/cyan]
      [cyan]mdms fault crash 0,0-2,2[/cyan]
      [cyan]mdms fault list[/cyan]
      [cyan]mdms fault repair 1[/cyan]

    Kinds of faults (keys: docs/faults.md):

    {kinds}
    """
    requests = _requests(kind, target or [], side, sets or [], for_s)
    endpoint, name = target_of(connect, run, keys)
    from deploy.control.client import ask_run

    for request in requests:
        answer = ask_run(endpoint, request, timeout, keys, name)
        if as_json:
            print(json.dumps(answer))
        else:
            _print(request, answer)


def _kinds() -> str:
    """Return a line for each kind of fault, as help shows it."""
    from deploy.faults.registry import KINDS, gist

    width = max(map(len, KINDS))
    return "\n".join(f"  [cyan]{name:<{width}}[/cyan]  {gist(name)}" for name in KINDS)


# Python 3.13 takes the indentation off docstrings, earlier versions don't
fault.__doc__ = cleandoc(fault.__doc__ or "").replace("{kinds}", _kinds())


def _requests(
    kind: str, target: list[str], side: str | None, sets: list[str], for_s: float | None
) -> list[dict[str, Any]]:
    if kind in ("list", "repair"):
        if side is not None or sets or for_s is not None:
            raise InputError(f"fault {kind}: takes no --side, --set or --for")
        if kind == "list" and target:
            raise InputError("fault list: takes no target")
        if kind == "list":
            return [{"op": "list"}]
        if not target or not all(text.isascii() and text.isdigit() for text in target):
            raise InputError("fault repair: must be followed by numbers of faults; see mdms fault list")
        return [{"op": "repair", "number": int(text)} for text in target]
    fault: dict[str, Any] = {"kind": kind, **_target(target)}
    if side is not None:
        fault["side"] = side
    apply(fault, [Override.parse(text) for text in sets])
    return [{"op": "inject", "fault": fault, "for_s": for_s}]


def _target(texts: list[str]) -> dict[str, Any]:
    """Parse a fault's target into scene keys; empty for a fault whose target is given otherwise."""
    if not texts:
        return {}
    if all(_CELL.fullmatch(text) for text in texts):
        cells = [[int(part) for part in text.split(",")] for text in texts]
        return {"cell": cells[0]} if len(cells) == 1 else {"cells": cells}
    if len(texts) == 1 and (match := _RECTANGLE.fullmatch(texts[0])):
        r0, c0, r1, c1 = map(int, match.groups())
        return {"rectangle": [[r0, c0], [r1, c1]]}
    if len(texts) == 1 and (match := _SHARE.fullmatch(texts[0])):
        return {"share": float(match[1]) / 100.0}
    raise InputError(
        f"{' '.join(texts)}: must be cells such as 3,4, or one rectangle such as 0,0-2,2, or one share such as 10%"
    )


def _print(request: dict[str, Any], answer: dict[str, Any]) -> None:
    when = f"from tick {answer['tick']:,} ({answer['time_s']:g} s)"
    if request["op"] == "inject":
        named = ", ".join(f"{row},{column}" for row, column in answer["cells"][:6])
        more = ", ..." if answer["affected"] > 6 else ""
        what = f"{request['fault']['kind']} of {plural(answer['affected'], 'cell')} ({named}{more})"
        print(f"{answer['run']}: fault {answer['number']}, {what}, {when}")
    elif request["op"] == "repair":
        print(f"{answer['run']}: fault {answer['number']} repaired, {when}")
    elif not answer["faults"]:
        print(f"{answer['run']}: no faults")
    for one in answer.get("faults", ()):
        end = "on" if one["until_tick"] is None else f"until tick {one['until_tick']:,}"
        print(
            f"{one['number']:>4}  {one['kind']} of {plural(one['affected'], 'cell')}  "
            f"from tick {one['from_tick']:,} {end}  {one['state']}"
        )
