"""A velocity field that is active only under a parcel and a little around it."""

from __future__ import annotations

from typing import Annotated, final

import numpy as np
from pydantic import Field

from bus.lattice import Lattice
from cell_firmware.fields import FieldSpec
from cell_firmware.firmware import Cells, Firmware, Floats, Inputs, Outbox, Outputs, State
from cell_firmware.specs import Spec
from cell_firmware.toolkit.hold import Ttl, age_ttl, hold_last


class PresenceFieldParameters(Spec):
    """The field, and its reach around a parcel."""

    field: FieldSpec
    reach: Annotated[int, Field(ge=0, le=100)] = 1
    """Largest distance, in cells along rows and columns, of a running cell from a cell that senses a parcel."""
    ttl_periods: Ttl = 1
    """Validity of a neighbour's message, periods: more than 1 where messages may be late."""


@final
class PresenceField(Firmware):
    """Velocity field where a parcel is sensed, and up to ``reach`` cells around.

    A cell's level is ``reach + 1`` where the cell senses a parcel, else one less than the highest valid level received,
    at least 0. The cell sends its level, and drives the field's velocity while the level is above 0.
    """

    Parameters = PresenceFieldParameters
    message = np.dtype([("level", "u1")])

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

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        """Wake or sleep, and send the own level."""
        inbox = inputs.inbox
        assert inbox is not None, "this is a bug: this firmware has messages"
        counts = age_ttl(inbox.received, state["counts"], self.parameters.ttl_periods)
        neighbour = hold_last(inbox.received, counts, inbox.message["level"], state["neighbour"])
        highest = np.maximum(
            np.maximum(neighbour[:, 0], neighbour[:, 1]), np.maximum(neighbour[:, 2], neighbour[:, 3])
        )
        here = inputs.presence[:, 0]
        for sensor in range(1, inputs.presence.shape[1]):
            here = here | inputs.presence[:, sensor]
        level = np.where(here, self.parameters.reach + 1, np.maximum(highest, 1) - 1)

        speed = np.where(level[:, None] > 0, state["speed_m_s"], 0.0)
        after = {**state, "neighbour": neighbour, "counts": counts}
        return after, Outputs(speed, Outbox.to_all(self.message, level=level))
