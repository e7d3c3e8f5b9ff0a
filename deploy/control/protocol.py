"""Live faults as cells are told of them: the text of a control record, written by the plant, read by every worker."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, Final, cast

from pydantic import Field, ValidationError

from bus.errors import WireError
from bus.fault import FaultSpec, Injected
from bus.lattice import NEVER
from bus.spec import Spec
from bus.wire.msgpack_codec import TICK_LIMIT
from cell_firmware.faults.base import CellFault
from deploy.faults.registry import Fault
from deploy.scenes.errors import strictly

if TYPE_CHECKING:
    from bus.wire.frames import Control
    from cell_firmware.effects.base import Site
    from cell_firmware.shard import Shard
    from deploy.scenes.scene import Scene

_Whole = Annotated[int, Field(ge=0, lt=TICK_LIMIT)]


class _Told(Spec):
    """A fault that begins."""

    number: _Whole
    fault: Fault
    first: _Whole
    end: _Whole | None


class _Repaired(Spec):
    """A fault that is over."""

    number: _Whole
    end: _Whole


_SPOILT: Final = (ValueError, TypeError, RecursionError)


def told(one: Injected[FaultSpec]) -> dict[str, Any]:
    """A live fault in JSON's types."""
    fault = one.fault.model_dump(mode="json", exclude_none=True, exclude={"at_s", "until_s"})
    end = None if one.end == NEVER else one.end
    return {"number": one.number, "fault": fault, "first": one.first, "end": end}


def heard(data: Mapping[str, Any], scene: Scene) -> Injected[FaultSpec]:
    """The same fault from that; of the same scene it strikes the same cells.

    Raises:
        ValueError: It is no fault, or none of this scene's array.
    """
    one = strictly(_Told, data)
    fault, lattice = cast("FaultSpec", one.fault), scene.lattice()
    if any(True for _ in fault.misplaced(lattice)):
        raise ValueError("it names cells that are not in the array")
    struck = fault.struck(lattice, scene.seed, one.number)
    return Injected(one.number, fault, struck, one.first, NEVER if one.end is None else one.end, live=True)


def read(control: Control, scene: Scene) -> Injected[FaultSpec] | tuple[int, int]:
    """What a control record of kind ``fault`` says: a fault, or the number of one and the tick from which it is over.

    Raises:
        WireError: Neither.
    """
    try:
        data: object = json.loads(control.detail)
        if isinstance(data, dict) and "fault" in data:
            return heard(cast("Mapping[str, Any]", data), scene)
        repaired = strictly(_Repaired, data)
    except _SPOILT as error:
        why = error.errors()[0]["msg"] if isinstance(error, ValidationError) else str(error)
        raise WireError("control", "fault", f"is no fault, nor a repair: {why}") from None
    return repaired.number, repaired.end


def carry_out(control: Control, scene: Scene, shard: Shard, site: Site) -> None:
    """Let a shard's cells suffer what a control record says, or be repaired.

    Raises:
        WireError: See ``read``.
    """
    one = read(control, scene)
    if isinstance(one, tuple):
        shard.repair(*one)
    elif isinstance(one.fault, CellFault):
        shard.inject(cast("Injected[CellFault]", one), site, scene.lattice())
