"""Effect ``sensor``: presence sensors that err at random, bounce, and whose readings come late."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, ClassVar, Final, Self, final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from bus.random_streams import CounterStream
from bus.state import StateFields
from cell_firmware.effects.base import CellEffectSpec, InputFilter, ShardContext
from cell_firmware.firmware import Inputs
from cell_firmware.kernels.arguments import readable

Probability = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
LONGEST_TICKS: Final = 1_000
"""Longest latency, and most readings to wait for."""
_NOBODY: Final = np.zeros(0, dtype=np.int64)
THRESHOLD: Final = 0.5
"""Default level at which an analogue sensor reports presence."""


@final
class SensorSpec(CellEffectSpec):
    """Presence sensors err at random, independently in each reading, and readings come late.

    In this order: the bit of an analogue sensor is made from the level (after ``adc``) by a threshold with hysteresis.
    The bit errs. A change is accepted after several readings in a row (debouncing). The accepted bit is delayed: a cell
    sees in tick k the bit of tick k − latency. Until then, sensors report absence.
    """

    states: ClassVar[tuple[str, ...]] = (
        "bits held by hysteresis, changes not yet believed, readings under way",
    )
    messages: ClassVar[tuple[str, ...]] = ("presence bits err and lag",)
    fidelity_rank: ClassVar[int | None] = 60
    threshold: Annotated[float, Field(gt=0, le=1, allow_inf_nan=False)] | None = None
    """Level at which an analogue sensor reports presence; None: one half."""
    hysteresis: Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)] = 0.0
    """Width of the hysteresis, half of it on either side of the threshold."""
    false_positive: Probability = 0.0
    """Probability, for each sensor and tick, that an uncovered sensor reports presence."""
    false_negative: Probability = 0.0
    """Probability, for each sensor and tick, that a covered sensor reports absence."""
    debounce_ticks: Annotated[int, Field(ge=1, le=LONGEST_TICKS)] = 1
    """Number of consecutive readings after which a change is accepted; a cell has one reading a period."""
    latency_ticks: Annotated[int, Field(ge=0, le=LONGEST_TICKS)] = 0
    """Additional latency of readings, ticks."""

    @classmethod
    def default_settings(cls, pitch_m: float) -> Self:  # noqa: ARG003
        """Return the defaults: one reading in a thousand is wrong, and all are a tick late."""
        return cls(false_positive=1e-3, false_negative=1e-3, latency_ticks=1)

    @model_validator(mode="after")
    def _within_reach(self) -> SensorSpec:
        off, on = self.switching_levels
        if off <= 0.0 or on > 1.0:
            raise ValueError(
                f"threshold -/+ hysteresis/2 must be in (0, 1], not {off:g} and {on:g}: the sensor would never switch"
            )
        return self

    @property
    def switching_levels(self) -> tuple[float, float]:
        """Switching levels: absence below the first, presence from the second on."""
        threshold = THRESHOLD if self.threshold is None else self.threshold
        return threshold - 0.5 * self.hysteresis, threshold + 0.5 * self.hysteresis

    def required(self) -> tuple[str, ...]:
        """Require analogue sensors where a threshold or hysteresis is set."""
        return ("analogue_sensors",) if self.threshold is not None or self.hysteresis else ()

    def input_filters(self, site: ShardContext) -> Iterator[InputFilter]:
        """Threshold, errors, debouncing, latency."""
        if site.levels:
            yield _Threshold(self, site)
        if self.false_positive or self.false_negative:
            yield _Errors(self, site)
        if self.debounce_ticks > 1:
            yield Debounce(self.debounce_ticks, site)
        if self.latency_ticks:
            yield _Latency(self.latency_ticks, site)


@final
class _Threshold(InputFilter):
    """A comparator with hysteresis."""

    state_fields: ClassVar[StateFields] = StateFields("_there")

    def __init__(self, spec: SensorSpec, site: ShardContext) -> None:
        super().__init__()
        self._off, self._on = spec.switching_levels
        self._there = np.zeros((len(site.cells), site.sensors), dtype=np.bool_)

    def apply(self, tick: int, inputs: Inputs, alive: NDArray[np.int64] | slice) -> Inputs:
        """Make bits from levels."""
        del tick, alive
        level = inputs.level
        assert level is not None, "this is a bug: no levels, but a threshold"
        self._there = (level >= self._on) | (self._there & (level >= self._off))
        return replace(inputs, presence=self._there.copy())


@final
class _Errors(InputFilter):
    def __init__(self, spec: SensorSpec, site: ShardContext) -> None:
        super().__init__()
        self._false_positive, self._false_negative = spec.false_positive, spec.false_negative
        self._draws = CounterStream(site.seed, "sensor", site.sensor_stream_ids())
        self.counters.update({"false_positives": 0, "false_negatives": 0})

    def apply(self, tick: int, inputs: Inputs, alive: NDArray[np.int64] | slice) -> Inputs:
        """Flip readings at random."""
        presence = inputs.presence
        chance = self._draws.uniform(tick).reshape(presence.shape)
        wrong = chance < np.where(presence, self._false_negative, self._false_positive)
        self.count("false_positives", wrong & ~presence, alive)
        self.count("false_negatives", wrong & presence, alive)
        return replace(inputs, presence=presence ^ wrong)


@final
class Debounce(InputFilter):
    """Debouncing: counts consecutive readings of each bit that differ from the accepted bit.

    A reading counts once: where cells have their own clocks, a cell may have no new reading in an exchange.

    Args:
        ticks: Readings in a row after which a change is accepted.
        site: The shard's cells.

    Attributes:
        ticks: As given.
        clocks: Period and window of the cells' clocks, ns, and errors and first instants, ``(n,)``; zeros and empty
            arrays where all cells read in every exchange.
    """

    state_fields: ClassVar[StateFields] = StateFields("_believed", "_read")

    def __init__(self, ticks: int, site: ShardContext) -> None:
        super().__init__()
        self.ticks = ticks
        clocks = site.clocks
        self.clocks = (0, 0, _NOBODY, _NOBODY)
        if clocks is not None:
            self.clocks = (
                clocks.period_ns,
                clocks.window_ns,
                readable(clocks.ppb),
                readable(clocks.phase_ns),
            )
        shape = (len(site.cells), site.sensors)
        self._believed = np.zeros(shape, dtype=np.bool_)
        self._read = np.zeros(shape, dtype=np.int64)
        self.counters["bounces"] = 0

    @property
    def memory(self) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
        """Accepted bits, and readings in a row that differ from them, ``(n, sensors)`` each; changed in place."""
        return self._believed, self._read

    def apply(self, tick: int, inputs: Inputs, alive: NDArray[np.int64] | slice) -> Inputs:
        """Hold each bit until its change has been read often enough."""
        from cell_firmware.kernels.debounce import debounce

        presence = np.empty_like(self._believed)
        self.counters["bounces"] += debounce(
            self.ticks, tick - 1, *self.clocks, _NOBODY if isinstance(alive, slice) else alive,
            isinstance(alive, slice), readable(inputs.presence), self._believed, self._read, presence,
        )  # fmt: skip
        return inputs.with_presence(presence)


@final
class _Latency(InputFilter):
    state_fields: ClassVar[StateFields] = StateFields("_delayed")

    def __init__(self, ticks: int, site: ShardContext) -> None:
        super().__init__()
        self._delayed = np.zeros((ticks, len(site.cells), site.sensors), dtype=np.bool_)

    def apply(self, tick: int, inputs: Inputs, alive: NDArray[np.int64] | slice) -> Inputs:
        """Replace the readings by the readings of as many ticks ago as the latency."""
        del alive
        slot = self._delayed[tick % len(self._delayed)]
        read = slot.copy()
        slot[:] = inputs.presence
        return replace(inputs, presence=read)
