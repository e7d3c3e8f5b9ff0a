import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.board import Board
from cell_firmware.build import MotorFacts
from cell_firmware.cell import Cell, CellFirmware, CellInputs, CellOutputs, PerCellAdapter
from cell_firmware.errors import FirmwareFailed, NeverReturned
from cell_firmware.firmware import Cells, Firmware, Inputs, Outbox, Outputs, State
from cell_firmware.program import NoParameters

NONE = NoParameters()


class Faulty(Firmware):
    """Counts ticks; calls ``fault(self, cells, tick, speed, outbox)`` to spoil its own outputs."""

    message = np.dtype([("u", "<f8")])

    def __init__(self, fault: Callable[..., Any]) -> None:
        super().__init__(NONE)
        self.fault = fault

    def init(self, cells: Cells) -> State:
        return {"tick": np.zeros(len(cells), dtype=np.int64), "row": cells.row, "column": cells.column}

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        n, tick = len(state["tick"]), int(state["tick"][0])
        speed = np.full((n, 2), 0.5) + state["column"][:, None]
        outbox = Outbox(np.ones((n, 4), dtype=np.bool_), np.zeros((n, 4), dtype=self.message))
        bad = (state["row"] == 1) & (state["column"] == 2) & (tick == 3)
        result = self.fault(bad, speed, outbox)
        return {**state, "tick": state["tick"] + 1}, result or Outputs(speed, outbox)


def raises(bad: Any, speed: Any, outbox: Any) -> None:
    if bad.any():
        raise ZeroDivisionError("one over nothing")


def not_a_number(bad: Any, speed: Any, outbox: Any) -> None:
    speed[bad, 1] = np.nan


def infinite(bad: Any, speed: Any, outbox: Any) -> None:
    speed[bad, 0] = -np.inf


def bad_message(bad: Any, speed: Any, outbox: Any) -> None:
    outbox.message["u"][bad, 2] = np.nan


def wrong_shape(bad: Any, speed: Any, outbox: Any) -> Outputs | None:
    return Outputs(speed[:, 0], outbox) if bad.any() else None


def wrong_type(bad: Any, speed: Any, outbox: Any) -> Outputs | None:
    return Outputs(speed.astype(complex), outbox) if bad.any() else None


def no_outputs(bad: Any, speed: Any, outbox: Any) -> Any:
    return [speed] if bad.any() else None


def wrong_message(bad: Any, speed: Any, outbox: Any) -> Outputs | None:
    return Outputs(speed, Outbox(outbox.sent, np.zeros((len(bad), 4)))) if bad.any() else None


FAULTS = {
    raises: "ZeroDivisionError: one over nothing",
    not_a_number: "drive is not finite: speed [2.5, nan] m/s",
    infinite: "drive is not finite: speed [-inf, 2.5] m/s",
    bad_message: "message field u to the south is nan: must be a finite number (float64)",
    wrong_shape: "speed_m_s must be real numbers of shape (1, 2), not float64 of shape (1,)",
    wrong_type: "speed_m_s must be real numbers of shape (1, 2), not complex128 of shape (1, 2)",
    no_outputs: "step must return (state, Outputs), not list as the second",
    wrong_message: "outbox.message must be [('u', '<f8')] of shape (1, 4), not float64 of shape (1, 4)",
}


@pytest.mark.parametrize("motors", [False, True])
@pytest.mark.parametrize("shards", [1, 4, 12])
@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.__name__)
def test_array_firmware_that_fails_names_the_cell_and_tick_and_the_others_go_on(
    grid: Callable[..., Lattice],
    run: Callable[..., Any],
    fault: Callable[..., Any],
    shards: int,
    motors: bool,
):
    lattice = grid(3, 4)
    facts = MotorFacts(12.0, 1.2) if motors else None
    encoder = np.zeros((6, 12, 2)) if motors else None
    partition = Partition.even(lattice, shards)
    result = run(Faulty(fault), partition, 6, motors=facts, encoder_m=encoder)
    healthy = run(Faulty(lambda *_: None), partition, 6, motors=facts, encoder_m=encoder)

    (failure,) = result.failures
    assert (failure.cell, failure.tick, failure.problem) == ((1, 2), 3, FAULTS[fault])
    if fault is raises:
        assert "in raises" in failure.trace
        assert failure.trace.count("Traceback") == 1  # not that of all cells before it
        assert str(failure).startswith(
            "firmware of cell 1,2 failed in tick 3: ZeroDivisionError: one over nothing\n"
        )
    else:
        assert failure.trace == ""
    culprit = lattice.index((1, 2))
    others = np.arange(12) != culprit
    np.testing.assert_array_equal(result.drives[3:, culprit], 0.0)
    assert result.drives[:3].tobytes() == healthy.drives[:3].tobytes()
    assert result.drives[:, others].tobytes() == healthy.drives[:, others].tobytes()


