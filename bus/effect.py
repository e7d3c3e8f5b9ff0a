"""Base classes of effect specifications and of their registries."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar, Self

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
    states: ClassVar[tuple[str, ...]] = ()
    """What a run has to carry on from tick to tick for it, in words."""
    events: ClassVar[tuple[str, ...]] = ()
    """Kinds of events that only happen with it."""
    messages: ClassVar[tuple[str, ...]] = ()
    """What it changes in the messages of plant and cells, in words."""
    fidelity_rank: ClassVar[int | None] = None
    """Its place in the ladder of fidelity, coarse effects first; None: it says what a scene has, not how finely."""

    @classmethod
    def default_settings(cls, pitch_m: float) -> Self | str:  # noqa: ARG003
        """Settings with which a scene that lacks the effect tries it; or, in words, why only a scene can say.

        Args:
            pitch_m: of the scene's array.
        """
        return "it has no typical settings"

    def required(self) -> tuple[str, ...]:
        """Names of the effects that these settings build on: ``needs``, and more where they ask for more."""
        return self.needs

    def problems(
        self,
        lattice: Lattice,  # noqa: ARG002
        pitch_m: float,  # noqa: ARG002
    ) -> Iterator[tuple[tuple[str | int, ...], object, str]]:
        """Yield settings that do not fit the array: path from the effect's table, value, and violated rule."""
        yield from ()


class Effects(Spec):
    """A registry of effects: every field is one, None where the scene doesn't ask for it."""

    def enabled(self) -> Iterator[tuple[str, EffectSpec]]:
        """Name and settings of the effects that are there."""
        for name in type(self).model_fields:
            effect = getattr(self, name)
            if effect is not None:
                yield name, effect

    def problems(self) -> Iterator[tuple[tuple[str, str], object, str]]:
        """Effects that lack another, or don't go with one: path in the scene, value, and the rule that is broken."""
        for name, effect in self.enabled():
            for needed in effect.required():
                if getattr(self, needed, None) is None:
                    yield ("effects", needed), None, f"must be asked for too: effects.{name} needs it"
            for other in effect.excludes:
                if getattr(self, other, None) is not None:
                    yield ("effects", name), "", f"doesn't go with effects.{other}"
