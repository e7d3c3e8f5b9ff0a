"""The goal of a scene: by which rule a campaign judges its runs."""

from __future__ import annotations

from typing import final

from pydantic import model_validator

from bus.spec import Positive, Spec, Vector


@final
class GoalSpec(Spec):
    """A scene's own criterion of success, for `mdms campaign`. It changes nothing in a run."""

    within_m: Positive | None = None
    """Largest error of a success, m: distance of any corner from its final place in the baseline run or, without an
    baseline run, of any parcel's centre of mass from place_m."""
    place_m: Vector | None = None
    """Target of the parcels, m: reference of errors in a campaign without baseline runs."""
    at_rest: bool = False
    """Whether every parcel must rest, or have been delivered, at the end."""
    delivered: bool = False
    """Whether every parcel that was fed must have been delivered at the end."""

    @model_validator(mode="after")
    def _demands(self) -> GoalSpec:
        if self.within_m is None and not self.at_rest and not self.delivered:
            raise ValueError("give within_m, at_rest or delivered: a goal must demand something")
        if self.place_m is not None and self.within_m is None:
            raise ValueError("place_m needs within_m, the largest distance of a success")
        return self