def test_several_cells_that_fail_at_once_are_all_named(grid: Callable[..., Lattice], run: Callable[..., Any]):
    class Half(Faulty):
        def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
            if (state["column"] == 1).any():
                raise ValueError("column 1")
            return super().step(state, inputs)

    failures = run(Half(lambda *_: None), Partition.even(grid(3, 2), 1), 1).failures
    assert [(failure.cell, failure.problem) for failure in failures] == [
        ((row, 1), "ValueError: column 1") for row in range(3)
    ]


def test_firmware_that_fails_on_many_cells_but_on_none_alone_fails_for_all(
    grid: Callable[..., Lattice], run: Callable[..., Any]
):
    class NeedsOne(Faulty):
        def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
            if len(state["tick"]) > 1:
                raise ValueError("made for one")
            return super().step(state, inputs)

    result = run(NeedsOne(lambda *_: None), Partition.even(grid(2, 2), 1), 2)
    assert len(result.failures) == 4
    assert result.failures[0].problem == "ValueError: made for one (all 4 cells at once)"
    np.testing.assert_array_equal(result.drives, 0.0)


def test_a_step_that_writes_to_its_state_fails(grid: Callable[..., Lattice], run: Callable[..., Any]):
    class Impure(Faulty):
        def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
            state["tick"][:] += 1
            return super().step(state, inputs)

    (failure, *_) = run(Impure(lambda *_: None), Partition.even(grid(2, 2), 1), 1).failures
    assert "read-only" in failure.problem


@pytest.mark.parametrize(
    ("state", "problem"),
    [
        (None, "init: state must be a mapping of names to arrays, not NoneType"),
        (
            {"u": np.zeros(3)},
            "init: state['u'] must be an array with 1 rows, one a cell, not float64 of shape (3,)",
        ),
        ({"u": 1.0}, "init: state['u'] must be an array with 1 rows, one a cell, not float"),
    ],
)
def test_a_state_without_a_row_per_cell_is_refused(
    grid: Callable[..., Lattice], everything: Callable[..., Cells], state: Any, problem: str
):
    class Odd(Faulty):
        def init(self, cells: Cells) -> State:
            return state

    with pytest.raises(FirmwareFailed) as caught:
        Board(Odd(lambda *_: None)).init(everything(grid(2, 2)))
    assert caught.value.problem == problem
    assert caught.value.cell == (0, 0)


@pytest.mark.parametrize("together", ["raises", "hangs"])
def test_the_deadline_ends_the_search_for_cells_that_fail_unless_it_is_the_failure(
    grid: Callable[..., Lattice], run: Callable[..., Any], together: str
):
    class Late(Faulty):
        """Fails where all its cells are stepped; alone the third is interrupted, and those before it raise."""

        def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
            if len(inputs.presence) > 1:
                raise ValueError("all") if together == "raises" else NeverReturned
            if state["column"][0] == 2:
                raise NeverReturned
            if state["column"][0] < 2:
                raise ValueError("alone")
            return super().step(state, inputs)

    result = run(Late(lambda *_: None), Partition.even(grid(1, 5), 1), 1)
    found = {failure.cell: failure.problem for failure in result.failures}
    alone = {(0, 0): "ValueError: alone", (0, 1): "ValueError: alone"}
    if together == "raises":  # of the others no more is known
        unknown = dict.fromkeys(((0, 2), (0, 3), (0, 4)), "ValueError: all (all 5 cells at once)")
        assert found == alone | unknown
        assert not result.drives.any()
    else:
        assert found == alone | {(0, 2): "cell_firmware.errors.NeverReturned: the program did not return"}
        assert result.drives[0, 3:, 0].tolist() == [3.5, 4.5]


def test_an_init_that_raises_for_one_cell_names_it(
    grid: Callable[..., Lattice], everything: Callable[..., Cells]
):
    class Picky(Faulty):
        def init(self, cells: Cells) -> State:
            if ((cells.row == 1) & (cells.column == 0)).any():
                raise KeyError("not here")
            return super().init(cells)

    with pytest.raises(
        FirmwareFailed, match="firmware of cell 1,0 failed in tick 0: init: KeyError: 'not here'"
    ) as caught:
        Board(Picky(lambda *_: None)).init(everything(grid(2, 2)))
    assert caught.value.trace.count("Traceback") == 1  # that of this cell alone


def test_plain_firmware_that_returns_nothing_fails_with_what_a_step_returns(
    grid: Callable[..., Lattice], run: Callable[..., Any]
):
    class Forgetful(Plain):
        def step(self, state: dict[str, Any], inputs: CellInputs) -> Any:
            return None

    (failure,) = run(PerCellAdapter(Forgetful(lambda _: None)), Partition.even(grid(1, 1), 1), 1).failures
    assert failure.problem == "TypeError: step must return (state, CellOutputs), not NoneType"


