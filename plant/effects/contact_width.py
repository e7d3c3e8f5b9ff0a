"""Effect ``contact_width``: a wheel has a width, so that a cell's load ramps as the footprint's edge passes over it.

What chatters on wheels that are points settles here, a fraction of the wheel under the edge carrying its fraction of
the load; as the width tends to 0 that is Filippov's captured motion.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar, Self, final

from bus.effect import EffectSpec
from bus.lattice import Lattice
from bus.spec import Positive


@final
class ContactWidthSpec(EffectSpec):
    """Wheels with a width, whose load ramps up as a parcel's edge passes over them."""

    solvers: ClassVar[tuple[str, ...] | None] = ("implicit", "fixed_step", "quasi_static")
    fidelity_rank: ClassVar[int | None] = 20
    width_m: Positive
    """Width over which a cell's load ramps up, half of it on either side of the parcel's edge; at most the pitch."""

    @classmethod
    def default_settings(cls, pitch_m: float) -> Self:
        """A tenth of the pitch."""
        return cls(width_m=0.1 * pitch_m)

    def problems(
        self,
        lattice: Lattice,  # noqa: ARG002
        pitch_m: float,
    ) -> Iterator[tuple[tuple[str | int, ...], object, str]]:
        """A width beyond the pitch."""
        if self.width_m > pitch_m:
            yield ("width_m",), self.width_m, f"must be at most the array's pitch_m, {pitch_m:g}"
