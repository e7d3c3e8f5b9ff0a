"""Effect ``contact_width``: a wheel has a width, so that a cell's load ramps as the footprint's edge passes over it.

What chatters on wheels that are points settles here, a fraction of the wheel under the edge carrying its fraction of
the load; as the width tends to 0 that is Filippov's captured motion.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar, final

from bus.effect import EffectSpec
from bus.lattice import Lattice
from bus.spec import Positive


@final
class ContactWidthSpec(EffectSpec):
    """Wheels that come to be under a parcel by and by."""

    solvers: ClassVar[tuple[str, ...] | None] = ("implicit",)
    width_m: Positive
    """Over which a cell comes to be under a parcel, half of it on either side of the edge; at most the pitch."""

    def misplaced(
        self,
        lattice: Lattice,  # noqa: ARG002
        pitch_m: float,
    ) -> Iterator[tuple[tuple[str | int, ...], object, str]]:
        """A width beyond the pitch."""
        if self.width_m > pitch_m:
            yield ("width_m",), self.width_m, f"must be at most the array's pitch_m, {pitch_m:g}"