class Plain(CellFirmware):
    """Plain Python whose every wrong output can be asked for; its state is mutable, and mutated."""

    message = np.dtype([("n", "<u1")])

    def __init__(self, give: Callable[[int], Any]) -> None:
        super().__init__(NONE)
        self.give = give

    def init(self, cell: Cell) -> dict[str, Any]:
        return {"cell": (cell.row, cell.column), "ticks": 0}

    def step(self, state: dict[str, Any], inputs: CellInputs) -> tuple[Any, CellOutputs]:
        state["ticks"] += 1
        given = self.give(state["ticks"]) if state["cell"] == (0, 1) else None
        return state, given or CellOutputs((float(state["ticks"]), 0.0), {"east": {"n": state["ticks"]}})


def test_plain_firmware_steps_each_cell_once_a_tick_even_when_a_neighbour_raises(
    grid: Callable[..., Lattice], run: Callable[..., Any]
):
    def give(ticks: int) -> None:
        if ticks == 3:
            raise RuntimeError("worn out")

    result = run(PerCellAdapter(Plain(give)), Partition.even(grid(1, 3), 1), 5)
    (failure,) = result.failures
    assert (failure.cell, failure.tick, failure.problem) == ((0, 1), 2, "RuntimeError: worn out")
    assert "in give" in failure.trace
    assert result.drives[:, 0, 0].tolist() == result.drives[:, 2, 0].tolist() == [1, 2, 3, 4, 5]
    assert result.drives[:, 1, 0].tolist() == [1, 2, 0, 0, 0]


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        ((0.0, 0.0), "TypeError: step must return (state, CellOutputs), not tuple as the second"),
        (CellOutputs(("1", 0.0)), "TypeError: speed_m_s must be two numbers, not str '1'"),
        (CellOutputs(3.0), "TypeError: speed_m_s must be two numbers, not 3.0"),
        (CellOutputs((1.0,)), "TypeError: speed_m_s must be two numbers, not (1.0,)"),
        (CellOutputs((float("nan"), 0.0)), "drive is not finite: speed [nan, 0.0] m/s"),
        (
            CellOutputs((0.0, 0.0), {"up": {"n": 1}}),
            "ValueError: outbox has a side 'up'; sides are north, east, south, west",
        ),
        (
            CellOutputs((0.0, 0.0), {"east": {"m": 1}}),
            "ValueError: message to the east has fields ['m']; its type has ['n']",
        ),
        (
            CellOutputs((0.0, 0.0), {"east": 3}),
            "TypeError: message to the east must be a dict of n, not 3",
        ),
        (
            CellOutputs((0.0, 0.0), [1]),
            "TypeError: outbox must be a dict of messages by side, not [1]",
        ),
        (
            CellOutputs((0.0, 0.0), {"east": {"n": 256}}),
            "message field n to the east is 256: must be a whole number from 0 to 255 (uint8)",
        ),
    ],
)
def test_plain_firmware_that_returns_nonsense_fails_as_that_cell(
    grid: Callable[..., Lattice], run: Callable[..., Any], given: Any, problem: str
):
    (failure,) = run(PerCellAdapter(Plain(lambda _: given)), Partition.even(grid(1, 3), 1), 2).failures
    assert (failure.cell, failure.tick, failure.problem) == ((0, 1), 0, problem)


def test_plain_firmware_sees_plain_values(grid: Callable[..., Lattice], run: Callable[..., Any]):
    seen: list[tuple[Cell | None, CellInputs | None]] = []

    class Watch(CellFirmware):
        message = np.dtype([("n", "<i4"), ("x", "<f8"), ("b", "?")])

        def init(self, cell: Cell) -> None:
            seen.append((cell, None))

        def step(self, state: None, inputs: CellInputs) -> tuple[None, CellOutputs]:
            seen.append((None, inputs))
            return None, CellOutputs((0, 1), {"north": {"n": -7, "x": 0.5, "b": True}, "south": None})

    run(
        PerCellAdapter(Watch(NONE)),
        Partition.even(grid(2, 1), 1),
        2,
        presence=np.ones((2, 2, 1), dtype=np.bool_),
    )
    cells = [cell for cell, _ in seen if cell is not None]
    assert cells[1] == Cell(1, 0, (0.0, 0.1), ("south",), 0.004096, ((0.0, 0.0),), 0.1)
    first, _, _, above = [inputs for _, inputs in seen if inputs is not None]
    nothing = {"north": None, "east": None, "south": None, "west": None}
    assert first == CellInputs((True,), None, nothing)
    assert above == CellInputs((True,), None, {**nothing, "south": {"n": -7, "x": 0.5, "b": True}})
    assert above.presence[0] is True


def test_a_failure_survives_pickling_between_processes():
    failure = FirmwareFailed((1, 2), 3, "ValueError: no", "Traceback ...")
    again = pickle.loads(pickle.dumps(failure))
    assert str(again) == str(failure)
    assert (again.cell, again.tick) == ((1, 2), 3)
