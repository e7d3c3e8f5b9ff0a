"""Tiles take each parcel to the exit that its label names: junction sorting, on hop gradients and reserved tiles."""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.firmware import Inputs
from cell_firmware.tiles.firmware import TileFirmware, TileParameters


@final
class Route(TileFirmware):
    """Takes every parcel to its own exit along the lanes; see ``TileFirmware``.

    Its label is read where it enters, and goes with it from tile to tile in what these tell each other.
    """

    name = "route"

    @staticmethod
    def kinds(parameters: TileParameters) -> int:
        """Every exit is one of its own."""
        return len(parameters.exits)

    def required_effects(self) -> tuple[str, ...]:
        """Labels have to be read."""
        return ("scanners",)

    def labels(self, inputs: Inputs) -> NDArray[np.int64]:
        """What the cell's label reader says; labels of exits that these parameters do not know are none."""
        if inputs.label is None:
            return np.zeros(len(inputs.presence), dtype=np.int64)
        return np.where(inputs.label <= len(self.parameters.exits), inputs.label, 0)
