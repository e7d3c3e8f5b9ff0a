"""Construction of the cells' controller; modules that a scene does not need are not imported."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np

from cell_firmware.board import Board, has_hardware, has_kernels
from cell_firmware.components import LinkDriver, MessageCounter, WheelDriver
from cell_firmware.controller import Controller, ControllerWrapper
from cell_firmware.effects.registry import CellEffects
from cell_firmware.errors import SettingError
from cell_firmware.firmware import Firmware
from cell_firmware.message_tracer import MessageTracer
from cell_firmware.specs import CellsSpec, SpeedLoopSpec

if TYPE_CHECKING:
    from bus.fault import FaultInstance
    from bus.lattice import Lattice
    from cell_firmware.clocks import ArrayClocks
    from cell_firmware.effects.base import InputFilter, ShardContext
    from cell_firmware.effects.clock.spec import ClockSpec
    from cell_firmware.effects.encoder import EncoderSpec
    from cell_firmware.effects.fixed_point import FixedPointSpec
    from cell_firmware.effects.pwm import PwmSpec
    from cell_firmware.effects.serial.timing import LineSettings
    from cell_firmware.faults.base import CellFault
    from cell_firmware.speed_loop.fixed_point import FixedPointLoop
    from cell_firmware.speed_loop.output import Pwm
    from cell_firmware.speed_loop.sensing import Encoder


@final
@dataclass(frozen=True, slots=True, eq=False)
class CellFaults:
    """The faults of a run that cells carry out.

    Attributes:
        lattice: Of the array.
        injected: All of them.
        seed: The scene's.
        link_ticks: Ticks after which a message is read.
    """

    lattice: Lattice
    injected: tuple[FaultInstance[CellFault], ...]
    seed: int = 0
    link_ticks: int = 1

    def stages(self, site: ShardContext) -> tuple[InputFilter, ...]:
        """Return the input filters of all faults for a shard's cells, fault by fault."""
        return tuple(
            stage for one in self.injected for stage in one.fault.input_filters(site, self.lattice, one)
        )


@final
@dataclass(frozen=True, slots=True)
class MotorFacts:
    """Motor parameters that a board needs.

    Attributes:
        supply_v: What the output stage can give, V.
        free_speed_m_s: Surface speed of a wheel at the supply's voltage without load or dry friction, m/s.
        wheel_radius_m: None where the motors are described without one.
    """

    supply_v: float
    free_speed_m_s: float
    wheel_radius_m: float | None = None


def build_controller(
    firmware: Firmware,
    spec: CellsSpec,
    effects: CellEffects,
    motors: MotorFacts | None,
    clocks: ArrayClocks | None = None,
    *,
    faults: CellFaults | None = None,
    live: bool = False,
    metered: bool = False,
    traced: bool = False,
    seed: int = 0,
) -> Controller:
    """Build the controller of the cells.

    Args:
        firmware: The cells' program.
        spec: The scene's settings of cells.
        effects: Effects of the cells.
        motors: Motor parameters; None where wheels run at the commanded speed.
        clocks: Clocks of the cells; None where all cells step at once, by the plant's clock.
        faults: Faults of cells and links; None if there are none.
        live: Whether faults may be injected at run time.
        metered: Whether every cell counts the messages of its program.
        traced: Whether every cell records the messages of its program; it has no compiled form then.
        seed: Seed of the programs' random numbers, the scene's.

    Raises:
        SettingError: Settings of the board that don't go together.
    """
    controller: Controller = Board(
        firmware,
        wheels_of(spec, effects, motors),
        _links(firmware, spec, effects, clocks, disturbed=live or faults is not None),
        MessageCounter() if metered and firmware.message is not None else None,
        MessageTracer(firmware.message) if traced and firmware.message is not None else None,
        seed,
    )
    if effects.cop is not None:
        from cell_firmware.effects.cop.wrapper import WatchdogWrapper

        controller = WatchdogWrapper(controller, effects.cop, spec.period_ns)
    if clocks is not None:
        from cell_firmware.effects.clock.wrapper import LocalClockWrapper

        controller = LocalClockWrapper(controller, clocks)
    if faults is not None:
        from cell_firmware.faults.attach import attach_fault

        for injected in faults.injected:
            controller = attach_fault(
                controller, faults.lattice, faults.seed, injected, link_ticks=faults.link_ticks
            )
    return controller


def kernel_modules(controller: Controller, effects: CellEffects) -> tuple[str, ...]:
    """Return the modules of kernels that cells use, without importing them.

    Args:
        controller: Result of ``build_controller``.
        effects: Effects of the cells.
    """
    modules: list[str] = []
    inside = controller
    while isinstance(inside, ControllerWrapper):
        inside = inside.controller
    if controller.message_type is not None:
        modules.append("cell_firmware.kernels.messages")
    if isinstance(inside, Board):
        if inside.streams is not None:
            modules.append("cell_firmware.kernels.draws")
        if has_hardware(controller):
            modules.append("cell_firmware.kernels.board")
        if inside.links is not None and inside.links.kernels:
            modules.append(inside.links.kernels)
        if inside.firmware.kernels and has_kernels(controller):
            modules += [
                "cell_firmware.kernels.payload",
                "cell_firmware.kernels.plausibility",
                inside.firmware.kernels,
            ]
    if effects.sensor is not None and effects.sensor.debounce_ticks > 1:
        modules.append("cell_firmware.kernels.debounce")
    return tuple(modules)


