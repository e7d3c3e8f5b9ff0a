"""Live faults on their way from the plant to the cells."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from bus.errors import WireError
from bus.fault import Injected
from bus.lattice import NEVER
from bus.wire.frames import Control
from cell_firmware.faults.kinds.hang import HangFault
from deploy.control.protocol import carry_out, heard, read, told
from deploy.scenes.files import load_scene
from plant.faults.kinds.wheel_stuck import WheelStuckFault

SCENE = load_scene("prototype")
HANG = Injected(3, HangFault(cell=(1, 1)), np.array([SCENE.lattice().index((1, 1))]), 5, 9, live=True)


def _control(detail: object) -> Control:
    return Control("fault", 5, (), detail if isinstance(detail, str) else json.dumps(detail))


@pytest.mark.parametrize(("end", "word"), [(9, 9), (NEVER, None)])
def test_a_fault_is_heard_as_it_was_told(end: int, word: int | None) -> None:
    one = Injected(3, HangFault(cell=(1, 1)), HANG.cells, 5, end, live=True)
    words = told(one)
    assert words == {"number": 3, "fault": {"kind": "hang", "cell": [1, 1]}, "first": 5, "end": word}
    back = heard(words, SCENE)
    assert (back.number, back.fault, back.first, back.end, back.live) == (3, one.fault, 5, end, True)
    assert back.cells.tolist() == one.cells.tolist()


def test_a_fault_of_cells_that_are_not_there_is_none() -> None:
    outside = {**told(HANG), "fault": {"kind": "hang", "rectangle": [[90, 90], [99, 99]]}}
    with pytest.raises(ValueError, match="names cells that are not in the array"):
        heard(outside, SCENE)


@pytest.mark.parametrize(
    ("detail", "why"),
    [
        ([], "Input should be"),
        (["fault"], "Input should be"),
        ({"number": 3}, "Field required"),
        ({"number": 3, "end": -1}, "greater than or equal to 0"),
        ({**told(HANG), "fault": {"kind": "hang", "cell": [99, 1]}}, "cells that are not in the array"),
        ("[" * 100_000, "recursion"),
        ("{", "Expecting"),
    ],
)
def test_what_is_no_fault_is_refused_with_why(detail: object, why: str) -> None:
    with pytest.raises(WireError, match=rf"no fault, nor a repair: .*{why}"):
        read(_control(detail), SCENE)


def test_cells_carry_out_faults_of_cells_and_repairs_and_leave_the_plant_its_own() -> None:
    done: list[Any] = []
    shard = SimpleNamespace(
        repair=lambda *which: done.append(which), inject=lambda one, *_: done.append(one.number)
    )
    stuck = Injected(4, WheelStuckFault(kind="wheel_stuck", cell=(1, 1)), HANG.cells, 5, live=True)
    for detail in (told(HANG), told(stuck), {"number": 3, "end": 7}):
        carry_out(_control(detail), SCENE, cast("Any", shard), cast("Any", None))
    assert done == [3, (3, 7)]
