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

    A parcel's label is read where the parcel enters, and is passed from tile to tile in messages.
    """

    name = "route"

    @staticmethod
    def kinds(parameters: TileParameters) -> int:
        """Return the number of exits: parcels distinguish each of them."""
        return len(parameters.exits)

    def required_effects(self) -> tuple[str, ...]:
        """Require scanners, which read the labels."""
        return ("scanners",)

    def labels(self, inputs: Inputs) -> NDArray[np.int64]:
        """Return the readings of label readers, ``(n,)``; 0 for labels without an exit in the parameters."""
        if inputs.label is None:
            return np.zeros(len(inputs.presence), dtype=np.int64)
        return np.where(inputs.label <= len(self.parameters.exits), inputs.label, 0)
