"""The linear field of the paper's Fig. 12."""

from __future__ import annotations

from typing import Literal, final

from cell_firmware.fields.base import Array, Field, columns
from cell_firmware.specs import Finite, Vector


@final
class Elliptic(Field):
    """``V = (kx (x - cx), ky (y - cy))``: two negative rates draw parcels to the centre and turn them."""

    kind: Literal["elliptic"] = "elliptic"
    kx_per_s: Finite
    ky_per_s: Finite
    centre_m: Vector = (0.0, 0.0)

    def velocity(self, x: Array, y: Array) -> Array:
        """Surface velocity, ``(n, 2)`` m/s."""
        return columns(self.kx_per_s * (x - self.centre_m[0]), self.ky_per_s * (y - self.centre_m[1]))
