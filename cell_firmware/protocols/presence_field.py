"""A velocity field that is active only under a parcel and a little around it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, final

import numpy as np
from pydantic import Field

from bus.lattice import Lattice
from cell_firmware.fields import FieldSpec
from cell_firmware.firmware import Cells, Floats, State
from cell_firmware.scalar import ScalarFirmware
from cell_firmware.specs import Spec
from cell_firmware.toolkit.hold import Ttl


class PresenceFieldParameters(Spec):
    """The field, and its reach around a parcel."""

    field: FieldSpec
    reach: Annotated[int, Field(ge=0, le=100)] = 1
    """Largest distance, in cells along rows and columns, of a running cell from a cell that senses a parcel."""
    ttl_periods: Ttl = 1
    """Validity of a neighbour's message, periods: more than 1 where messages may be late."""


@final
class PresenceField(ScalarFirmware):
    """Velocity field where a parcel is sensed, and up to ``reach`` cells around.

    A cell's level is ``reach + 1`` where the cell senses a parcel, else one less than the highest valid level received,
    at least 0. The cell sends its level, and drives the field's velocity while the level is above 0.
    """

    Parameters = PresenceFieldParameters
    message = np.dtype([("level", "u1")])
    kernels = "cell_firmware.kernels.programs.presence_field"

    def check_geometry(self, lattice: Lattice, position_m: Floats, pitch_m: float) -> None:
        """The field must be a number at every cell."""
        del pitch_m
        self.parameters.field.check_places("presence_field", lattice, position_m)

    def init(self, cells: Cells) -> State:
        """Return the initial state: each cell's speed while awake, ``(n, 2)`` m/s, and no messages."""
        x, y = cells.position_m[:, 0], cells.position_m[:, 1]
        sides = cells.has_neighbour.shape
        return {
            "speed_m_s": self.parameters.field.velocity(x, y),
            "neighbour": np.zeros(sides, dtype=np.uint8),
            "counts": np.zeros(sides, dtype=np.int16),
        }

    def constants(self) -> Mapping[str, int]:
        """Reach, and validity of messages."""
        return {"reach": self.parameters.reach, "ttl_periods": self.parameters.ttl_periods}
