"""The program that a thread is running, found from the thread's stack."""

from __future__ import annotations

import traceback
from dataclasses import dataclass
from types import FrameType
from typing import Any, Final, final

from cell_firmware.board import Board
from cell_firmware.cell import PerCellAdapter
from cell_firmware.firmware import Cells


@final
@dataclass(frozen=True, slots=True)
class UnderWay:
    """A call of the cells' program that has not returned.

    Attributes:
        cell: ``(row, column)`` of the cell, of the first cell where the program runs for several at once.
        cells: How many cells the call is for.
        trace: The stack from the board inwards, as a traceback.
    """

    cell: tuple[int, int]
    cells: int
    trace: str

    def same(self, other: UnderWay | None) -> bool:
        """Whether the other call is for the same cells."""
        return other is not None and (self.cell, self.cells) == (other.cell, other.cells)


_DEBUGGERS: Final = frozenset(("bdb", "debugpy", "ipdb", "pdb", "pudb", "pydevd", "_pydevd_bundle", "rpdb"))
"""Packages of debuggers that hold a thread in Python code of their own."""


def in_debugger(frame: FrameType | None) -> bool:
    """Whether a debugger holds a thread.

    Args:
        frame: The innermost frame of the thread.
    """
    while frame is not None:
        if str(frame.f_globals.get("__name__", "")).partition(".")[0] in _DEBUGGERS:
            return True
        frame = frame.f_back
    return False


def under_way(frame: FrameType | None) -> UnderWay | None:
    """The program that a thread is in; None if the thread is in no program.

    Args:
        frame: The innermost frame of the thread.
    """
    innermost, depth = frame, 0
    row: int | None = None
    while frame is not None:
        depth += 1
        # a copy: the thread continues while its variables are read
        variables: dict[str, Any] = dict(frame.f_locals)
        owner = variables.get("self")
        if isinstance(owner, PerCellAdapter) and isinstance(variables.get("i"), int):
            row = variables["i"]
        cells = variables.get("cells")
        if isinstance(owner, Board) and isinstance(cells, Cells):
            trace = "".join(traceback.format_stack(innermost, depth))
            return UnderWay(cells.name(row or 0), 1 if row is not None else len(cells), trace)
        frame = frame.f_back
    return None
