"""Away from a centre, or towards it."""

from __future__ import annotations

from typing import Literal, final

from pydantic import model_validator

from cell_firmware.fields.base import Array, Field, columns, unit
from cell_firmware.specs import Finite, Vector


@final
class Radial(Field):
    """``V = k p`` or ``V = s p / |p|`` with ``p`` from the centre, plus a rotation ``w (-py, px)``.

    Positive is outwards. At constant speed the centre itself stands still.
    """

    kind: Literal["radial"] = "radial"
    rate_per_s: Finite | None = None
    """Rate k: the speed grows with the distance."""
    speed_m_s: Finite | None = None
    """Speed s at every distance, instead of ``rate_per_s``."""
    rotation_rad_s: Finite = 0.0
    """Added rigid rotation, counter-clockwise."""
    centre_m: Vector = (0.0, 0.0)

    @model_validator(mode="after")
    def _one_of_two(self) -> Radial:
        if (self.rate_per_s is None) == (self.speed_m_s is None):
            raise ValueError("give rate_per_s or speed_m_s, one of the two")
        return self

    def velocity(self, x: Array, y: Array) -> Array:
        """Surface velocity, ``(n, 2)`` m/s."""
        px, py = x - self.centre_m[0], y - self.centre_m[1]
        if self.rate_per_s is not None:
            vx, vy = self.rate_per_s * px, self.rate_per_s * py
        else:
            assert self.speed_m_s is not None, "this is a bug: the validator asks for one of the two"
            ux, uy = unit(px, py)
            vx, vy = self.speed_m_s * ux, self.speed_m_s * uy
        return columns(vx - self.rotation_rad_s * py, vy + self.rotation_rad_s * px)
