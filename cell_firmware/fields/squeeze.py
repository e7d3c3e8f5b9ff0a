"""Two halves that drive towards the line between them (the paper's Fig. 14)."""

from __future__ import annotations

from typing import Literal, final

import numpy as np

from cell_firmware.fields.base import Array, Field, columns
from cell_firmware.specs import Finite, Vector


@final
class Squeeze(Field):
    """``V = (-s sign(x - cx), 0)``, or the same along y: constant speed towards a line, from both halves.

    The velocity jumps across the line; a cell exactly on it stands still. Nothing moves along the line: add
    a second squeeze along the other axis (``kind = "sum"``) for a field that centres both ways. A negative
    speed drives the halves apart.
    """

    kind: Literal["squeeze"] = "squeeze"
    speed_m_s: Finite
    axis: Literal["x", "y"] = "x"
    """Axis along which the cells drive, perpendicular to the line."""
    centre_m: Vector = (0.0, 0.0)
    """Point of the line."""

    def velocity(self, x: Array, y: Array) -> Array:
        """Surface velocity, ``(n, 2)`` m/s."""
        if self.axis == "x":
            return columns(-self.speed_m_s * np.sign(x - self.centre_m[0]), np.zeros_like(y))
        return columns(np.zeros_like(x), -self.speed_m_s * np.sign(y - self.centre_m[1]))
