"""Attachment of faults to a controller by wrappers, and faults injected at run time, from control records."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple, TypeVar, cast, final

from pydantic import ValidationError

from bus.errors import WireError
from bus.fault import FaultInstance, RepairRecord, build_validators, decode_fault, transition_ticks
from bus.lattice import NO_TICK_LIMIT, Lattice
from bus.wire.frames import Control
from cell_firmware.controller import Controller, ControllerState, ControllerWrapper, read_only
from cell_firmware.effects.base import InputFilter, ShardContext
from cell_firmware.effects.clock.wrapper import LocalClockWrapper
from cell_firmware.effects.cop.wrapper import WatchdogWrapper
from cell_firmware.faults.base import CellFault, FaultFilter, FaultWrapper
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


class Form(NamedTuple):
    """Form in which the cells of a shard are stepped.

    Attributes:
        wrapped: Whether a fault acts on a cell, or has an effect still: the wrappers of faults are needed.
        filtered: Whether a fault acts on what cells sense or receive: its input filters are needed.
        end_tick: First tick in which the form may be another, unless a fault is injected or repaired before.
    """

    wrapped: bool
    filtered: bool
    end_tick: int


@final
class ShardFaults:
    """Faults of a run on the cells of a shard, and the decision in which ticks their wrappers and filters are needed.

    A controller with a fault's wrappers has no compiled form. In ticks in which no fault acts on a cell of the shard
    its wrappers would only refuse implausible messages, which the compiled form does as well
    (``cell_firmware.refusals``). It leaves the wrappers' part of the state as it is, for registers and counters.

    Args:
        controller: Controller with the wrappers of all faults.
        faults: The faults.
        filters: Their input filters.
        lattice: Lattice of the array.

    Attributes:
        controller: Controller with the wrappers of all faults.
    """

    def __init__(
        self,
        controller: Controller,
        faults: Iterable[FaultInstance[CellFault]],
        filters: Iterable[InputFilter],
        lattice: Lattice,
    ) -> None:
        self.controller = controller
        self._faults = {one.number: one for one in faults}
        self._filters = [one for one in filters if isinstance(one, FaultFilter)]
        self._lattice = lattice

    @property
    def _wrappers(self) -> Iterator[FaultWrapper]:
        inside = self.controller
        while isinstance(inside, ControllerWrapper):
            if isinstance(inside, FaultWrapper):
                yield inside
            inside = inside.controller

    def form(self, tick: int, state: ControllerState) -> Form:
        """Decide in which form the cells are stepped from a tick on.

        Args:
            tick: The tick.
            state: Of the live cells, before it.
        """
        cells = self._lattice.find(state.cells.row, state.cells.column)
        wrapped = any(
            one.acts_at(tick, cells) or not one.is_settled(tick, state.parts[one.part])
            for one in self._wrappers
        )
        filtered = any(one.acts_at(tick) for one in self._filters)
        end_tick = tick + 1  # what a fault has left behind ends in any tick
        if not (wrapped or filtered):
            later = (one for one in transition_ticks([*self._faults.values()]) if one > tick)
            end_tick = min(later, default=NO_TICK_LIMIT)
        return Form(wrapped, filtered, end_tick)

    def catch_up(self, state: ControllerState, drive: Floats) -> ControllerState:
        """Return the state after ticks in which the wrappers were left out.

        Args:
            state: Of n cells.
            drive: ``(n, 2)``, their current drives.
        """
        parts = dict(state.parts)
        for one in self._wrappers:
            parts[one.part] = read_only(one.catch_up(parts[one.part], drive))
        return ControllerState(state.cells, parts)

    def inject(
        self, fault: FaultInstance[CellFault], site: ShardContext, *, link_ticks: int
    ) -> tuple[FaultFilter, ...]:
        """Inject a fault; ``begin`` then adds its state.

        Args:
            fault: The fault.
            site: The shard's cells.
            link_ticks: Ticks after which a message is read.

        Returns:
            Its input filters.
        """
        filters = tuple(fault.fault.input_filters(site, self._lattice, fault))
        self._faults[fault.number] = fault
        self._filters += filters
        self.controller = attach_fault(
            self.controller, self._lattice, site.seed, fault, link_ticks=link_ticks
        )
        return filters

    def begin(self, state: ControllerState, drive: Floats) -> ControllerState:
        """Add the state of wrappers, and of their faults, that were attached to the controller of running cells.

        Args:
            state: Of n cells.
            drive: ``(n, 2)``, their current drives.
        """
        for one in self._wrappers:
            own = state.parts.get(one.part, {})
            begun = one.begin(one.unwrap_state(state), drive).parts[one.part]
            if begun.keys() != own.keys():
                state = one.wrap_state(one.unwrap_state(state), {**begun, **own})
        return state

    def repair(self, number: int, tick: int) -> None:
        """End a fault at ``tick``; an unknown fault is ignored."""
        if number in self._faults:
            self._faults[number].end_tick = tick


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
