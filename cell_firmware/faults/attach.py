"""How a fault comes to what carries it out: a controller around that of the cells."""

from __future__ import annotations

from typing import TypeVar

from bus.fault import FaultInstance
from bus.lattice import Lattice
from cell_firmware.controller import Controller, ControllerState, ControllerWrapper
from cell_firmware.effects.clock.wrapper import LocalClockWrapper
from cell_firmware.faults.base import CellFault, FaultWrapper
from cell_firmware.firmware import Floats

_Kind = TypeVar("_Kind", bound=FaultWrapper)


def attach_fault(
    controller: Controller, lattice: Lattice, seed: int, fault: FaultInstance[CellFault]
) -> Controller:
    """A controller that carries out one more fault; it, or what is inside of it, is changed.

    Args:
        controller: Of the cells.
        lattice: Of the array.
        seed: The scene's.
        fault: Which.
    """
    for kind in _kinds(fault.fault, talks=controller.message_type is not None):
        controller, found = _found(controller, kind, lattice, seed)
        found.add(fault)
    return controller


def init_new_wrappers(controller: Controller, state: ControllerState, drive: Floats) -> ControllerState:
    """The state of a running controller's cells, with what it does not have yet of what was ``joined`` to it.

    Args:
        controller: It.
        state: Of n cells.
        drive: ``(n, 2)``, what they drive.
    """
    inside = controller
    while isinstance(inside, ControllerWrapper):
        if inside.part not in state.parts and isinstance(inside, FaultWrapper):
            state = inside.begin(state, drive)
        inside = inside.controller
    return state


def _kinds(fault: CellFault, *, talks: bool) -> list[type[FaultWrapper]]:
    """What carries out a fault, of cells that talk or not; where it is stages alone, nothing."""
    kinds: list[type[FaultWrapper]] = []
    if fault.skips_periods:
        from cell_firmware.faults.execution import ClockFaultWrapper

        kinds.append(ClockFaultWrapper)
    if fault.halts_program:
        from cell_firmware.faults.execution import ExecutionFaultWrapper

        kinds.append(ExecutionFaultWrapper)
    if fault.corrupts_messages and talks:
        from cell_firmware.faults.messages import MessageFaultWrapper

        kinds.append(MessageFaultWrapper)
    return kinds


def _found(
    controller: Controller, kind: type[_Kind], lattice: Lattice, seed: int
) -> tuple[Controller, _Kind]:
    """What carries out faults of a kind inside of a controller; put there if there is none yet."""
    around: ControllerWrapper | None = None
    inside, lag = controller, 0
    while isinstance(inside, ControllerWrapper) and isinstance(inside, kind.beneath):
        lag = 1 if isinstance(inside, LocalClockWrapper) else lag
        around, inside = inside, inside.controller
    if isinstance(inside, kind):
        return controller, inside
    found = kind(inside, lattice, seed, lag=lag)
    if around is None:
        return found, found
    around.controller = found
    return controller, found
