"""Puts the controller of a scene's cells together: what a scene does not ask for is not imported."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, final

from cell_firmware.board import Board
from cell_firmware.controller import Controller
from cell_firmware.effects.registry import CellEffects
from cell_firmware.firmware import Firmware
from cell_firmware.parts import LinkPart, WheelPart
from cell_firmware.specs import CellsSpec, SpeedLoopSpec

if TYPE_CHECKING:
    from cell_firmware.clocks import ArrayClocks


@final
@dataclass(frozen=True, slots=True)
class Motors:
    """What a board must know of the motors that it drives.

    Attributes:
        supply_v: What the output stage can give, V.
    """

    supply_v: float


def assemble(
    firmware: Firmware,
    spec: CellsSpec,
    effects: CellEffects,
    motors: Motors | None,
    clocks: ArrayClocks | None = None,
) -> Controller:
    """The controller that every cell has.

    Args:
        firmware: The cells' program.
        spec: What the scene says of cells.
        effects: Of the cells.
        motors: None where the wheels run at the speed that they are told.
        clocks: None where all cells step at once, by the plant's clock.
    """
    board = Board(firmware, _wheels(spec, effects, motors), _links(firmware, spec, effects, clocks))
    if clocks is None:
        return board
    from cell_firmware.clocked import Clocked

    return Clocked(board, clocks)


def _wheels(spec: CellsSpec, effects: CellEffects, motors: Motors | None) -> WheelPart | None:
    """What closes on the motors."""
    del effects
    if motors is None:
        return None
    from cell_firmware.speed_loop import SpeedLoop

    return SpeedLoop(spec.speed_loop or SpeedLoopSpec(), spec.period_s, motors.supply_v)


def _links(
    firmware: Firmware, spec: CellsSpec, effects: CellEffects, clocks: ArrayClocks | None
) -> LinkPart | None:
    """What messages have to pass."""
    del spec, effects
    if firmware.message is None or clocks is None:
        return None
    from cell_firmware.mailbox import Mailbox

    return Mailbox(firmware.message, clocks.all.window_ns)
