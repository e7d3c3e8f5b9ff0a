"""The step in progress: which cell's program runs in which tick, for output and debuggers."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final, final

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@final
class Stepping:
    """The step in progress in this process.

    Attributes:
        tick: Tick of the step.
        row: Rows of the stepped cells, ``(n,)``; None while no program is stepped.
        column: Columns of the stepped cells, ``(n,)``.
        index: Which of the cells is stepped; -1: all at once.
        observe: Called before a program's step with tick, rows and columns of the cells, program, state, and inputs;
            None: nobody looks.
    """

    __slots__ = ("column", "index", "observe", "row", "tick")

    def __init__(self) -> None:
        self.tick = -1
        self.row: NDArray[np.int64] | None = None
        self.column: NDArray[np.int64] | None = None
        self.index = -1
        self.observe: Callable[..., Any] | None = None

    def place(self) -> str | None:
        """Return cell and tick in words; None while no program is stepped."""
        row, column = self.row, self.column
        if row is None or column is None:
            return None
        index = 0 if len(row) == 1 else self.index
        cells = f"{len(row)} cells" if index < 0 else f"cell {row[index]},{column[index]}"
        return f"{cells}, tick {self.tick}"


NOW: Final = Stepping()
"""The step in progress."""
