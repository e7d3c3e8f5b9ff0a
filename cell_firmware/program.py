"""What every cell's program has, in whichever form it is written: parameters, a message type, a check."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from bus.lattice import Lattice
from cell_firmware.specs import Spec


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

    def __init__(self, parameters: Any) -> None:
        self.parameters = parameters

    def check(self, lattice: Lattice) -> None:
        """Refuses parameters that do not fit the array, before anything starts.

        Raises:
            ParametersError: They do not.
        """
        del lattice
