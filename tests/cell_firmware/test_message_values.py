"""Values that a message's field can't carry fail their cell, in every form of firmware, in the same words."""

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from bus.lattice import SIDES, Lattice
from bus.partition import Partition
from cell_firmware.board import Board
from cell_firmware.cell import Cell, CellFirmware, CellInputs, CellOutputs, PerCellAdapter
from cell_firmware.firmware import Cells, Firmware, Inputs, Outbox, Outputs, State
from cell_firmware.program import NoParameters
from cell_firmware.shard import Shard, ShardOutputs

NONE = NoParameters()
N = 3
CULPRIT = 1
LATTICE = Lattice((0, column) for column in range(N))
WHOLE = {
    "u1": "must be a whole number from 0 to 255 (uint8)",
    "<i2": "must be a whole number from -32768 to 32767 (int16)",
    "<u8": "must be a whole number from 0 to 18446744073709551615 (uint64)",
}
TRUTH = "must be true or false (bool)"


class Plain(CellFirmware):
    """One cell of an array sends ``value`` to the east, the others 1."""

    def __init__(self, message: np.dtype[Any], value: Any) -> None:
        super().__init__(NONE)
        self.message = message  # pyright: ignore[reportAttributeAccessIssue]
        self.value = value

    def init(self, cell: Cell) -> int:
        return cell.column

    def step(self, state: int, inputs: CellInputs) -> tuple[int, CellOutputs]:
        value = self.value if state == CULPRIT else 1
        return state, CellOutputs((0.5, 0.0), {"east": {"n": value}})


class Array(Firmware):
    """The same on arrays; ``sides`` says to which sides, ``own`` how the messages are written."""

    def __init__(self, message: np.dtype[Any], value: Any, own: str = "zeros") -> None:
        super().__init__(NONE)
        self.message = message  # pyright: ignore[reportAttributeAccessIssue, reportIncompatibleVariableOverride]
        self.value = value
        self.own = own

    def init(self, cells: Cells) -> State:
        return {"column": cells.column}

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        assert self.message is not None
        n = len(state["column"])
        kind = np.asarray(self.value).dtype
        values = np.where(state["column"] == CULPRIT, np.asarray(self.value), np.ones((), kind))
        if self.own == "to_all":
            outbox = Outbox.to_all(self.message, n=values)
            outbox.sent[:, [0, 2, 3]] = False
        elif self.own == "empty":
            outbox = Outbox.empty(n, self.message)
            outbox.message["n"][:, 1] = values
            outbox.sent[:, 1] = True
        else:
            outbox = Outbox(np.zeros((n, 4), dtype=np.bool_), np.zeros((n, 4), dtype=self.message))
            outbox.message["n"] = values[:, None]
            outbox.sent[:, SIDES.index("east")] = True
        return state, Outputs(np.full((n, 2), (0.5, 0.0)), outbox)


def stepped(firmware: Firmware | CellFirmware, ticks: int = 1) -> tuple[Shard, ShardOutputs]:
    whole = PerCellAdapter(firmware) if isinstance(firmware, CellFirmware) else firmware
    position = np.stack((0.1 * LATTICE.columns, 0.1 * LATTICE.rows), axis=1)
    shard = Shard(Board(whole), Cells.of(LATTICE, position, 0.004096), Partition.even(LATTICE, 1), 0)
    nothing = np.zeros((N, 1), dtype=np.bool_)
    outputs = [shard.step(tick, nothing) for tick in range(ticks)]
    return shard, outputs[0]


FORMS: dict[str, Callable[[Any, Any], Firmware | CellFirmware]] = {
    "plain": Plain,
    "zeros": Array,
    "empty": lambda message, value: Array(message, value, "empty"),
    "to_all": lambda message, value: Array(message, value, "to_all"),
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    ("field", "value", "problem"),
    [
        ("u1", 300, f"is 300: {WHOLE['u1']}"),
        ("u1", np.int64(300), f"is 300: {WHOLE['u1']}"),
        ("u1", -1, f"is -1: {WHOLE['u1']}"),
        ("u1", 3.7, f"is 3.7: {WHOLE['u1']}"),
        ("u1", float("nan"), f"is nan: {WHOLE['u1']}"),
        ("u1", float("inf"), f"is inf: {WHOLE['u1']}"),
        ("<i2", -40000, f"is -40000: {WHOLE['<i2']}"),
        ("<u8", -1, f"is -1: {WHOLE['<u8']}"),
        ("<u8", 2.5, f"is 2.5: {WHOLE['<u8']}"),
        ("<u8", 2.0**64, f"is 18446744073709551616: {WHOLE['<u8']}"),
        ("?", 2, f"is 2: {TRUTH}"),
        ("?", float("nan"), f"is nan: {TRUTH}"),
        ("<f8", float("nan"), "is nan: must be a finite number (float64)"),
        ("<f4", -float("inf"), "is -inf: must be a finite number (float32)"),
        ("<f4", 1e300, "is 1e+300: must be a finite number (float32)"),
    ],
)
@pytest.mark.filterwarnings("error")
def test_a_value_that_does_not_fit_fails_its_cell_alone_with_field_value_and_rule(
    form: str, field: str, value: Any, problem: str
) -> None:
    _, outputs = stepped(FORMS[form](np.dtype([("n", field)]), value))
    (failure,) = outputs.failures
    assert failure.cell == (0, CULPRIT)
    assert failure.problem == f"message field n to the east {problem}"
    assert failure.trace == ""
    np.testing.assert_array_equal(outputs.drive[:, 0], [0.5, 0.0, 0.5])


