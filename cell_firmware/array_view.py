"""Registers of all running cells after a tick, and conditions on them that are broken."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, final

import numpy as np
from numpy.typing import NDArray

from bus.lattice import Lattice
from cell_firmware.errors import FirmwareError

PROGRAM: Final = "firmware."
"""Prefix of the registers that are variables of the program."""
_NAMED: Final = 4
"""Most cells that a message names."""


@final
class ArrayView:
    """Registers of all running cells after a tick, for ``Program.invariants`` and ``Program.eventually``.

    Cells that are dead, lost, removed or halted in the tick have no row.

    Args:
        tick: The tick that the cells have computed.
        lattice: All cells of the array.
        running: ``(n,)``, whether each cell's program ran.
        registers: By name, arrays with a row for each cell of the lattice; a program's variables begin ``firmware.``.
        link_ticks: Ticks after which messages are read.

    Attributes:
        tick: As given.
        link_ticks: As given. The ticks that ``Program.eventually`` yields are multiplied by it.
        cells: ``(row, column)`` of each of the ``a`` running cells, in the lattice's order.
        neighbours: ``(a, 4)`` int64, row of the running neighbour on each side of ``SIDES``, or -1.
    """

    def __init__(
        self,
        tick: int,
        lattice: Lattice,
        running: NDArray[np.bool_],
        registers: Mapping[str, NDArray[Any]],
        link_ticks: int = 1,
    ) -> None:
        self.tick = tick
        self.link_ticks = link_ticks
        self._registers = registers
        self._read: dict[str, NDArray[Any]] = {}
        if running.all():
            self._rows: NDArray[np.int64] | None = None
            self.cells = lattice.cells
            self.neighbours: NDArray[np.int64] = lattice.neighbours
            return
        rows = self._rows = np.flatnonzero(running)
        self.cells = tuple(lattice.cells[row] for row in rows.tolist())
        place = np.full(len(lattice) + 1, -1, dtype=np.int64)  # the last one stands for no neighbour
        place[rows] = np.arange(len(rows))
        self.neighbours = place[lattice.neighbours[rows]]

    def __len__(self) -> int:
        return len(self.cells)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return a variable of the program, or another register by its full name, with a row a running cell.

        Raises:
            FirmwareError: There is no such register.
        """
        found = self._read.get(name)
        if found is None:
            array = self._registers.get(PROGRAM + name)
            array = self._registers.get(name) if array is None else array
            if array is None:
                raise FirmwareError(
                    f"view[{name!r}]: the cells have no such register; they have {', '.join(self.names)}"
                )
            found = self._read[name] = array if self._rows is None else array[self._rows]
        return found

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all registers, those of the program without their prefix."""
        return tuple(sorted(name.removeprefix(PROGRAM) for name in self._registers))

    @property
    def links(self) -> NDArray[np.int64]:
        """Pairs of running neighbours, ``(l, 2)`` rows, each pair once: the southern or western cell first."""
        rows, sides = np.nonzero(self.neighbours[:, :2] >= 0)
        return np.stack((rows, self.neighbours[rows, sides]), axis=1)

    def index(self, cell: tuple[int, int]) -> int:
        """Return the row of a cell.

        Raises:
            FirmwareError: The cell isn't running, or doesn't exist.
        """
        try:
            return self.cells.index(cell)
        except ValueError:
            raise FirmwareError(
                f"cell {cell[0]},{cell[1]}: isn't among the running cells of this view"
            ) from None

    def forget_reads(self) -> None:
        """Forget which registers were read, before the next condition is evaluated."""
        self._read = {}

    def values(self, row: int | None) -> dict[str, Any]:
        """Return the registers read since ``forget_reads``: of one cell, or of all cells for None."""
        return {
            name: array.tolist() if row is None else array[row].tolist() for name, array in self._read.items()
        }


@final
@dataclass(frozen=True, slots=True)
class Violation:
    """A condition that does not hold.

    Attributes:
        kind: ``always`` for ``Program.invariants``, ``eventually`` for ``Program.eventually``.
        rule: The condition in words, as the program has it.
        tick: The tick after which the condition was evaluated.
        cells: ``(row, column)`` of the cells that break it; empty where the condition concerns all cells together.
        values: By name, the registers that the condition read: a value for each of ``cells``, or for every cell.
    """

    kind: Literal["always", "eventually"]
    rule: str
    tick: int
    cells: tuple[tuple[int, int], ...] = ()
    values: Mapping[str, tuple[Any, ...]] | None = None

    def __str__(self) -> str:
        broken = "is broken" if self.kind == "always" else "hasn't come true in time"
        line = f"tick {self.tick}: {self.rule!r} {broken}"
        if not self.cells:
            return line
        shown = [
            f"{row},{column}"
            + "".join(f" {name}={values[i]}" for name, values in (self.values or {}).items())
            for i, (row, column) in enumerate(self.cells[:_NAMED])
        ]
        more = len(self.cells) - len(shown)
        return f"{line} at {'; '.join(shown)}" + (f"; and {more} cells more" if more else "")

    def as_json(self) -> dict[str, Any]:
        """Return the violation in JSON's types."""
        return {
            "kind": self.kind,
            "rule": self.rule,
            "tick": self.tick,
            "cells": [list(cell) for cell in self.cells],
            "values": {name: list(values) for name, values in (self.values or {}).items()},
        }
