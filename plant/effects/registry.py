"""Every effect of the plant: a new one is a file and a line here."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from bus.effect import Effects
from plant.effects.analogue_sensors.spec import AnalogueSensorsSpec
from plant.effects.camera.spec import CameraSpec
from plant.effects.contact_width import ContactWidthSpec
from plant.effects.feeders.spec import FeedersSpec
from plant.effects.load_transfer import LoadTransferSpec
from plant.effects.motors import MotorsSpec
from plant.effects.parcel_contact.spec import ParcelContactSpec
from plant.effects.roller_drag import RollerDragSpec
from plant.effects.roller_impacts import RollerImpactsSpec
from plant.effects.scanners.spec import ScannersSpec
from plant.effects.uneven_friction import UnevenFrictionSpec
from plant.effects.uneven_supports import UnevenSupportsSpec
from plant.effects.wheel_load import WheelLoadSpec


class PlantEffects(Effects):
    """Effects on what the plant moves and measures that a scene asks for."""

    motors: MotorsSpec | None = None
    uneven_supports: UnevenSupportsSpec | None = None
    contact_width: ContactWidthSpec | None = None
    uneven_friction: UnevenFrictionSpec | None = None
    roller_impacts: RollerImpactsSpec | None = None
    wheel_load: WheelLoadSpec | None = None
    roller_drag: RollerDragSpec | None = None
    load_transfer: LoadTransferSpec | None = None
    feeders: FeedersSpec | None = None
    parcel_contact: ParcelContactSpec | None = None
    analogue_sensors: AnalogueSensorsSpec | None = None
    scanners: ScannersSpec | None = None
    camera: CameraSpec | None = None

    def problems(self) -> Iterator[tuple[tuple[str, str], object, str]]:
        """See ``Effects``; and wheels that lack an inertia, or that their load could keep from turning."""
        yield from super().problems()
        if self.wheel_load is None or self.motors is None:
            return
        if self.wheel_inertia_kg is None:
            yield ("effects", "wheel_load"), None, "needs inertia_kg, unless effects.motors.dc determines it"
        if self.motors.first_order.static_v:
            rule = "has dry friction (coulomb, static), which doesn't go with effects.wheel_load"
            yield ("effects", "motors"), None, rule

    @property
    def wheel_inertia_kg(self) -> float | None:
        """Of each wheel as the surface feels it; None where wheels don't feel what they pull."""
        load, motors = self.wheel_load, self.motors
        if load is None or load.inertia_kg is not None:
            return None if load is None else load.inertia_kg
        return None if motors is None or motors.dc is None else motors.dc.inertia_kg

    def rails_m(self) -> Sequence[Sequence[tuple[float, float]]]:
        """Corners of each guide rail that stands on the array, m."""
        return () if self.parcel_contact is None else self.parcel_contact.rails
