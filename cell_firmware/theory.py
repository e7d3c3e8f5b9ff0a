"""What theory says of a protocol on an array, to hold a run against."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

from numpy.typing import NDArray


@final
@dataclass(frozen=True, slots=True)
class Theory:
    """A prediction for links that neither lose nor delay, and cells that all live and step at once.

    Attributes:
        law: What it says, in a line, with its source.
        factor: By which the slowest error shrinks from tick to tick: below 1 it dies out, at 1 it stays, above 1 it
            grows. None for a protocol that is done after a number of ticks instead, or that has no such law.
        ticks: After how many ticks it is done, at most; None where it comes ever closer instead.
        limit: Where it goes: what ``Program.observed`` is then, with a row a cell, in the lattice's order; None where
            theory does not say.
    """

    law: str
    factor: float | None = None
    ticks: int | None = None
    limit: NDArray[Any] | None = None
