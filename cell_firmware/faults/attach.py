"""How a fault comes to what carries it out: a controller around that of the cells."""

from __future__ import annotations

from typing import TypeVar

from bus.fault import Injected
from bus.lattice import Lattice
from cell_firmware.controller import Around, Controller, ControllerState
from cell_firmware.effects.clock.wrapper import Clocked
from cell_firmware.faults.base import CellFault, FaultAround
from cell_firmware.firmware import Floats

_Kind = TypeVar("_Kind", bound=FaultAround)


def joined(controller: Controller, lattice: Lattice, seed: int, fault: Injected[CellFault]) -> Controller:
    """A controller that carries out one more fault; it, or what is inside of it, is changed.

    Args:
        controller: Of the cells.
        lattice: Of the array.
        seed: The scene's.
        fault: Which.
    """
    for kind in _kinds(fault.fault, talks=controller.said is not None):
        controller, found = _found(controller, kind, lattice, seed)
        found.add(fault)
    return controller


def begun(controller: Controller, state: ControllerState, drive: Floats) -> ControllerState:
    """The state of a running controller's cells, with what it does not have yet of what was ``joined`` to it.

    Args:
        controller: It.
        state: Of n cells.
        drive: ``(n, 2)``, what they drive.
    """
    inside = controller
    while isinstance(inside, Around):
        if inside.part not in state.parts and isinstance(inside, FaultAround):
            state = inside.begin(state, drive)
        inside = inside.controller
    return state


def _kinds(fault: CellFault, *, talks: bool) -> list[type[FaultAround]]:
    """What carries out a fault, of cells that talk or not; where it is stages alone, nothing."""
    kinds: list[type[FaultAround]] = []
    if fault.slows:
        from cell_firmware.faults.execution import Slowed

        kinds.append(Slowed)
    if fault.pauses:
        from cell_firmware.faults.execution import Outages

        kinds.append(Outages)
    if fault.damages and talks:
        from cell_firmware.faults.messages import Words

        kinds.append(Words)
    return kinds


def _found(
    controller: Controller, kind: type[_Kind], lattice: Lattice, seed: int
) -> tuple[Controller, _Kind]:
    """What carries out faults of a kind inside of a controller; put there if there is none yet."""
    around: Around | None = None
    inside, lag = controller, 0
    while isinstance(inside, Around) and isinstance(inside, kind.beneath):
        lag = 1 if isinstance(inside, Clocked) else lag
        around, inside = inside, inside.controller
    if isinstance(inside, kind):
        return controller, inside
    found = kind(inside, lattice, seed, lag=lag)
    if around is None:
        return found, found
    around.controller = found
    return controller, found
