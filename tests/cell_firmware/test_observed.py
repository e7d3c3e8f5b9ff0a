"""A program's field, as it is seen from outside: on arrays and cell by cell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pytest

from bus.lattice import Lattice
from cell_firmware.board import Board
from cell_firmware.cell import Cell, CellFirmware, CellInputs, CellOutputs, PerCellAdapter
from cell_firmware.errors import FirmwareFailed
from cell_firmware.firmware import Cells, Firmware, Inputs, Outputs, State
from cell_firmware.program import NoParameters
from tests.cell_firmware.conftest import cells_of

LATTICE = Lattice([(0, 0), (0, 1), (2, 0)])


@dataclass
class Record:
    level: Any


class Row(NamedTuple):
    level: Any


class Plain(CellFirmware):
    """Its state is what a function makes of the cell."""

    observable = "level"

    def __init__(self, make: Callable[[Cell], Any]) -> None:
        super().__init__(NoParameters())
        self.make = make

    def init(self, cell: Cell) -> Any:
        return self.make(cell)

    def step(self, state: Any, inputs: CellInputs) -> tuple[Any, CellOutputs]:
        return state, CellOutputs((0.0, 0.0))


def level(make: Callable[[Cell], Any]) -> Any:
    board = Board(PerCellAdapter(Plain(make)))
    return board.registers(board.init(cells_of(LATTICE)))["firmware.level"].tolist()


@pytest.mark.parametrize("kind", [Record, Row, lambda value: {"level": value, "other": "x"}])
def test_a_plain_programs_variable_is_a_key_or_an_attribute_of_its_state(kind: Callable[[Any], Any]) -> None:
    assert level(lambda cell: kind(cell.row + 0.5)) == [0.5, 0.5, 2.5]
    assert level(lambda cell: kind((cell.row, cell.column))) == [[0, 0], [0, 1], [2, 0]]
    assert level(lambda cell: kind(cell.column == 1)) == [0.0, 1.0, 0.0]


def test_what_is_no_number_or_not_yet_one_is_nan() -> None:
    odd = {(0, 0): None, (0, 1): "high", (2, 0): 3}
    np.testing.assert_array_equal(level(lambda cell: Record(odd[cell.row, cell.column])), [np.nan, np.nan, 3])
    np.testing.assert_array_equal(level(lambda cell: Record(None)), [np.nan] * 3)
    ragged = {(0, 0): (1, 2), (0, 1): 3, (2, 0): (4, 5)}
    np.testing.assert_array_equal(
        level(lambda cell: Record(ragged[cell.row, cell.column])), [[1, 2], [np.nan, np.nan], [4, 5]]
    )


class OnArrays(Firmware):
    observable = "level"

    def init(self, cells: Cells) -> State:
        return {"height": np.zeros(len(cells))}

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        return state, Outputs(np.zeros((len(state["height"]), 2)))


@pytest.mark.parametrize(
    "firmware", [OnArrays(NoParameters()), PerCellAdapter(Plain(lambda cell: {"height": 1.0}))]
)
def test_a_program_whose_state_has_no_such_variable_does_not_begin(firmware: Firmware) -> None:
    with pytest.raises(
        FirmwareFailed, match="observable is 'level': the state has no such variable; it has height"
    ):
        Board(firmware).init(cells_of(LATTICE))


def shown(make: Callable[[Cell], Any]) -> dict[str, Any]:
    program = PerCellAdapter(Plain(make))
    program.observable = None  # pyright: ignore[reportAttributeAccessIssue]
    board = Board(program)
    return {name: array.tolist() for name, array in board.registers(board.init(cells_of(LATTICE))).items()}


@dataclass
class Much:
    row: int
    place: tuple[float, float]
    name: str = "cell"
    there: bool | None = None


NUMPY = np.dtype([("row", "<i4"), ("place", "<f8", (2,))])


@pytest.mark.parametrize(
    "kind",
    [
        Much,
        lambda row, place: {"row": row, "place": place, "name": "cell", 3: 4.0},
        lambda row, place: np.array([(row, place)], NUMPY)[0],
        lambda row, place: np.array((row, place), NUMPY),
    ],
)
def test_a_plain_programs_numbers_are_shown_by_name(kind: Callable[..., Any]) -> None:
    assert shown(lambda cell: kind(cell.row, (cell.column, 0.5))) == {
        "firmware.row": [0.0, 0.0, 2.0],
        "firmware.place": [[0.0, 0.5], [1.0, 0.5], [0.0, 0.5]],
    }


def test_a_state_that_is_numbers_itself_is_shown_as_such() -> None:
    assert shown(lambda cell: (cell.row, True)) == {"firmware.state": [[0, 1], [0, 1], [2, 1]]}
    assert shown(lambda cell: cell.column) == {"firmware.state": [0, 1, 0]}
    assert shown(lambda _: None) == shown(lambda _: "7") == {}


@pytest.mark.parametrize(
    ("state", "problem"),
    [
        (Much(1, (0.0, 0.0), name=3), None),  # pyright: ignore[reportArgumentType]
        (Row(None), None),
        (7, None),
        (
            None,
            "its state is None, which has no numbers by name; a dataclass, a NamedTuple, a dict or a NumPy record",
        ),
        ({}, "its state is a dict, which has no numbers by name; a dataclass"),
        (Much(1, (0.0, 0.0)), "parts of its state are not recorded: name is a str, not numbers"),
        ({"a": 1, "b": [0.0] * 65}, "parts of its state are not recorded: b has 65 numbers, not 1 to 64"),
    ],
)
def test_why_a_plain_programs_state_is_not_recorded(state: Any, problem: str | None) -> None:
    found = PerCellAdapter(Plain(lambda _: state)).unrecorded(cells_of(LATTICE))
    assert found is None if problem is None else found is not None and found.startswith(problem)
