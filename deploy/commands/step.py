"""``mdms step``: a recorded step of a cell's program again, in the debugger."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import Annotated

import typer

from deploy.errors import InputError


def step(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="A recording, or its output folder.")
    ],
    *,
    cell: Annotated[str, typer.Option("--cell", metavar="ROW,COLUMN", help="The cell.")],
    tick: Annotated[int, typer.Option("--tick", min=0, help="The tick.")],
    debugger: Annotated[
        bool, typer.Option("--debugger/--no-debugger", help="Step under pdb, or print the step alone.")
    ] = True,
) -> None:
    """Step a cell's program again in a tick of a recorded run, under Python's debugger pdb.

    The run is repeated in this process up to that tick, with the recorded scene, and all drives are compared with the
    recorded ones: state and inputs are exactly those of the recorded step. pdb stops at the first line of step.
    Afterwards state, inputs and results are printed. A program on arrays is stepped with the cell's row alone.

    Exit status: 0, also if the program raises; 2 if the run can't be repeated: the program has changed, live commands
    came while it ran, or the cell has no step in that tick.

      [cyan]mdms step runs/NAME --cell 3,4 --tick 512[/cyan]
      [cyan]mdms step runs/NAME --cell 3,4 --tick 512 --no-debugger[/cyan]
    """
    from deploy.recordings.reader import load
    from deploy.runs.step_again import held_step
    from deploy.workers.cell_output import naming_cells

    row, comma, column = cell.partition(",")
    if not (comma and row.strip().lstrip("-").isdecimal() and column.strip().lstrip("-").isdecimal()):
        raise InputError(f"--cell {cell}: must be ROW,COLUMN, as 3,4")
    with contextlib.redirect_stdout(sys.stderr), naming_cells():  # what programs print until then
        held = held_step(load(recording), (int(row), int(column)), tick)
    print(f"cell {cell}, tick {tick}")
    print(f"state:   {held.state!r}")
    print(f"inputs:  {held.inputs!r}")
    try:
        if debugger:
            import pdb  # noqa: T100 - a debugger is asked for

            result = pdb.runcall(held.step, held.state, held.inputs)
        else:
            result = held.step(held.state, held.inputs)
    except Exception:  # noqa: BLE001 - whatever a program raises is what was looked for
        import traceback

        print(traceback.format_exc().rstrip())
        return
    print(f"result:  {result!r}")
