"""Any formula of x and y."""

from __future__ import annotations

from typing import Literal, final

from pydantic import ValidationInfo, field_validator

from cell_firmware.fields.base import Array, Field, columns
from cell_firmware.fields.formula import RESERVED, Formula
from cell_firmware.specs import Finite


@final
class Expression(Field):
    """``V = (vx(x, y), vy(x, y))`` in m/s of metres, as two formulas.

    Numbers, ``x``, ``y``, ``pi`` and the scene's constants; ``+ - * /`` and whole powers (``**``, up to 16); ``abs``,
    ``sqrt``, ``sign``, ``sin``, ``cos``, ``tan``, ``atan2``, ``exp``, ``log``, ``tanh``, ``hypot``, ``min``, ``max``;
    ``where(condition, then, else)`` with ``< <= > >= == !=``, ``and``, ``or`` and ``not``. Functions that NumPy does
    not round correctly are worked out for one cell at a time: a cell gets the same bits alone and among thousands.
    """

    kind: Literal["expression"] = "expression"
    constants: dict[str, Finite] = {}  # noqa: RUF012 - pydantic copies it
    """Named constants of the formulas."""
    vx: str
    """Formula of the velocity along x, m/s."""
    vy: str
    """Formula of the velocity along y, m/s."""

    @field_validator("constants")
    @classmethod
    def _free_names(cls, value: dict[str, float]) -> dict[str, float]:
        for name in value:
            if not (name.isascii() and name.isidentifier()):
                raise ValueError(f"{name!r} is not a name: letters, digits and _, a letter first")
            if name in RESERVED:
                raise ValueError(f"{name} has a meaning already")
        return value

    @field_validator("vx", "vy")
    @classmethod
    def _readable(cls, value: str, info: ValidationInfo) -> str:
        if "constants" in info.data:  # else they are refused themselves
            Formula(value, info.data["constants"])
        return value

    def velocity(self, x: Array, y: Array) -> Array:
        """Surface velocity, ``(n, 2)`` m/s."""
        return columns(Formula(self.vx, self.constants)(x, y), Formula(self.vy, self.constants)(x, y))
