"""Several fields at once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, final

from pydantic import field_validator

from cell_firmware.fields.base import Array, Field

if TYPE_CHECKING:
    FieldSpec = Field  # when the program runs: the union of all fields, this one too, put in by the registry


@final
class Sum(Field):
    """The sum of its fields, added in the order in which they are listed. Sums nest."""

    kind: Literal["sum"] = "sum"
    fields: tuple[FieldSpec, ...]

    @field_validator("fields")
    @classmethod
    def _some(cls, value: tuple[FieldSpec, ...]) -> tuple[FieldSpec, ...]:
        if not value:
            raise ValueError("must name at least one field")
        return value

    def velocity(self, x: Array, y: Array) -> Array:
        """Surface velocity, ``(n, 2)`` m/s."""
        total = self.fields[0].velocity(x, y)
        for field in self.fields[1:]:
            total = total + field.velocity(x, y)
        return total
