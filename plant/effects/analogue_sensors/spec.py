"""Effect ``analogue_sensors``: a presence sensor sees a round spot, and tells how much of it is covered."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar, Self, final

from bus.effect import EffectSpec
from bus.lattice import Lattice
from bus.spec import Positive


@final
class AnalogueSensorsSpec(EffectSpec):
    """Presence sensors that tell how much of a round spot is covered, from 0 to 1."""

    messages: ClassVar[tuple[str, ...]] = ("cells receive the level of every sensor",)
    fidelity_rank: ClassVar[int | None] = 52
    spot_radius_m: Positive
    """Of what a sensor sees; at most the pitch."""

    @classmethod
    def default_settings(cls, pitch_m: float) -> Self:
        """A twentieth of the pitch."""
        return cls(spot_radius_m=0.05 * pitch_m)

    def problems(
        self,
        lattice: Lattice,  # noqa: ARG002
        pitch_m: float,
    ) -> Iterator[tuple[tuple[str | int, ...], object, str]]:
        """A spot beyond the pitch."""
        if self.spot_radius_m > pitch_m:
            yield ("spot_radius_m",), self.spot_radius_m, f"must be at most the array's pitch_m, {pitch_m:g}"