def wheels_of(spec: CellsSpec, effects: CellEffects, motors: MotorFacts | None) -> WheelDriver | None:
    """Return the speed loop of the motors; None where wheels run at the commanded speed.

    Raises:
        SettingError: Settings that don't go together.
    """
    if motors is None:
        return None
    gains = spec.speed_loop or SpeedLoopSpec()
    encoder = (
        None if effects.encoder is None else _encoder(effects.encoder, effects.clock, spec.period_s, motors)
    )
    pwm = None if effects.pwm is None else _pwm(effects.pwm, motors)
    if effects.fixed_point is not None:
        return _fixed_point(effects.fixed_point, gains, spec.period_s, motors, encoder, pwm)
    from cell_firmware.speed_loop import SpeedLoop

    return SpeedLoop(gains, spec.period_s, motors.supply_v, encoder, pwm)


def _encoder(effect: EncoderSpec, clock: ClockSpec | None, period_s: float, motors: MotorFacts) -> Encoder:
    from cell_firmware.speed_loop.sensing import LARGEST_DIFFERENCE, Encoder

    radius, theirs = effect.wheel_radius_m, motors.wheel_radius_m
    if radius is not None and theirs is not None and radius != theirs:
        rule = f"must be that of effects.motors, {theirs:g}, or be left out"
        raise SettingError(("effects", "encoder", "wheel_radius_m"), radius, rule)
    encoder = Encoder(period_s, effect.m_per_count(theirs))
    counts = motors.free_speed_m_s / encoder.unit_m_s * (1.0 if clock is None else clock.longest)
    if counts > LARGEST_DIFFERENCE:
        rule = (
            f"at most {LARGEST_DIFFERENCE} counts a period can be distinguished, and a wheel without load makes "
            f"{counts:.1f} at supply_v"
        )
        path = ("effects", "encoder", "counts_per_revolution")
        raise SettingError(path, effect.counts_per_revolution, rule)
    return encoder


def _pwm(effect: PwmSpec, motors: MotorFacts) -> Pwm:
    from cell_firmware.speed_loop.output import Pwm

    return Pwm(effect.counts, motors.supply_v)


def _fixed_point(
    effect: FixedPointSpec,
    gains: SpeedLoopSpec,
    period_s: float,
    motors: MotorFacts,
    encoder: Encoder | None,
    pwm: Pwm | None,
) -> FixedPointLoop:
    from cell_firmware.speed_loop.fixed_point import FixedPointLoop
    from cell_firmware.speed_loop.scaling import IDEAL_LEVELS, Scaling
    from cell_firmware.speed_loop.sensing import FixedPointTachometer

    if encoder is not None and effect.speed_unit_m_s is not None:
        rule = "the unit of speeds is a count a period where there is effects.encoder: leave it out"
        raise SettingError(("effects", "fixed_point", "speed_unit_m_s"), effect.speed_unit_m_s, rule)
    tachometer = FixedPointTachometer(period_s, effect.unit_m_s) if encoder is None else encoder
    largest_m_s = tachometer.largest * tachometer.unit_m_s
    if motors.free_speed_m_s > largest_m_s:
        rule = (
            f"a 16-bit word represents speeds up to {largest_m_s:.4g} m/s, and a wheel without load has "
            f"{motors.free_speed_m_s:.4g} at supply_v"
        )
        raise SettingError(("effects", "fixed_point", "speed_unit_m_s"), effect.unit_m_s, rule)
    levels = IDEAL_LEVELS if pwm is None else pwm.levels
    return FixedPointLoop(Scaling(gains, period_s, motors.supply_v, levels, tachometer), tachometer, pwm)


def _links(
    firmware: Firmware, spec: CellsSpec, effects: CellEffects, clocks: ArrayClocks | None, *, disturbed: bool
) -> LinkDriver | None:
    """Return the link driver; None for firmware without messages, and where links deliver whole messages."""
    if firmware.message is None:
        return None
    if effects.serial is not None:
        settings = effects.serial.settings(spec.period_ns)
        return _serial(settings, firmware.message, effects, clocks, disturbed=disturbed)
    if clocks is None:
        return None
    from cell_firmware.effects.clock.mailbox import Mailbox

    return Mailbox(firmware.message, clocks.clocks.window_ns)


def _serial(
    settings: LineSettings,
    message: np.dtype[Any],
    effects: CellEffects,
    clocks: ArrayClocks | None,
    *,
    disturbed: bool,
) -> LinkDriver:
    """Serial lines: byte by byte where something may happen to a byte."""
    from cell_firmware.effects.serial.lines import SerialLines
    from cell_firmware.effects.serial.message_level import MessageLevelLines, is_exact_for

    window_ns = settings.period_ns if clocks is None else clocks.clocks.window_ns
    worst_ppb = 0 if clocks is None else int(np.abs(clocks.clocks.ppb).max(initial=0))
    # a cell that begins to talk as soon as it was reset runs into what it had not finished to say
    reboots = effects.cop is None or effects.cop.reboot_s * 1e9 >= 2 * settings.period_ns
    safe = effects.link_loss is None and effects.link_delay is None and reboots and not disturbed
    kind = MessageLevelLines if safe and is_exact_for(settings, window_ns, worst_ppb) else SerialLines
    return kind(settings, message) if clocks is None else kind(settings, message, window_ns, clocks.ppb)
