"""A tree of shortest ways to an elected root: counts, wheels, and roots that die. Steps run as Python."""

from __future__ import annotations

from typing import Any

import pytest

from bus.lattice import STEPS, Lattice
from cell_firmware.errors import ParametersError
from cell_firmware.protocols.spanning_tree import SpanningTree, SpanningTreeParameters
from cell_firmware.scalar_program import PYTHON
from mdms import Lab


@pytest.fixture(autouse=True)
def _in_python(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PYTHON, "1")


CELLS = [(row, column) for row in range(3) for column in range(4) if (row, column) != (1, 1)]


def tree(**parameters: Any) -> SpanningTree:
    return SpanningTree(SpanningTreeParameters.model_validate(parameters))


def test_cells_know_the_root_its_distance_and_both_counts_and_drive_to_their_parent() -> None:
    parameters = {"roots": [{"cell": [2, 3]}], "speed_m_s": 0.2, "limit": 12}
    lab = Lab("spanning_tree", CELLS, parameters=parameters)
    lab.cover((0, 0), (0, 1), (2, 2))
    lab.step(6)
    distances = [5, 4, 3, 2, 4, 2, 1, 3, 2, 1, 0]
    assert lab.registers["distance"].tolist() == distances
    theory = tree(**parameters).theory(lab.lattice)
    assert theory.ticks == 5
    assert theory.limit is not None
    assert theory.limit.tolist() == distances
    lab.step(12)
    assert set(lab.registers["all_cells"].tolist()) == {11}
    assert set(lab.registers["all_covered"].tolist()) == {3}
    for cell, (vx, vy) in zip(CELLS, lab.drives.tolist(), strict=True):
        if cell != (2, 3):
            there = (cell[0] + round(vy / 0.2), cell[1] + round(vx / 0.2))
            assert abs(vx) + abs(vy) == 0.2
            assert lab.registers["distance", there] == lab.registers["distance", cell] - 1
    assert lab.drives[-1].tolist() == [0.0, 0.0]


def test_the_next_candidate_leads_where_the_first_dies_and_the_least_place_after_all() -> None:
    parameters = {"roots": [{"cell": [2, 3]}, {"rows": [0, 0], "columns": [2, 3]}], "limit": 12}
    lab = Lab("spanning_tree", CELLS, parameters=parameters).step(20)

    def root() -> tuple[int, int]:
        found = [cell for cell in lab.alive if lab.registers["distance", cell] == 0]
        assert len(found) == 1
        return found[0]

    assert root() == (2, 3)
    for dead, heir in (((2, 3), (0, 2)), ((0, 2), (0, 3)), ((0, 3), (0, 0))):
        lab.kill(dead)
        lab.step(50)  # conditions of the program are due by then
        assert root() == heir


def test_a_limit_below_a_distance_is_warned_of() -> None:
    lattice = Lattice([(0, column) for column in range(9)])
    (warning,) = tree(limit=8).warnings(lattice)
    assert warning == "limit is 8, and a cell is 8 links from its root: far cells will follow other roots"
    assert tree(limit=9).warnings(lattice) == ()
    assert tree(limit=8).theory(lattice).limit is None


@pytest.mark.parametrize(
    ("parameters", "cells", "message"),
    [
        ({"roots": [{"cell": [7, 7]}]}, CELLS, r"roots\[0\]\.cell: the array has no cell \[7, 7\]"),
        ({"roots": [{"cell": [0, 0]}, {"rows": [0, 0]}]}, CELLS, r"names cell \[0, 0\], as roots\[0\] does"),
        ({}, [(0, 4096)], r"rows and columns must be below 4096"),
    ],
)
def test_roots_and_arrays_that_do_not_fit_are_refused(parameters: Any, cells: Any, message: str) -> None:
    with pytest.raises(ParametersError, match=message):
        tree(**parameters).check(Lattice(cells))


def test_wheels_point_over_the_side_of_the_parent() -> None:
    lab = Lab(
        "spanning_tree", (3, 3), parameters={"roots": [{"cell": [1, 1]}], "speed_m_s": 1.0}, check=None
    ).step(3)
    for row, column in STEPS:
        index = lab.lattice.index((1 - row, 1 - column))
        assert lab.drives[index].tolist() == [column, row]
