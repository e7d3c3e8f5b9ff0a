"""The roll of a run: whose tokens are there, and who is missing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np
from numpy.typing import NDArray

from bus.errors import BarrierError
from bus.forms.form import HostForm
from bus.lattice import Lattice
from bus.transport import Alive

_NAMED = 12
"""Cells that a message names before it only counts them."""


@final
class Roll:
    """Keeps the tokens of every unit of a form.

    Attributes:
        alive: Units whose token stands.
        ready: Units that said they were ready, and are.
        left: Units whose token stood and went.
        gone: Of these, the ones that nobody has dealt with yet.
    """

    def __init__(self, form: HostForm, lattice: Lattice) -> None:
        self._form = form
        self._lattice = lattice
        self.alive: set[int] = set()
        self.ready: set[int] = set()
        self.left: set[int] = set()
        self.gone: set[int] = set()

    def complete(self) -> bool:
        """Whether every unit is ready."""
        return len(self.ready) == len(self._form.unit_cells)

    def absent(self, shard_of: NDArray[np.int64]) -> set[int]:
        """Shards with a unit whose token has never stood; ``shard_of``: ``(n,)``, the shard of every cell."""
        seen = self.alive | self.left
        units = enumerate(self._form.unit_cells)
        return {int(shard_of[int(i)]) for unit, cells in units if unit not in seen for i in cells}

    def take(self, event: Alive) -> None:
        """Takes note of a token that came or went; other tokens than the form's are none of ours."""
        if (unit := self._form.alive_units.get(event.key)) is not None:
            if event.present:
                self.alive.add(unit)
                self.gone.discard(unit)
            else:
                self.alive.discard(unit)
                self.left.add(unit)
                self.gone.add(unit)
        elif (unit := self._form.ready_units.get(event.key)) is not None:
            (self.ready.add if event.present else self.ready.discard)(unit)

    def missing(self, waited_s: float, unheard: Sequence[int]) -> BarrierError:
        """The error that names who is missing; ``unheard``: units to which nothing can be sent yet."""
        units = range(len(self._form.unit_cells))
        never = [u for u in units if u not in self.alive and u not in self.left]
        left = [u for u in units if u not in self.alive and u in self.left]
        unready = [u for u in units if u in self.alive and u not in self.ready]
        deaf: Sequence[int] = () if never or left or unready else unheard
        parts = [
            f"{verb}: {self._names(who)}"
            for verb, who in (
                ("never appeared", never),
                ("appeared and left again", left),
                ("appeared but not ready", unready),
                ("ready but can't be sent to", deaf),
            )
            if who
        ]
        return BarrierError(
            f"not every cell is ready after {waited_s:g} s; {'; '.join(parts)}",
            absent=self._cells(never + left),
            unready=self._cells([*unready, *deaf]),
        )

    def _cells(self, units: Sequence[int]) -> list[tuple[int, int]]:
        return [self._lattice.cells[int(i)] for unit in units for i in self._form.unit_cells[unit]]

    def _names(self, units: Sequence[int]) -> str:
        cells = self._cells(units)
        named = " ".join(f"{row},{column}" for row, column in cells[:_NAMED])
        more = f" and {len(cells) - _NAMED} more" if len(cells) > _NAMED else ""
        return f"{len(cells)} cell{'s' if len(cells) > 1 else ''} ({named}{more})"
