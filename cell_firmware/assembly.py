"""Puts the controller of a scene's cells together: what a scene does not ask for is not imported."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from cell_firmware.board import Board
from cell_firmware.controller import Controller
from cell_firmware.effects.registry import CellEffects
from cell_firmware.firmware import Firmware
from cell_firmware.parts import LinkPart, WheelPart
from cell_firmware.specs import CellsSpec, SpeedLoopSpec


@final
@dataclass(frozen=True, slots=True)
class Motors:
    """What a board must know of the motors that it drives.

    Attributes:
        supply_v: What the output stage can give, V.
    """

    supply_v: float


def assemble(firmware: Firmware, spec: CellsSpec, effects: CellEffects, motors: Motors | None) -> Controller:
    """The controller that every cell has.

    Args:
        firmware: The cells' program.
        spec: What the scene says of cells.
        effects: Of the cells.
        motors: None where the wheels run at the speed that they are told.
    """
    return Board(firmware, _wheels(spec, effects, motors), _links(firmware, spec, effects))


def _wheels(spec: CellsSpec, effects: CellEffects, motors: Motors | None) -> WheelPart | None:
    """What closes on the motors."""
    del effects
    if motors is None:
        return None
    from cell_firmware.speed_loop import SpeedLoop

    return SpeedLoop(spec.speed_loop or SpeedLoopSpec(), spec.period_s, motors.supply_v)


def _links(firmware: Firmware, spec: CellsSpec, effects: CellEffects) -> LinkPart | None:
    """What messages have to pass."""
    del firmware, spec, effects
    return None
