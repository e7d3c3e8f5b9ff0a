"""Tiles take parcels to the nearest exit, reserved before they carry: parcels never meet, nor wait in a ring."""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.firmware import Inputs
from cell_firmware.tiles.firmware import TileFirmware, TileParameters


@final
class ReservePath(TileFirmware):
    """Routing of every parcel to the nearest exit along the lanes; see ``TileFirmware``."""

    name = "reserve_path"

    @staticmethod
    def kinds(parameters: TileParameters) -> int:
        """One: all exits are alike."""
        del parameters
        return 1

    def labels(self, inputs: Inputs) -> NDArray[np.int64]:
        """Every parcel is for any exit."""
        return np.ones(len(inputs.presence), dtype=np.int64)