@pytest.mark.parametrize("value", ["5", None, b"5", 1 + 0j, [1], np.array([1])], ids=repr)
@pytest.mark.parametrize("field", ["u1", "?", "<f8"])
def test_what_is_no_number_is_never_read_as_one(field: str, value: Any) -> None:
    (failure,) = stepped(Plain(np.dtype([("n", field)]), value))[1].failures
    assert failure.problem.startswith(f"message field n to the east is {value!r}: must be ")


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    ("field", "value", "received"),
    [
        ("u1", 255, 255),
        ("u1", 3.0, 3),
        ("u1", True, 1),
        ("<u8", np.uint64(2**64 - 1), 2**64 - 1),
        ("<i8", np.int64(-(2**63)), -(2**63)),
        ("?", 0, False),
        ("?", np.bool_(1), True),
        ("<f4", 0.1, float(np.float32(0.1))),
        ("<f8", 7, 7.0),
    ],
)
def test_a_value_that_fits_is_rounded_to_its_type(form: str, field: str, value: Any, received: Any) -> None:
    shard, outputs = stepped(FORMS[form](np.dtype([("n", field)]), value), ticks=2)
    assert not outputs.failures
    assert shard.message == np.dtype([("n", field)])
    inbox = shard._inbox(None)
    assert inbox is not None
    assert inbox.message.dtype == shard.message
    assert inbox.message["n"][CULPRIT + 1, SIDES.index("west")].item() == received


@given(
    st.sampled_from(["u1", "<i2", "<u4", "<i8", "?", "<f4", "<f8"]),
    st.one_of(
        st.integers(-(2**63), 2**63 - 1),
        st.integers(-300, 300),
        st.booleans(),
        st.floats(),
        st.floats(-300, 300).map(round).map(float),
    ),
)
@example("u1", 2**53 + 1)
def test_both_forms_agree_on_what_fits_and_what_is_received(field: str, value: Any) -> None:
    message = np.dtype([("n", field)])
    (plain, one), (array, other) = (stepped(form(message, value)) for form in (Plain, Array))
    assert [f.problem for f in one.failures] == [f.problem for f in other.failures]
    received, same = plain._inbox(None), array._inbox(None)
    assert received is not None
    assert same is not None
    assert received.message.tobytes() == same.message.tobytes()


def test_what_is_not_sent_may_be_anything() -> None:
    class Silent(Array):
        def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
            after, outputs = super().step(state, inputs)
            assert outputs.outbox is not None
            outbox = outputs.outbox
            return after, Outputs(outputs.speed_m_s, Outbox(np.zeros_like(outbox.sent), outbox.message))

    assert not stepped(Silent(np.dtype([("n", "u1")]), 300))[1].failures


def test_the_first_side_and_field_that_does_not_fit_is_named_alike() -> None:
    message = np.dtype([("a", "u1"), ("b", "u1")])

    class Two(CellFirmware):
        def init(self, cell: Cell) -> None:
            return None

        def step(self, state: None, inputs: CellInputs) -> tuple[None, CellOutputs]:
            return None, CellOutputs((0.0, 0.0), {"west": {"a": -1, "b": 0}, "south": {"b": 301, "a": 302}})

    class TwoArrays(Firmware):
        def init(self, cells: Cells) -> State:
            return {"row": cells.row}

        def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
            n = len(state["row"])
            outbox = Outbox.empty(n, self.message or message)
            outbox.sent[:, 2:] = True
            outbox.message["a"][:, 3], outbox.message["b"][:, 2], outbox.message["a"][:, 2] = -1, 301, 302
            return state, Outputs(np.zeros((n, 2)), outbox)

    Two.message = TwoArrays.message = message
    for firmware in (Two(NONE), TwoArrays(NONE)):
        problems = {failure.problem for failure in stepped(firmware)[1].failures}
        assert problems == {
            "message field a to the south is 302: must be a whole number from 0 to 255 (uint8)"
        }


def test_the_program_has_its_own_message_type_back_after_a_step() -> None:
    message = np.dtype([("n", "u1")])

    class Raises(Array):
        def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
            raise ZeroDivisionError

    firmware = Raises(message, 1)
    assert stepped(firmware)[1].failures
    assert firmware.message is message


@pytest.mark.parametrize(
    ("message", "problem"),
    [
        (np.dtype([("n", "u1")]), "message has fields ['m']; its type has ['n']"),
        (np.dtype([("m", "u1"), ("n", "u1")]), "message has fields ['m']; its type has ['m', 'n']"),
        (None, "the firmware sends messages but declares no message type"),
    ],
)
def test_an_outbox_of_other_fields_than_the_message_is_refused(
    message: np.dtype[Any] | None, problem: str
) -> None:
    with pytest.raises(ValueError, match=re.escape(problem)):
        Outbox.to_all(message, m=np.zeros(3))
