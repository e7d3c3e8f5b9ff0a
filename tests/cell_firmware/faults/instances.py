"""Faults of a small array, as a scene would schedule them."""

from __future__ import annotations

from typing import Any

from pydantic import TypeAdapter

from bus.fault import FaultInstance, FaultSpec
from bus.lattice import NO_TICK_LIMIT, Lattice
from cell_firmware.faults.base import CellFault
from deploy.faults.registry import Fault

_FAULT: TypeAdapter[FaultSpec] = TypeAdapter(Fault)


def instances(
    lattice: Lattice, *faults: dict[str, Any], first: int = 0, end: int = NO_TICK_LIMIT, seed: int = 0
) -> list[FaultInstance[CellFault]]:
    """Faults by their tables; ``first`` and ``end`` are ticks, of all of them that do not say so themselves."""
    found: list[FaultInstance[CellFault]] = []
    for number, table in enumerate(faults):
        data = dict(table)
        times = data.pop("first", first), data.pop("end", end)
        fault = _FAULT.validate_python(data)
        assert isinstance(fault, CellFault)
        found.append(FaultInstance(number, fault, fault.affected_cells(lattice, seed, number), *times))
    return found
