"""Faults injected at run time, as control records tell a shard of them."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any, cast

import pytest

from bus.errors import WireError
from bus.fault import FaultInstance, FaultSpec, decode_fault
from bus.lattice import NO_TICK_LIMIT, Lattice
from bus.wire.frames import Control
from cell_firmware import agent
from cell_firmware.faults.attach import decode_fault_control
from cell_firmware.faults.base import CellFault
from cell_firmware.faults.kinds.hang import HangFault
from cell_firmware.faults.registry import CELL_FAULTS
from deploy.faults.crash import CrashFault
from deploy.faults.modules import RemoveFault
from deploy.faults.registry import KINDS
from plant.faults.kinds.wheel_stuck import WheelStuckFault

LATTICE = Lattice((row, column) for row in range(3) for column in range(4))
SEED = 5


def fault_of(spec: FaultSpec, number: int = 3, end: int = 9) -> FaultInstance[FaultSpec]:
    affected = spec.affected_cells(LATTICE, SEED, number)
    return FaultInstance(number, spec, affected, 5, end, injected_at_runtime=True)


HANG = fault_of(HangFault(cell=(1, 1)))
STUCK = fault_of(WheelStuckFault(kind="wheel_stuck", cell=(1, 1)), 4)


def control(detail: object) -> Control:
    return Control("fault", 5, (), detail if isinstance(detail, str) else json.dumps(detail))


@pytest.mark.parametrize(("end", "told"), [(9, 9), (NO_TICK_LIMIT, None)])
def test_a_fault_is_decoded_as_it_was_encoded(end: int, told: int | None) -> None:
    one = fault_of(HangFault(cell=(1, 1)), end=end)
    record = one.record()
    assert record == {"number": 3, "fault": {"kind": "hang", "cell": [1, 1]}, "first": 5, "end": told}
    back = decode_fault(record, CELL_FAULTS, LATTICE, SEED)
    assert (back.number, back.fault, back.start_tick, back.end_tick) == (3, one.fault, 5, end)
    assert back.injected_at_runtime
    assert back.cells.tolist() == one.cells.tolist()


def test_every_kind_that_acts_in_cells_and_can_be_injected_is_known_to_the_cells() -> None:
    ours = {kind.kind_name for kind in KINDS.values() if issubclass(kind, CellFault)} - {"add"}
    told = CELL_FAULTS.json_schema()["discriminator"]["mapping"]
    assert told.keys() == ours


@pytest.mark.parametrize(
    "spec",
    [
        CrashFault(cells=((0, 1), (2, 3))),
        CrashFault(share=0.5, wheels="hold"),
        RemoveFault(kind="remove", cell=(1, 1)),
    ],
    ids=lambda spec: spec.kind_name,
)
def test_what_strikes_plant_and_cells_strikes_the_same_cells_in_both(spec: CrashFault | RemoveFault) -> None:
    one = fault_of(spec)
    back = decode_fault_control(control(one.record()), LATTICE, SEED)
    assert isinstance(back, FaultInstance)
    assert back.cells.tolist() == one.cells.tolist()
    assert back.fault.kind_name == spec.kind_name
    assert back.fault.halts_program


def test_a_fault_of_cells_that_are_not_there_is_none() -> None:
    outside = {**HANG.record(), "fault": {"kind": "hang", "rectangle": [[90, 90], [99, 99]]}}
    with pytest.raises(ValueError, match="names cells that are not in the array"):
        decode_fault(outside, CELL_FAULTS, LATTICE, SEED)


@pytest.mark.parametrize(
    ("detail", "why"),
    [
        ([], "Input should be"),
        (["fault"], "Input should be"),
        ({"number": 3}, "Field required"),
        ({"number": 3, "end": -1}, "greater than or equal to 0"),
        ({**HANG.record(), "fault": {"kind": "hang", "cell": [99, 1]}}, "cells that are not in the array"),
        ({**HANG.record(), "fault": {"kind": "hang", "cell": [1, 1], "colour": 3}}, "Extra inputs"),
        ({**HANG.record(), "fault": ["hang"]}, "Input should be"),
        (STUCK.record(), "expected tags"),
        ("[" * 100_000, "recursion"),
        ("{", "Expecting"),
    ],
)
def test_what_is_no_fault_of_cells_is_refused_with_why(detail: object, why: str) -> None:
    with pytest.raises(WireError, match=rf"neither a fault nor a repair: .*{why}"):
        decode_fault_control(control(detail), LATTICE, SEED)


def test_a_shard_begins_and_repairs_faults_as_it_is_told() -> None:
    done: list[Any] = []
    shard = SimpleNamespace(
        repair=lambda *which: done.append(which), inject=lambda one, *_: done.append(one.number)
    )
    inject = agent.injector(cast("Any", shard), cast("Any", SimpleNamespace(seed=SEED)), LATTICE)
    for detail in (HANG.record(), {"number": 3, "end": 7}):
        inject(control(detail))
    assert done == [3, (3, 7)]
