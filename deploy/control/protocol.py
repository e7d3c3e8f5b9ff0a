"""Live faults as cells are told of them: the text of a control record, written by the plant, read by every worker."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, Final, cast

from pydantic import Field, ValidationError

from bus.errors import WireError
from bus.fault import FaultInstance, FaultSpec
from bus.lattice import NO_TICK_LIMIT
from bus.spec import Spec
from bus.wire.msgpack_codec import TICK_LIMIT
from cell_firmware.faults.base import CellFault
from deploy.faults.registry import Fault
from deploy.scenes.errors import strictly

if TYPE_CHECKING:
    from bus.wire.frames import Control
    from cell_firmware.effects.base import ShardContext
    from cell_firmware.shard import Shard
    from deploy.scenes.scene import Scene

_Whole = Annotated[int, Field(ge=0, lt=TICK_LIMIT)]


class _FaultRecord(Spec):
    """A fault that begins."""

    number: _Whole
    fault: Fault
    first: _Whole
    end: _Whole | None


class _RepairRecord(Spec):
    """A fault that is over."""

    number: _Whole
    end: _Whole


_SPOILT: Final = (ValueError, TypeError, RecursionError)


def encode_fault(one: FaultInstance[FaultSpec]) -> dict[str, Any]:
    """A live fault in JSON's types."""
    fault = one.fault.model_dump(mode="json", exclude_none=True, exclude={"at_s", "until_s"})
    end = None if one.end_tick == NO_TICK_LIMIT else one.end_tick
    return {"number": one.number, "fault": fault, "first": one.start_tick, "end": end}


def decode_fault(data: Mapping[str, Any], scene: Scene) -> FaultInstance[FaultSpec]:
    """The same fault from that; of the same scene it strikes the same cells.

    Raises:
        ValueError: It is no fault, or none of this scene's array.
    """
    one = strictly(_FaultRecord, data)
    fault, lattice = cast("FaultSpec", one.fault), scene.lattice()
    if any(True for _ in fault.problems(lattice)):
        raise ValueError("it names cells that are not in the array")
    struck = fault.affected_cells(lattice, scene.seed, one.number)
    return FaultInstance(
        one.number,
        fault,
        struck,
        one.first,
        NO_TICK_LIMIT if one.end is None else one.end,
        injected_at_runtime=True,
    )


def decode_fault_control(control: Control, scene: Scene) -> FaultInstance[FaultSpec] | tuple[int, int]:
    """What a control record of kind ``fault`` says: a fault, or the number of one and the tick from which it is over.

    Raises:
        WireError: Neither.
    """
    try:
        data: object = json.loads(control.detail)
        if isinstance(data, dict) and "fault" in data:
            return decode_fault(cast("Mapping[str, Any]", data), scene)
        repaired = strictly(_RepairRecord, data)
    except _SPOILT as error:
        why = error.errors()[0]["msg"] if isinstance(error, ValidationError) else str(error)
        raise WireError("control", "fault", f"is no fault, nor a repair: {why}") from None
    return repaired.number, repaired.end


def apply_to_shard(control: Control, scene: Scene, shard: Shard, site: ShardContext) -> None:
    """Let a shard's cells suffer what a control record says, or be repaired.

    Raises:
        WireError: See ``read``.
    """
    one = decode_fault_control(control, scene)
    if isinstance(one, tuple):
        shard.repair(*one)
    elif isinstance(one.fault, CellFault):
        shard.inject(cast("FaultInstance[CellFault]", one), site, scene.lattice())
