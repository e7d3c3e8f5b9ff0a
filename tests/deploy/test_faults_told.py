"""Faults in words."""

from __future__ import annotations

from typing import Any

from deploy.faults.telling import lines, marks, out_of_array


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
    assert lines(RUN) == [
        "1,1 plugged in at 1.7 s",
        "crash of 3 cells at 1.2 s, repaired at 2 s",
        "3,4 crashed at 0.5 s",
        "wheel stuck of 2,2 at 1.5 s",
        "2 cells pulled at 1.6 s, plugged in again at 2.5 s",
        "6,6 pulled at 3 s",
    ]
    assert lines(RUN[:1]) == ["1,1 not there yet"]


def test_cells_out_of_the_array_are_told_with_when_they_came_back() -> None:
    assert out_of_array(RUN) == {(1, 1): 1.7, (5, 5): 2.5, (6, 6): None}
    both = [fault("remove", "begins", 1.0, (0, 0)), fault("remove", "begins", 2.0, (0, 0), number=1)]
    assert out_of_array([*both, fault("remove", "ends", 3.0, (0, 0))]) == {(0, 0): None}


def test_marks_are_those_of_faults_that_begin_or_end() -> None:
    assert marks(RUN) == [
        (1.2, "3 cells: crash"),
        (1.5, "cell 2,2: wheel stuck"),
        (1.6, "2 cells pulled"),
        (1.7, "cell 1,1 plugged in"),
        (2.0, "3 cells: crash ends"),
        (2.5, "2 cells plugged in"),
        (3.0, "cell 6,6 pulled"),
    ]
