"""Faults of a small array, as a scene would schedule them."""

from __future__ import annotations

from typing import Any

from pydantic import TypeAdapter

from bus.fault import FaultSpec, Injected
from bus.lattice import NEVER, Lattice
from cell_firmware.faults.base import CellFault
from deploy.faults.registry import Fault

_FAULT: TypeAdapter[FaultSpec] = TypeAdapter(Fault)


def struck(
    lattice: Lattice, *faults: dict[str, Any], first: int = 0, end: int = NEVER, seed: int = 0
) -> list[Injected[CellFault]]:
    """Faults by their tables; ``first`` and ``end`` are ticks, of all of them that do not say so themselves."""
    found: list[Injected[CellFault]] = []
    for number, table in enumerate(faults):
        data = dict(table)
        times = data.pop("first", first), data.pop("end", end)
        fault = _FAULT.validate_python(data)
        assert isinstance(fault, CellFault)
        found.append(Injected(number, fault, fault.struck(lattice, seed, number), *times))
    return found
