"""Every effect of the plant: a new one is a file and a line here."""

from __future__ import annotations

from collections.abc import Sequence

from bus.effect import Effects
from plant.effects.analogue_sensors import AnalogueSensorsSpec
from plant.effects.contact_width import ContactWidthSpec
from plant.effects.feeders import FeedersSpec
from plant.effects.motors import MotorsSpec
from plant.effects.parcel_contact import ParcelContactSpec
from plant.effects.roller_impacts import RollerImpactsSpec
from plant.effects.uneven_supports import UnevenSupportsSpec
from plant.effects.wheel_load import WheelLoadSpec


class PlantEffects(Effects):
    """Effects on what the plant moves and measures that a scene asks for."""

    motors: MotorsSpec | None = None
    uneven_supports: UnevenSupportsSpec | None = None
    contact_width: ContactWidthSpec | None = None
    roller_impacts: RollerImpactsSpec | None = None
    wheel_load: WheelLoadSpec | None = None
    feeders: FeedersSpec | None = None
    parcel_contact: ParcelContactSpec | None = None
    analogue_sensors: AnalogueSensorsSpec | None = None

    def rails_m(self) -> Sequence[Sequence[tuple[float, float]]]:
        """Corners of each guide rail that stands on the array, m."""
        return () if self.parcel_contact is None else self.parcel_contact.rails
