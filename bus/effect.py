"""Base classes of effect specifications and of their registries."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar, Self

from bus.lattice import Lattice
from bus.spec import Spec


class EffectSpec(Spec):
    """A table under a scene's ``[effects]``; an absent effect is not simulated and costs nothing."""

    solvers: ClassVar[tuple[str, ...] | None] = None
    """Names of the solvers that support the effect; None: it does not concern solvers."""
    needs: ClassVar[tuple[str, ...]] = ()
    """Names of the effects that the effect requires."""
    excludes: ClassVar[tuple[str, ...]] = ()
    """Names of the effects that the effect is incompatible with."""
    states: ClassVar[tuple[str, ...]] = ()
    """State that a run carries from tick to tick for the effect, as text."""
    events: ClassVar[tuple[str, ...]] = ()
    """Kinds of events that occur only with the effect."""
    messages: ClassVar[tuple[str, ...]] = ()
    """Changes of the messages of plant and cells by the effect, as text."""
    fidelity_rank: ClassVar[int | None] = None
    """Rank in the ladder of fidelity, coarse effects first; None: the effect adds equipment, not fidelity."""

    @classmethod
    def default_settings(cls, pitch_m: float) -> Self | str:  # noqa: ARG003
        """Return the settings for scenes that lack the effect, or the reason why there are no defaults.

        Args:
            pitch_m: of the scene's array.
        """
        return "it has no typical settings"

    def required(self) -> tuple[str, ...]:
        """Return the names of effects that these settings require: ``needs``, and possibly more."""
        return self.needs

    def problems(
        self,
        lattice: Lattice,  # noqa: ARG002
        pitch_m: float,  # noqa: ARG002
    ) -> Iterator[tuple[tuple[str | int, ...], object, str]]:
        """Yield settings that do not fit the array: path from the effect's table, value, and violated rule.

        A value of None is not shown.
        """
        yield from ()


class Effects(Spec):
    """A registry of effects: every field is an effect, None where the scene does not enable it."""

    def enabled(self) -> Iterator[tuple[str, EffectSpec]]:
        """Yield name and settings of the enabled effects."""
        for name in type(self).model_fields:
            effect = getattr(self, name)
            if effect is not None:
                yield name, effect

    def problems(self) -> Iterator[tuple[tuple[str, str], object, str]]:
        """Yield missing and incompatible effects: path in the scene, no value, and violated rule."""
        for name, effect in self.enabled():
            for needed in effect.required():
                if getattr(self, needed, None) is None:
                    yield ("effects", needed), None, f"must be set too: effects.{name} needs it"
            for other in effect.excludes:
                if getattr(self, other, None) is not None:
                    yield ("effects", name), None, f"doesn't go with effects.{other}"
