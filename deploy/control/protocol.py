"""Encoding of live faults in control records, which the plant writes and every worker reads."""

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
    """Content of a control record that begins a fault."""

    number: _Whole
    fault: Fault
    first: _Whole
    end: _Whole | None


class _RepairRecord(Spec):
    """Content of a control record that ends a fault."""

    number: _Whole
    end: _Whole


_SPOILT: Final = (ValueError, TypeError, RecursionError)


def encode_fault(one: FaultInstance[FaultSpec]) -> dict[str, Any]:
    """Encode a live fault in JSON's types."""
    fault = one.fault.model_dump(mode="json", exclude_none=True, exclude={"at_s", "until_s"})
    end = None if one.end_tick == NO_TICK_LIMIT else one.end_tick
    return {"number": one.number, "fault": fault, "first": one.start_tick, "end": end}


def decode_fault(data: Mapping[str, Any], scene: Scene) -> FaultInstance[FaultSpec]:
    """Decode a live fault; with the same scene, the fault affects the same cells.

    Raises:
        ValueError: The data are no fault, or name cells outside this scene's array.
    """
    one = strictly(_FaultRecord, data)
    fault, lattice = cast("FaultSpec", one.fault), scene.lattice()
    if any(True for _ in fault.problems(lattice)):
        raise ValueError("the fault names cells that are not in the array")
    affected = fault.affected_cells(lattice, scene.seed, one.number)
    return FaultInstance(
        one.number,
        fault,
        affected,
        one.first,
        NO_TICK_LIMIT if one.end is None else one.end,
        injected_at_runtime=True,
    )


def decode_fault_control(control: Control, scene: Scene) -> FaultInstance[FaultSpec] | tuple[int, int]:
    """Decode a control record of kind ``fault``.

    Returns:
        The fault that begins; of a repair, the fault's number and the tick from which it is over.

    Raises:
        WireError: The record is neither a fault nor a repair.
    """
    try:
        data: object = json.loads(control.detail)
        if isinstance(data, dict) and "fault" in data:
            return decode_fault(cast("Mapping[str, Any]", data), scene)
        repaired = strictly(_RepairRecord, data)
    except _SPOILT as error:
        why = error.errors()[0]["msg"] if isinstance(error, ValidationError) else str(error)
        raise WireError("control", "fault", f"is neither a fault nor a repair: {why}") from None
    return repaired.number, repaired.end


def apply_to_shard(control: Control, scene: Scene, shard: Shard, site: ShardContext) -> None:
    """Begin or repair a fault on a shard's cells, as a control record says.

    Raises:
        WireError: See ``decode_fault_control``.
    """
    one = decode_fault_control(control, scene)
    if isinstance(one, tuple):
        shard.repair(*one)
    elif isinstance(one.fault, CellFault):
        shard.inject(cast("FaultInstance[CellFault]", one), site, scene.lattice())
