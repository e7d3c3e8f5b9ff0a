"""Effect ``scanners``: some cells have a reader that tells where the parcel over them is to go."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, ClassVar, final

from pydantic import Field, field_validator

from bus.effect import EffectSpec
from bus.lattice import Lattice
from bus.spec import CellName


@final
class ScannersSpec(EffectSpec):
    """Cells that read on a label which exit the parcel over them is meant for."""

    needs: ClassVar[tuple[str, ...]] = ("feeders",)
    messages: ClassVar[tuple[str, ...]] = ("cells receive the label over their scanner",)
    cells: Annotated[tuple[CellName, ...], Field(min_length=1)]
    """Those that have one, at their centre."""

    @field_validator("cells")
    @classmethod
    def _once(cls, value: tuple[CellName, ...]) -> tuple[CellName, ...]:
        twice = next((cell for cell in value if value.count(cell) > 1), None)
        if twice is not None:
            raise ValueError(f"names the cell {list(twice)} twice")
        return value

    @classmethod
    def default_settings(cls, pitch_m: float) -> str:  # noqa: ARG003
        """None."""
        return "only a scene can say where its scanners are and where its parcels go"

    def problems(
        self,
        lattice: Lattice,
        pitch_m: float,  # noqa: ARG002
    ) -> Iterator[tuple[tuple[str | int, ...], object, str]]:
        """Scanners where there is no cell."""
        for number, cell in enumerate(self.cells):
            if cell not in lattice:
                yield ("cells", number), list(cell), "the array has no cell there"
