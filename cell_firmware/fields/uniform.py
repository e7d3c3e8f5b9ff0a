"""Uniform velocity field."""

from __future__ import annotations

from typing import Literal, final

import numpy as np

from cell_firmware.fields.base import Array, Field, columns
from cell_firmware.specs import Vector


@final
class Uniform(Field):
    """``V = velocity_m_s``: a conveyor."""

    kind: Literal["uniform"] = "uniform"
    velocity_m_s: Vector

    def velocity(self, x: Array, y: Array) -> Array:
        """Surface velocity, ``(n, 2)`` m/s."""
        return columns(np.full_like(x, self.velocity_m_s[0]), np.full_like(y, self.velocity_m_s[1]))
