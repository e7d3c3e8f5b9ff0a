"""Faults in words."""

from __future__ import annotations

from typing import Any

import numpy as np

from bus.fault import FaultInstance
from cell_firmware.faults.kinds.reboot import RebootFault
from deploy.faults.crash import CrashFault
from deploy.faults.records import describe_faults, lost_for_good, out_of_array, plot_marks, transition_records


def fault(kind: str, phase: str, time_s: float, *cells: tuple[int, int], number: int = 0) -> dict[str, Any]:
    return {
        "kind": kind,
        "phase": phase,
        "time_s": time_s,
        "cells": [list(cell) for cell in cells],
        "number": number,
    }


LOST: dict[str, Any] = {"kind": "crash", "time_s": 0.5, "cell": [3, 4], "detail": "scheduled"}
THREE = ((0, 0), (0, 1), (0, 2))
RUN = [
    fault("add", "begins", 0.0, (1, 1), number=3),
    fault("crash", "begins", 1.2, *THREE),
    LOST,
    fault("wheel_stuck", "begins", 1.5, (2, 2), number=1),
    fault("remove", "begins", 1.6, (5, 5), (6, 6), number=2),
    fault("add", "ends", 1.7, (1, 1), number=3),
    fault("crash", "ends", 2.0, *THREE),
    fault("remove", "ends", 2.5, (5, 5), (6, 6), number=2),
    fault("remove", "begins", 3.0, (6, 6), number=4),
]


def test_each_fault_is_a_line_with_its_repair() -> None:
    assert describe_faults(RUN) == [
        "1,1 plugged in at 1.7 s",
        "crash of 3 cells at 1.2 s, repaired at 2 s",
        "3,4 crashed at 0.5 s",
        "wheel stuck of 2,2 at 1.5 s",
        "2 cells pulled at 1.6 s, plugged in again at 2.5 s",
        "6,6 pulled at 3 s",
    ]
    assert describe_faults(RUN[:1]) == ["1,1 not plugged in"]


def test_cells_out_of_the_array_are_described_with_the_time_of_their_return() -> None:
    assert out_of_array(RUN) == {(1, 1): 1.7, (5, 5): 2.5, (6, 6): None}
    both = [fault("remove", "begins", 1.0, (0, 0)), fault("remove", "begins", 2.0, (0, 0), number=1)]
    assert out_of_array([*both, fault("remove", "ends", 3.0, (0, 0))]) == {(0, 0): None}


def test_marks_are_those_of_faults_that_begin_or_end_and_of_cells_that_are_lost() -> None:
    assert plot_marks(RUN) == [
        (1.2, "3 cells: crash"),
        (0.5, "cell 3,4 lost"),
        (1.5, "cell 2,2: wheel stuck"),
        (1.6, "2 cells pulled"),
        (1.7, "cell 1,1 plugged in"),
        (2.0, "3 cells: crash ends"),
        (2.5, "2 cells plugged in"),
        (3.0, "cell 6,6 pulled"),
    ]


def test_cells_that_are_lost_together_share_a_line_and_are_not_lost_for_good_where_they_come_back() -> None:
    gone = [{"kind": "disconnected", "time_s": 0.7, "cell": [row, 0], "detail": ""} for row in range(3)]
    back = {"kind": "respawn", "phase": "happens", "time_s": 0.9, "cell": None, "cells": [[0, 0], [2, 0]]}
    records = [LOST, *gone, back]
    assert describe_faults(records) == [
        "3,4 crashed at 0.5 s",
        "3 cells disconnected at 0.7 s",
        "2 cells rejoined at 0.9 s",
    ]
    assert plot_marks(records) == [(0.5, "cell 3,4 lost"), (0.7, "3 cells lost"), (0.9, "2 cells rejoined")]
    assert lost_for_good(records) == {(3, 4): 0.5, (1, 0): 0.7}
    assert lost_for_good([*records, {**gone[0], "time_s": 1.0}]) == {(3, 4): 0.5, (1, 0): 0.7, (0, 0): 1.0}


def test_a_transition_of_a_fault_is_recorded_with_its_time_and_affected_cells() -> None:
    fault = CrashFault(cells=((0, 1), (2, 3)), at_s=0.01)
    one = FaultInstance(7, fault, np.array([0, 2]), 5, 9)
    names = [(0, 1), (1, 1), (2, 3)]
    (begins,) = transition_records(one, 5, 4_000_000, names)
    assert begins == {
        "time_s": 0.02,
        "kind": "crash",
        "phase": "begins",
        "cell": None,
        "cells": [[0, 1], [2, 3]],
        "tick": 5,
        "detail": "scheduled",
        "fault": {"kind": "crash", "at_s": 0.01, "cells": [[0, 1], [2, 3]]},
        "number": 7,
    }
    assert [record["phase"] for record in transition_records(one, 9, 4_000_000, names)] == ["ends"]
    assert transition_records(one, 7, 4_000_000, names) == []
    one.end_tick = 5
    assert [record["phase"] for record in transition_records(one, 5, 4_000_000, names)] == ["begins", "ends"]
    once = FaultInstance(8, RebootFault(cell=(1, 1)), np.array([1]), 5, 9, injected_at_runtime=True)
    (record,) = transition_records(once, 5, 4_000_000, names)
    assert (record["phase"], record["cell"], record["detail"]) == ("happens", [1, 1], "live")
