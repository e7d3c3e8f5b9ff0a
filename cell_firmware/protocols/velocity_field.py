"""Open loop: every cell drives the field's velocity at its place, for ever."""

from __future__ import annotations

from typing import final

from bus.lattice import Lattice
from cell_firmware.fields import FieldSpec
from cell_firmware.firmware import Cells, Firmware, Floats, Inputs, Outputs, State
from cell_firmware.specs import Spec


class VelocityFieldParameters(Spec):
    """The field."""

    field: FieldSpec


@final
class VelocityField(Firmware):
    """Open-loop drive: each cell evaluates its velocity once and keeps it."""

    Parameters = VelocityFieldParameters

    def check_geometry(self, lattice: Lattice, position_m: Floats, pitch_m: float) -> None:
        """The field must be a number at every cell."""
        del pitch_m
        self.parameters.field.check_places("velocity_field", lattice, position_m)

    def init(self, cells: Cells) -> State:
        """Each cell's speed, ``(n, 2)`` m/s."""
        x, y = cells.position_m[:, 0], cells.position_m[:, 1]
        return {"speed_m_s": self.parameters.field.velocity(x, y)}

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        """Drive the constant velocity."""
        del inputs
        return state, Outputs(state["speed_m_s"])
