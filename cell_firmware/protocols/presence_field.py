"""A velocity field that is active only under a parcel and a little around it."""

from __future__ import annotations

from typing import Annotated, final

import numpy as np
from pydantic import Field

from bus.lattice import Lattice
from cell_firmware.fields import FieldSpec
from cell_firmware.firmware import Cells, Firmware, Floats, Inputs, Outbox, Outputs, State
from cell_firmware.kernels.arguments import readable
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
class PresenceField(Firmware):
    """Velocity field where a parcel is sensed, and up to ``reach`` cells around.

    A cell's level is ``reach + 1`` where the cell senses a parcel, else one less than the highest valid level received,
    at least 0. The cell sends its level, and drives the field's velocity while the level is above 0.
    """

    Parameters = PresenceFieldParameters
    message = np.dtype([("level", "u1")])
    kernels = "cell_firmware.kernels.programs.presence_field"
    refuses_misfits = True  # levels are at most 101

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
        from cell_firmware.kernels.programs import presence_field

        inbox, parameters = inputs.inbox, self.parameters
        assert inbox is not None, "this is a bug: this firmware has messages"
        after = {name: np.empty_like(state[name], order="C") for name in ("neighbour", "counts")}
        speed = np.empty((len(inputs.presence), 2))
        outbox = Outbox(
            np.ones(inbox.received.shape, dtype=np.bool_), np.empty(inbox.received.shape, self.message)
        )
        presence_field.step(
            parameters.reach, parameters.ttl_periods, readable(inputs.presence), readable(inbox.received),
            readable(inbox.message["level"]),
            *(readable(state[name]) for name in ("speed_m_s", "neighbour", "counts")),
            speed, *after.values(), outbox.message["level"],
        )  # fmt: skip
        return {**state, **after}, Outputs(speed, outbox)
