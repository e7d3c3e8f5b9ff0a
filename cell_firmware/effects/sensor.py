"""Effect ``sensor``: presence sensors that err at random, and whose readings come late."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, ClassVar, Final, Self, final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from bus.chance import Draws
from cell_firmware.effects.stage import CellEffectSpec, Site, Stage
from cell_firmware.firmware import Inputs

Probability = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
LONGEST_TICKS: Final = 1_000
"""Longest latency."""


@final
class SensorSpec(CellEffectSpec):
    """Presence sensors err at random, each reading by itself, and readings come late.

    The errors are those of a reading, which then takes its time: what a cell sees in tick k was read in tick
    k − latency. Before anything has come in, sensors say that nothing is there.
    """

    states: ClassVar[tuple[str, ...]] = ("readings under way",)
    messages: ClassVar[tuple[str, ...]] = ("what cells are told of sensors errs and lags",)
    rung: ClassVar[int | None] = 60
    false_positive: Probability = 0.0
    """Probability, a reading and tick, that a sensor with nothing over it says there is."""
    false_negative: Probability = 0.0
    """The same of one with a parcel over it, that it says there is not."""
    latency_ticks: Annotated[int, Field(ge=0, le=LONGEST_TICKS)] = 0
    """How many ticks later than without the effect the cell sees a reading."""

    @classmethod
    def typical(cls, pitch_m: float) -> Self:  # noqa: ARG003
        """One reading in a thousand is wrong, and each a tick late."""
        return cls(false_positive=1e-3, false_negative=1e-3, latency_ticks=1)

    def stages(self, site: Site) -> Iterator[Stage]:
        """Errors, then latency."""
        if self.false_positive or self.false_negative:
            yield _Errors(self, site)
        if self.latency_ticks:
            yield _Latency(self.latency_ticks, site)


@final
class _Errors(Stage):
    def __init__(self, spec: SensorSpec, site: Site) -> None:
        super().__init__()
        self._false_positive, self._false_negative = spec.false_positive, spec.false_negative
        self._draws = Draws(site.seed, "sensor", site.sensor_places())
        self.counted.update({"false_positives": 0, "false_negatives": 0})

    def apply(self, tick: int, inputs: Inputs, alive: NDArray[np.int64] | slice) -> Inputs:
        """Flips readings."""
        presence = inputs.presence
        chance = self._draws.uniform(tick).reshape(presence.shape)
        wrong = chance < np.where(presence, self._false_negative, self._false_positive)
        self.count("false_positives", wrong & ~presence, alive)
        self.count("false_negatives", wrong & presence, alive)
        return replace(inputs, presence=presence ^ wrong)


@final
class _Latency(Stage):
    def __init__(self, ticks: int, site: Site) -> None:
        super().__init__()
        self._under_way = np.zeros((ticks, len(site.cells), site.sensors), dtype=np.bool_)

    def apply(self, tick: int, inputs: Inputs, alive: NDArray[np.int64] | slice) -> Inputs:
        """Exchanges the readings of this tick for those of as many ticks ago."""
        del alive
        slot = self._under_way[tick % len(self._under_way)]
        read = slot.copy()
        slot[:] = inputs.presence
        return replace(inputs, presence=read)
