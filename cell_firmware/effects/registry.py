"""Every effect of the cells: a new one is a file and a line here."""

from __future__ import annotations

from collections.abc import Iterator

from bus.effect import Effects
from cell_firmware.effects.adc import AdcSpec
from cell_firmware.effects.base import CellEffectSpec, InputFilter, ShardContext
from cell_firmware.effects.clock.spec import ClockSpec
from cell_firmware.effects.cop.spec import CopSpec
from cell_firmware.effects.encoder import EncoderSpec
from cell_firmware.effects.fixed_point import FixedPointSpec
from cell_firmware.effects.link_delay import LinkDelaySpec
from cell_firmware.effects.link_loss import LinkLossSpec
from cell_firmware.effects.pwm import PwmSpec
from cell_firmware.effects.sensor import SensorSpec
from cell_firmware.effects.serial.spec import SerialSpec
from cell_firmware.specs import CellsSpec


class CellEffects(Effects):
    """Effects on what cells sense, compute and tell each other that a scene asks for.

    They act in the order of these lines: a sensor makes its bit of what the converter read, what is lost is not
    delayed.
    """

    clock: ClockSpec | None = None
    adc: AdcSpec | None = None
    sensor: SensorSpec | None = None
    link_loss: LinkLossSpec | None = None
    link_delay: LinkDelaySpec | None = None
    encoder: EncoderSpec | None = None
    pwm: PwmSpec | None = None
    fixed_point: FixedPointSpec | None = None
    serial: SerialSpec | None = None
    cop: CopSpec | None = None

    def fit_problems(self, cells: CellsSpec) -> Iterator[tuple[tuple[str | int, ...], object, str]]:
        """Yield settings of effects that do not fit the cells: path from ``effects``, value, and violated rule."""
        for name, effect in self.enabled():
            if isinstance(effect, CellEffectSpec):
                for path, value, rule in effect.fit_problems(cells):
                    yield (name, *path), value, rule

    def input_filters(self, site: ShardContext) -> dict[str, tuple[InputFilter, ...]]:
        """Return the filters of the shard's inputs, in order, by name of the effect."""
        return {
            name: tuple(effect.input_filters(site))
            for name, effect in self.enabled()
            if isinstance(effect, CellEffectSpec)
        }
