"""Open-loop velocity field: every cell drives the field's velocity at its position."""

from __future__ import annotations

from collections.abc import Mapping
from typing import final

from bus.lattice import Lattice
from cell_firmware.fields import FieldSpec
from cell_firmware.firmware import Cells, Floats, Inputs, Outputs, State
from cell_firmware.scalar import ScalarFirmware
from cell_firmware.specs import Spec


class VelocityFieldParameters(Spec):
    """The field."""

    field: FieldSpec


@final
class VelocityField(ScalarFirmware):
    """Open-loop drive: each cell evaluates its velocity once and keeps it."""

    Parameters = VelocityFieldParameters
    kernels = "cell_firmware.kernels.programs.velocity_field"
    form = "on arrays"  # without kernels but where boards have some

    def check_geometry(self, lattice: Lattice, position_m: Floats, pitch_m: float) -> None:
        """The field must be a number at every cell."""
        del pitch_m
        self.parameters.field.check_places("velocity_field", lattice, position_m)

    def init(self, cells: Cells) -> State:
        """Each cell's speed, ``(n, 2)`` m/s."""
        x, y = cells.position_m[:, 0], cells.position_m[:, 1]
        return {"speed_m_s": self.parameters.field.velocity(x, y)}

    def constants(self) -> Mapping[str, int]:
        """None."""
        return {}

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        """Drive the constant velocity."""
        del inputs
        return state, Outputs(state["speed_m_s"])
