"""Every effect there is: a new one is a file and a line here."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from bus.spec import Spec
from plant.effects.contact_width import ContactWidthSpec
from plant.effects.effect import EffectSpec
from plant.effects.feeders import FeedersSpec
from plant.effects.motors import MotorsSpec
from plant.effects.parcel_contact import ParcelContactSpec
from plant.effects.roller_impacts import RollerImpactsSpec
from plant.effects.uneven_supports import UnevenSupportsSpec
from plant.effects.wheel_load import WheelLoadSpec


class EffectsSpec(Spec):
    """Effects the scene asks for; an absent one is not simulated and costs nothing."""

    motors: MotorsSpec | None = None
    uneven_supports: UnevenSupportsSpec | None = None
    contact_width: ContactWidthSpec | None = None
    roller_impacts: RollerImpactsSpec | None = None
    wheel_load: WheelLoadSpec | None = None
    feeders: FeedersSpec | None = None
    parcel_contact: ParcelContactSpec | None = None

    def asked(self) -> Iterator[tuple[str, EffectSpec]]:
        """Name and settings of the effects that are there."""
        for name in type(self).model_fields:
            effect = getattr(self, name)
            if effect is not None:
                yield name, effect

    def rails_m(self) -> Sequence[Sequence[tuple[float, float]]]:
        """Corners of each guide rail that stands on the array, m."""
        return () if self.parcel_contact is None else self.parcel_contact.rails
