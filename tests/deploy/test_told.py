"""Live faults on their way from the plant to the cells."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from bus.errors import WireError
from bus.fault import FaultInstance
from bus.lattice import NO_TICK_LIMIT
from bus.wire.frames import Control
from cell_firmware.faults.kinds.hang import HangFault
from deploy.control.protocol import apply_to_shard, decode_fault, decode_fault_control, encode_fault
from deploy.scenes.files import load_scene
from plant.faults.kinds.wheel_stuck import WheelStuckFault

SCENE = load_scene("prototype")
HANG = FaultInstance(
    3, HangFault(cell=(1, 1)), np.array([SCENE.lattice().index((1, 1))]), 5, 9, injected_at_runtime=True
)


def _control(detail: object) -> Control:
    return Control("fault", 5, (), detail if isinstance(detail, str) else json.dumps(detail))


@pytest.mark.parametrize(("end", "word"), [(9, 9), (NO_TICK_LIMIT, None)])
def test_a_fault_is_heard_as_it_was_told(end: int, word: int | None) -> None:
    one = FaultInstance(3, HangFault(cell=(1, 1)), HANG.cells, 5, end, injected_at_runtime=True)
    words = encode_fault(one)
    assert words == {"number": 3, "fault": {"kind": "hang", "cell": [1, 1]}, "first": 5, "end": word}
    back = decode_fault(words, SCENE)
    assert (back.number, back.fault, back.start_tick, back.end_tick, back.injected_at_runtime) == (
        3,
        one.fault,
        5,
        end,
        True,
    )
    assert back.cells.tolist() == one.cells.tolist()


def test_a_fault_of_cells_that_are_not_there_is_none() -> None:
    outside = {**encode_fault(HANG), "fault": {"kind": "hang", "rectangle": [[90, 90], [99, 99]]}}
    with pytest.raises(ValueError, match="names cells that are not in the array"):
        decode_fault(outside, SCENE)


@pytest.mark.parametrize(
    ("detail", "why"),
    [
        ([], "Input should be"),
        (["fault"], "Input should be"),
        ({"number": 3}, "Field required"),
        ({"number": 3, "end": -1}, "greater than or equal to 0"),
        (
            {**encode_fault(HANG), "fault": {"kind": "hang", "cell": [99, 1]}},
            "cells that are not in the array",
        ),
        ("[" * 100_000, "recursion"),
        ("{", "Expecting"),
    ],
)
def test_what_is_no_fault_is_refused_with_why(detail: object, why: str) -> None:
    with pytest.raises(WireError, match=rf"neither a fault nor a repair: .*{why}"):
        decode_fault_control(_control(detail), SCENE)


def test_cells_carry_out_faults_of_cells_and_repairs_and_leave_the_plant_its_own() -> None:
    done: list[Any] = []
    shard = SimpleNamespace(
        repair=lambda *which: done.append(which), inject=lambda one, *_: done.append(one.number)
    )
    stuck = FaultInstance(
        4, WheelStuckFault(kind="wheel_stuck", cell=(1, 1)), HANG.cells, 5, injected_at_runtime=True
    )
    for detail in (encode_fault(HANG), encode_fault(stuck), {"number": 3, "end": 7}):
        apply_to_shard(_control(detail), SCENE, cast("Any", shard), cast("Any", None))
    assert done == [3, (3, 7)]
