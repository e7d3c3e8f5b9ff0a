"""What every cell's program has, in whichever form it is written: parameters, a message type, a check."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np
from numpy.typing import NDArray

from bus.lattice import Lattice
from cell_firmware.specs import Spec


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


class NoParameters(Spec):
    """Of a program that takes none."""


class Program:
    """Base of ``Firmware`` and ``CellFirmware``, which add how the program is stepped.

    Args:
        parameters: An instance of ``Parameters``.
    """

    Parameters: ClassVar[type[Spec]] = NoParameters
    """What a scene may set in ``[cells.parameters]``."""
    message: ClassVar[np.dtype[Any] | None] = None
    """Little-endian structured type of a message between neighbours; None if they don't talk."""
    observable: ClassVar[str | None] = None
    """Which of its variables is the protocol's field: a name in its state, a number or a vector a cell."""

    def __init__(self, parameters: Any) -> None:
        self.parameters = parameters

    def check(self, lattice: Lattice) -> None:
        """Refuses parameters that do not fit the array, before anything starts.

        Raises:
            ParametersError: They do not.
        """
        del lattice

    def check_geometry(self, lattice: Lattice, position_m: NDArray[np.float64], pitch_m: float) -> None:
        """The same for parameters that do not fit where the cells are.

        Args:
            lattice: The cells.
            position_m: ``(n, 2)``, centre of each, m.
            pitch_m: Distance of neighbouring cells, m.

        Raises:
            ParametersError: They do not.
        """
        del lattice, position_m, pitch_m

    def required_effects(self) -> tuple[str, ...]:
        """Effects without which its parameters ask for what no cell of the scene has."""
        return ()

    def uses_camera(self) -> bool:
        """Whether cells with these parameters want to be shown a camera's pictures, where the scene has one."""
        return False

    def value_ranges(self) -> Mapping[str, tuple[float, float]]:
        """By field of its messages, the least and the greatest that a cell of this program ever tells with sound links.

        A field that is not named may have any.
        """
        return {}

    def accepts(self, messages: NDArray[Any]) -> NDArray[np.bool_]:
        """Which messages, of any shape, a cell of this program could have told: floats are numbers, all is plausible.

        It is asked where faults may damage messages; what is not credible is not handed over.
        """
        plausible, good = self.value_ranges(), np.ones(messages.shape, dtype=np.bool_)
        for name in messages.dtype.names or ():
            value = messages[name]
            if name in plausible:
                low, high = plausible[name]
                good &= (value >= low) & (value <= high)
            elif value.dtype.kind == "f":
                good &= np.isfinite(value)
        return good

    def warnings(self, lattice: Lattice) -> tuple[str, ...]:
        """What will go wrong on this array, though nothing forbids it: a line each, that says what will be seen."""
        del lattice
        return ()

    def theory(self, lattice: Lattice) -> Theory | None:
        """What theory says of it on this array; None if it has nothing to say."""
        del lattice
        return None
