"""Controllers around that of the cells which carry out faults, and how a fault comes to the one that does."""

from __future__ import annotations

from typing import ClassVar, TypeVar

from bus.fault import Injected
from bus.lattice import Lattice
from cell_firmware.around import Around
from cell_firmware.clocked import Clocked
from cell_firmware.controller import Controller, ControllerState
from cell_firmware.faults.fault import CellFault
from cell_firmware.firmware import Cells, Floats


class FaultAround(Around):
    """Base of what carries out faults around the cells' controller.

    Args:
        controller: Of the cells.
        lattice: Of the array.
        seed: The scene's.
        lag: By how many ticks an instant is older than the exchange in which its cells are stepped: 1 where cells have
            clocks of their own.

    Attributes:
        faults: What it carries out.
    """

    beneath: ClassVar[tuple[type[Around], ...]]
    """What goes around it."""

    def __init__(self, controller: Controller, lattice: Lattice, seed: int = 0, *, lag: int = 0) -> None:
        super().__init__(controller)
        self.lattice = lattice
        self.seed = seed
        self.lag = lag
        self.faults: list[Injected[CellFault]] = []

    def add(self, fault: Injected[CellFault]) -> None:
        """One more, from its first tick on."""
        self.faults.append(fault)

    def init(self, cells: Cells) -> ControllerState:
        """The state before tick 0."""
        return self.begin(self.controller.init(cells))

    def begin(self, inner: ControllerState, drive: Floats | None = None) -> ControllerState:
        """The state of cells that no fault has struck so far.

        Args:
            inner: Their other parts.
            drive: ``(n, 2)``, what they drive; None: nothing yet.
        """
        raise NotImplementedError


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
        from cell_firmware.faults.slowed import Slowed

        kinds.append(Slowed)
    if fault.pauses:
        from cell_firmware.faults.outages import Outages

        kinds.append(Outages)
    if fault.damages and talks:
        from cell_firmware.faults.words import Words

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
