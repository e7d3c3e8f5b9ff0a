"""Live faults as cells are told of them: the text of a control record, written by the plant, read by every worker."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, cast

from pydantic import TypeAdapter

from bus.fault import FaultSpec, Injected
from bus.lives import NEVER
from cell_firmware.faults.fault import CellFault
from deploy.faults.registry import Fault
from deploy.scene_errors import strictly_any

if TYPE_CHECKING:
    from bus.wire import Control
    from cell_firmware.effects.stage import Site
    from cell_firmware.shard import Shard
    from deploy.scene import Scene

_FAULT: TypeAdapter[FaultSpec] = TypeAdapter(Fault)


def told(one: Injected[FaultSpec]) -> dict[str, Any]:
    """A live fault in JSON's types."""
    fault = one.fault.model_dump(mode="json", exclude_none=True, exclude={"at_s", "until_s"})
    end = None if one.end == NEVER else one.end
    return {"number": one.number, "fault": fault, "first": one.first, "end": end}


def heard(data: Mapping[str, Any], scene: Scene) -> Injected[FaultSpec]:
    """The same fault from that; of the same scene it strikes the same cells."""
    fault = strictly_any(_FAULT, data["fault"])
    number, end = int(data["number"]), data["end"]
    struck = fault.struck(scene.lattice(), scene.seed, number)
    last = NEVER if end is None else int(end)
    return Injected(number, fault, struck, int(data["first"]), last, live=True)


def carry_out(control: Control, scene: Scene, shard: Shard, site: Site) -> None:
    """Let a shard's cells suffer what a control record says, or be repaired."""
    data = json.loads(control.detail)
    lattice = scene.lattice()
    if "fault" not in data:
        shard.repair(int(data["number"]), int(data["end"]))
        return
    one = heard(data, scene)
    if isinstance(one.fault, CellFault):
        shard.inject(cast("Injected[CellFault]", one), site, lattice)
