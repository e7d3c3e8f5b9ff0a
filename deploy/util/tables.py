"""Tables on a terminal: of a table that is too wide the least important columns are left out."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, final

_GAP = 2
"""Blanks between two columns."""


@final
@dataclass(frozen=True, slots=True)
class Column:
    """Column of a table.

    Attributes:
        heading: Heading of the column.
        cells: Text of each row.
        rank: Order in which columns are left out, the highest first; columns of rank 0 stay.
        justify: Side to which the text is set.
        style: rich's style of the text.
    """

    heading: str
    cells: Sequence[str]
    rank: int = 0
    justify: Literal["left", "right"] = "right"
    style: str = ""

    @property
    def width(self) -> int:
        """Characters of the longest text."""
        return max(map(len, (self.heading, *self.cells)))


def print_columns(columns: Sequence[Column]) -> list[str]:
    """Print a table on stdout with as many columns as fit the terminal; a file or a pipe gets all columns.

    Args:
        columns: From left to right, with the same number of cells. Columns of rank 0 are printed in full, however
            narrow the terminal is.

    Returns:
        Headings of the columns that were left out.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(highlight=False)
    shown = list(columns)
    if console.is_terminal or "COLUMNS" in os.environ:
        while _width(shown) > console.width and (last := max(column.rank for column in shown)):
            shown = [column for column in shown if column.rank < last]
    if console.width < _width(shown):  # a line too long is better than a number cut off
        console = Console(highlight=False, width=_width(shown))
    table = Table(box=None, pad_edge=False, padding=(0, _GAP, 0, 0))
    for column in shown:
        table.add_column(column.heading, justify=column.justify, style=column.style, no_wrap=True)
    for row in zip(*(column.cells for column in shown), strict=True):
        table.add_row(*map(Text, row))
    console.print(table)
    return [column.heading for column in columns if column not in shown]


def _width(columns: Sequence[Column]) -> int:
    return sum(column.width for column in columns) + _GAP * (len(columns) - 1)
