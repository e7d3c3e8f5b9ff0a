"""``mdms registers``: registers of a running system's cells."""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING, Annotated, Any

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
from deploy.util.formatting import plural, short_number

if TYPE_CHECKING:
    from deploy.control.registers import Cell, RegisterReadings

_CELL = re.compile(r"(\d{1,9}),(\d{1,9})")
_SIDE_BY_SIDE = 6
"""Cells that have a column each."""

CellsArgument = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[ROW,COLUMN]...",
        help="Cells to show. Default: least, mean and greatest values over all cells.",
    ),
]


def registers(
    cells: CellsArgument = None,
    *,
    connect: RunningAtOption = None,
    run: RunningAsOption = None,
    keys: OperatorKeysOption = None,
    timeout: TimeoutOption = 5.0,
    as_json: JsonOption = False,
) -> None:
    """Read registers of a running system's cells: variables of the program, registers and counters of the board.

    Reading does not change the run. To record registers, start the run with mdms run --registers.

    Start a run in one terminal, and read registers in another:

      [cyan]mdms run prototype --duration 60 --realtime[/cyan]
      [cyan]mdms registers 0,0 1,2[/cyan]
    """
    wanted = [_cell(text) for text in cells or ()]
    from deploy.control.registers import read_registers

    endpoint, name = target_of(connect, run, keys)
    seen = read_registers(endpoint, wanted, timeout, keys, name)
    if wanted:
        seen.cells = {cell: seen.cells[cell] for cell in wanted}
    if as_json:
        shown = {f"{row},{column}": values for (row, column), values in sorted(seen.cells.items())}
        print(json.dumps({"run": seen.run, "tick": seen.tick, "cells": shown}))
    else:
        _print(seen)


def _cell(text: str) -> Cell:
    match = _CELL.fullmatch(text)
    if match is None:
        raise InputError(f"{text}: must be a cell's row and column, such as 1,2")
    return int(match[1]), int(match[2])


def _print(seen: RegisterReadings) -> None:
    """A column a cell; of many cells the least, mean and greatest."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from deploy.control.registers import ranges

    console = Console(highlight=False)
    console.print(f"[bold]{seen.run}[/bold]  tick {seen.tick:,}, {plural(len(seen.cells), 'cell')}")
    table = Table(box=None, pad_edge=False, padding=(0, 2))
    table.add_column("register")
    if len(seen.cells) <= _SIDE_BY_SIDE:
        columns = sorted(seen.cells)
        for row, column in columns:
            table.add_column(f"{row},{column}", justify="right")
        for name in seen.cells[columns[0]]:
            table.add_row(Text(name), *(_text(seen.cells[cell].get(name)) for cell in columns))
    else:
        for word in ("least", "mean", "greatest"):
            table.add_column(word, justify="right")
        for name, values in ranges(seen.cells).items():
            table.add_row(Text(name), *(short_number(value) for value in values))
    console.print(table)


def _text(value: Any) -> str:
    if isinstance(value, list):
        return " ".join(_text(part) for part in value)  # pyright: ignore[reportUnknownVariableType]
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "" if value is None else short_number(value)
