"""What the spec of every effect has in common."""

from __future__ import annotations

from typing import ClassVar

from bus.spec import Spec


class EffectSpec(Spec):
    """A table under a scene's ``[effects]``; one that is absent is not simulated and costs nothing."""

    solvers: ClassVar[tuple[str, ...] | None] = None
    """Names of the solvers that know the effect; None: it doesn't concern them."""
