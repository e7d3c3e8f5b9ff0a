"""Effect ``camera``: a camera above the array sees where all parcels are, and cells that subscribe are shown it."""

from __future__ import annotations

from typing import ClassVar, Self, final

from bus.effect import EffectSpec
from bus.spec import NotNegative, Positive


@final
class CameraSpec(EffectSpec):
    """A vision system: the poses of all parcels, for cells whose program asks for them."""

    states: ClassVar[tuple[str, ...]] = ("camera frames under way",)
    messages: ClassVar[tuple[str, ...]] = ("cells that subscribe receive camera frames",)
    period_s: Positive = 0.04
    """Between pictures: each is taken at the first tick that is not before its time."""
    latency_s: NotNegative = 0.0
    """From a picture to the first tick, not before that, in which cells are shown it."""
    position_noise_m: NotNegative = 0.0
    """Standard deviation of what is off in each coordinate."""
    angle_noise_rad: NotNegative = 0.0
    """And in each angle."""

    @classmethod
    def default_settings(cls, pitch_m: float) -> Self:
        """25 pictures a second, 40 ms late, off by a hundredth of the pitch."""
        return cls(latency_s=0.04, position_noise_m=0.01 * pitch_m, angle_noise_rad=0.01)
