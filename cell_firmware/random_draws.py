"""Random numbers of cells' programs, from the scene's seed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, TypeVar, final

import numpy as np
from numpy.typing import NDArray

from bus.random_streams import stream_key

_Number = TypeVar("_Number")


@final
class Draws(dict[str, _Number]):
    """Random numbers by name; a name that the program doesn't declare is a KeyError that says so."""

    def __missing__(self, name: object) -> _Number:
        known = f"; it declares {', '.join(self)}" if self else ""
        raise KeyError(
            f"{name!r} is not among the program's random numbers{known}: add it to the class's `random`"
        )


NO_DRAWS: Final[Mapping[str, Any]] = Draws[Any]()
"""Random numbers of a program that declares none."""


def no_draws() -> Mapping[str, Any]:
    """Return the random numbers of a program that declares none."""
    return NO_DRAWS


@final
class CellStreams:
    """Random streams of a program: a number for each name, cell and tick, whoever draws it, and however often.

    A number depends on seed, name, row and column of the cell, and tick. It doesn't depend on other cells, names and
    ticks, on the array, or on the process that draws it.

    Args:
        names: Of the streams.
        seed: Seed of the scene, >= 0.

    Attributes:
        names: Of the streams.
        keys: ``(k, 2)`` uint64, a key for each, words of 32 bits.
    """

    def __init__(self, names: Sequence[str], seed: int) -> None:
        self.names = tuple(names)
        self.keys = np.array([stream_key(seed, f"firmware {name}") for name in names], dtype=np.uint64)
        self.keys.setflags(write=False)

    def of_tick(
        self, tick: int, row: NDArray[np.int64], column: NDArray[np.int64]
    ) -> Draws[NDArray[np.float64]]:
        """Return the numbers of cells for a tick's step.

        Args:
            tick: The tick.
            row: ``(n,)``, row of each cell.
            column: ``(n,)``, column of each cell.

        Returns:
            By name, ``(n,)``, each in [0, 1) and a multiple of 2⁻⁵³.
        """
        return self._draw(tick + 1, row, column)

    def at_start(self, row: NDArray[np.int64], column: NDArray[np.int64]) -> Draws[NDArray[np.float64]]:
        """Return the numbers of cells for their program's ``init``, as ``of_tick``: always the same."""
        return self._draw(0, row, column)

    def _draw(
        self, count: int, row: NDArray[np.int64], column: NDArray[np.int64]
    ) -> Draws[NDArray[np.float64]]:
        from cell_firmware.kernels.arguments import readable
        from cell_firmware.kernels.draws import draw

        numbers = np.empty((len(self.names), len(row)))
        draw(self.keys, count, readable(row), readable(column), numbers)
        numbers.setflags(write=False)
        return Draws(zip(self.names, numbers, strict=True))
