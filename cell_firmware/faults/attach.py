"""Attachment of faults to a controller by wrappers, and faults injected at run time, from control records."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterable
from typing import Any, Final, TypeVar, cast, final

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from bus.errors import WireError
from bus.fault import FaultInstance, RepairRecord, build_validators, decode_fault
from bus.lattice import Lattice
from bus.wire.frames import Control
from cell_firmware.controller import Controller, ControllerState, ControllerWrapper
from cell_firmware.effects.clock.wrapper import LocalClockWrapper
from cell_firmware.effects.cop.wrapper import WatchdogWrapper
from cell_firmware.faults.base import CellFault, FaultWrapper
from cell_firmware.faults.execution import ClockFaultWrapper, ExecutionFaultWrapper
from cell_firmware.faults.messages import MessageFaultWrapper
from cell_firmware.firmware import Floats

_Kind = TypeVar("_Kind", bound=FaultWrapper)

WRAPPERS: Final[tuple[type[ControllerWrapper], ...]] = (
    LocalClockWrapper,
    ClockFaultWrapper,
    WatchdogWrapper,
    ExecutionFaultWrapper,
    MessageFaultWrapper,
)
"""All wrappers of a controller, from the outermost to the innermost."""


def prepare() -> None:
    """Import and build what decoding a fault needs.

    Hundreds of processes would do so in the tick in which the first is injected, and be behind for seconds.
    """
    from cell_firmware.faults.registry import CELL_FAULTS

    build_validators(CELL_FAULTS)


def decode_fault_control(
    control: Control, lattice: Lattice, seed: int
) -> FaultInstance[CellFault] | tuple[int, int]:
    """Decode a control record of kind ``fault``.

    Args:
        control: The record.
        lattice: Lattice of the array.
        seed: Seed of the scene.

    Returns:
        The fault that begins; of a repair, the fault's number and the tick from which it is over.

    Raises:
        WireError: The record is neither a fault of cells nor a repair.
    """
    from cell_firmware.faults.registry import CELL_FAULTS

    try:
        data: object = json.loads(control.detail)
        if isinstance(data, dict) and "fault" in data:
            record = cast("dict[str, object]", data)
            return cast("FaultInstance[CellFault]", decode_fault(record, CELL_FAULTS, lattice, seed))
        repair = RepairRecord.model_validate_json(control.detail, strict=True)
    except (ValueError, TypeError, RecursionError) as error:
        why = error.errors()[0]["msg"] if isinstance(error, ValidationError) else str(error)
        raise WireError("control", "fault", f"is neither a fault nor a repair: {why}") from None
    return repair.number, repair.end


def attach_fault(
    controller: Controller,
    lattice: Lattice,
    seed: int,
    fault: FaultInstance[CellFault],
    *,
    link_ticks: int = 1,
) -> Controller:
    """Attach a fault to a controller: extend the wrappers that exist, and insert those that are missing.

    Args:
        controller: Controller of the cells.
        lattice: Lattice of the array.
        seed: Seed of the scene.
        fault: The fault.
        link_ticks: Ticks after which a message is read.

    Returns:
        The outermost controller.
    """
    for kind in _kinds(fault.fault, talks=controller.message_type is not None):
        controller, found = _found(controller, kind, lattice, seed, link_ticks)
        found.add(fault)
    return controller


def acts_on(fault: FaultInstance[CellFault], cells: NDArray[np.int64], *, talks: bool) -> bool:
    """Whether a fault needs its wrappers around the controller of these cells, indices into the lattice.

    Corrupted messages do everywhere: what a program makes of one may be implausible to cells far away.

    Args:
        fault: The fault.
        cells: The cells.
        talks: Whether programs send messages.
    """
    kinds = _kinds(fault.fault, talks=talks)
    return MessageFaultWrapper in kinds or bool(kinds and np.isin(fault.cells, cells).any())


def without_faults(controller: Controller) -> Controller:
    """Return a copy of a controller's wrappers without those of faults, around the same board."""
    if not isinstance(controller, ControllerWrapper):
        return controller
    inside = without_faults(controller.controller)
    if isinstance(controller, FaultWrapper):
        return inside
    copied = copy.copy(controller)
    copied.controller = inside
    return copied


