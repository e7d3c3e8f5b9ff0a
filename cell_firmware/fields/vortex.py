"""Round a centre."""

from __future__ import annotations

from typing import Literal, final

from pydantic import model_validator

from cell_firmware.fields.base import Array, Field, columns, unit
from cell_firmware.specs import Finite, Vector


@final
class Vortex(Field):
    """``V = w (-py, px)`` or ``V = s (-py, px) / |p|`` with ``p`` from the centre.

    Positive is counter-clockwise. At constant speed the centre itself stands still.
    """

    kind: Literal["vortex"] = "vortex"
    rate_rad_s: Finite | None = None
    """Angular rate w of a rigid rotation."""
    speed_m_s: Finite | None = None
    """Tangential speed s at every distance, instead of ``rate_rad_s``."""
    centre_m: Vector = (0.0, 0.0)

    @model_validator(mode="after")
    def _one_of_two(self) -> Vortex:
        if (self.rate_rad_s is None) == (self.speed_m_s is None):
            raise ValueError("give rate_rad_s or speed_m_s, one of the two")
        return self

    def velocity(self, x: Array, y: Array) -> Array:
        """Surface velocity, ``(n, 2)`` m/s."""
        px, py = x - self.centre_m[0], y - self.centre_m[1]
        if self.rate_rad_s is not None:
            return columns(-self.rate_rad_s * py, self.rate_rad_s * px)
        assert self.speed_m_s is not None, "this is a bug: the validator asks for one of the two"
        ux, uy = unit(px, py)
        return columns(-self.speed_m_s * uy, self.speed_m_s * ux)
