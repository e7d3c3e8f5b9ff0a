"""What the spec of every effect has in common."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

from bus.lattice import Lattice
from bus.spec import Spec


class EffectSpec(Spec):
    """A table under a scene's ``[effects]``; one that is absent is not simulated and costs nothing."""

    solvers: ClassVar[tuple[str, ...] | None] = None
    """Names of the solvers that know the effect; None: it doesn't concern them."""
    needs: ClassVar[tuple[str, ...]] = ()
    """Names of the effects that it builds on."""
    excludes: ClassVar[tuple[str, ...]] = ()
    """Names of the effects that leave it out."""

    def misplaced(
        self,
        lattice: Lattice,  # noqa: ARG002
        pitch_m: float,  # noqa: ARG002
    ) -> Iterator[tuple[tuple[str | int, ...], object, str]]:
        """What does not fit the array: path from the effect's table, value, and the rule that it breaks."""
        yield from ()