def init_new_wrappers(controller: Controller, state: ControllerState, drive: Floats) -> ControllerState:
    """Add the state of wrappers, and of their faults, that were attached to a running controller.

    Args:
        controller: The running controller.
        state: State of n cells.
        drive: ``(n, 2)``, current drives.
    """
    inside = controller
    while isinstance(inside, ControllerWrapper):
        if isinstance(inside, FaultWrapper):
            own = state.parts.get(inside.part, {})
            begun = inside.begin(inside.unwrap_state(state), drive).parts[inside.part]
            if begun.keys() != own.keys():
                state = inside.wrap_state(inside.unwrap_state(state), {**begun, **own})
        inside = inside.controller
    return state


@final
class ShardFaults:
    """Faults of a run on the cells of a shard.

    A controller with a fault's wrappers has no compiled form. So only a shard on whose cells a fault acts steps them
    with its wrappers; in the others these would change nothing. Registers and counters are those of all wrappers
    everywhere.

    Args:
        controller: Controller with the wrappers of all faults.
        faults: The faults.
        cells: ``(n,)``, the shard's cells, by index into the lattice.

    Attributes:
        stepped: Controller to step the cells with.
    """

    def __init__(
        self, controller: Controller, faults: Iterable[FaultInstance[CellFault]], cells: NDArray[np.int64]
    ) -> None:
        self._faults = {one.number: one for one in faults}
        self._cells = cells
        self._talks = controller.message_type is not None
        self._whole = self.stepped = controller
        if self._faults and not self._acts(self._faults.values()):
            self.stepped = without_faults(controller)

    def _acts(self, faults: Iterable[FaultInstance[Any]]) -> bool:
        return any(acts_on(fault, self._cells, talks=self._talks) for fault in faults)

    def inject(
        self, fault: FaultInstance[CellFault], lattice: Lattice, seed: int, *, link_ticks: int
    ) -> bool:
        """Inject a fault.

        Args:
            fault: The fault.
            lattice: Lattice of the array.
            seed: The scene's.
            link_ticks: Ticks after which a message is read.

        Returns:
            Whether ``stepped`` is another controller now, which takes a state from ``shown``.
        """
        self._faults[fault.number] = fault
        if not self.apart and not self._acts(self._faults.values()):
            self._whole = without_faults(self._whole)  # the other one stays as it is
        self._whole = attach_fault(self._whole, lattice, seed, fault, link_ticks=link_ticks)
        if not self._acts((fault,)):
            return False
        self.stepped = self._whole
        return True

    def repair(self, number: int, tick: int) -> None:
        """End a fault at ``tick``; an unknown fault is ignored."""
        if number in self._faults:
            self._faults[number].end_tick = tick

    def shown(self, state: ControllerState, drive: Floats) -> tuple[Controller, ControllerState]:
        """Return the controller with all wrappers, and a state of it.

        Args:
            state: Of n cells, as the controller has it that is stepped.
            drive: ``(n, 2)``, their current drives.
        """
        return self._whole, init_new_wrappers(self._whole, state, drive)

    @property
    def apart(self) -> bool:
        """Whether the controller that is stepped lacks wrappers."""
        return self.stepped is not self._whole


def _kinds(fault: CellFault, *, talks: bool) -> list[type[FaultWrapper]]:
    """Return the wrapper types that a fault needs; none where input filters suffice."""
    kinds: list[type[FaultWrapper]] = []
    if fault.skips_periods:
        kinds.append(ClockFaultWrapper)
    if fault.halts_program:
        kinds.append(ExecutionFaultWrapper)
    if fault.corrupts_messages and talks:
        kinds.append(MessageFaultWrapper)
    return kinds


def _found(
    controller: Controller, kind: type[_Kind], lattice: Lattice, seed: int, link_ticks: int
) -> tuple[Controller, _Kind]:
    """Return a controller and its wrapper of type ``kind``; insert a wrapper if there is none."""
    outer = WRAPPERS[: WRAPPERS.index(kind)]
    around: ControllerWrapper | None = None
    inside, lag = controller, 0
    while isinstance(inside, ControllerWrapper) and isinstance(inside, outer):
        lag = 1 if isinstance(inside, LocalClockWrapper) else lag
        around, inside = inside, inside.controller
    if isinstance(inside, kind):
        return controller, inside
    found = kind(inside, lattice, seed, lag=lag, link_ticks=link_ticks)
    if around is None:
        return found, found
    around.controller = found
    return controller, found
