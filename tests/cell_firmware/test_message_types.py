"""Vectors, nested records and bounded lists in messages: alike in every form of firmware, and checked alike."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from bus.lattice import SIDES, Lattice
from bus.partition import Partition
from bus.wire.message_type import bounded_list, with_numbers
from cell_firmware.board import Board
from cell_firmware.cell import Cell, CellFirmware, CellInputs, CellOutputs, PerCellAdapter, cell_inputs
from cell_firmware.compiled import compiled
from cell_firmware.firmware import Cells, Firmware, Inputs, Outbox, Outputs, State
from cell_firmware.program import NoParameters
from cell_firmware.scalar_program import COMPARED_TICKS, PYTHON, ScalarProgram
from cell_firmware.shard import Shard

NONE = NoParameters()
CULPRIT = 1
LATTICE = Lattice((0, column) for column in range(3))
WEST, EAST = SIDES.index("west"), SIDES.index("east")
POSE = np.dtype([("x", "<f8"), ("turns", "<i2")])
MESSAGE = np.dtype(
    [
        ("small", "u1"),
        ("vector", "<f4", (3,)),
        ("flag", "?"),
        ("grid", "<i4", (2, 2)),
        ("pose", [("at", POSE), ("sure", "?")]),
        ("corners", POSE, (2,)),
        ("wide", "<u8"),
        ("route", bounded_list("<i2", 4)),
        ("marks", bounded_list(POSE, 2)),
    ]
)
GOOD: dict[str, Any] = {
    "small": 7,
    "vector": (0.5, -1.0, 0.1),
    "flag": True,
    "grid": ((1, 2), (3, -4)),
    "pose": {"at": {"x": 1.5, "turns": -3}, "sure": False},
    "corners": ({"x": 2.5, "turns": 1}, {"x": -2.5, "turns": 2}),
    "wide": 2**63 + 5,
    "route": (5, -6),
    "marks": ({"x": 0.25, "turns": 9},),
}
SILENCE: dict[str, Any] = {
    "small": 0,
    "vector": (0.0, 0.0, 0.0),
    "flag": False,
    "grid": ((0, 0), (0, 0)),
    "pose": {"at": {"x": 0.0, "turns": 0}, "sure": False},
    "corners": ({"x": 0.0, "turns": 0}, {"x": 0.0, "turns": 0}),
    "wide": 0,
    "route": (),
    "marks": (),
}


def put(target: Any, value: Any) -> None:
    """Write plain values into a record of arrays; garbage behind the items of lists."""
    for name, one in value.items():
        if isinstance(one, Mapping):
            put(target[name], one)
        elif name in ("route", "marks"):
            target[name]["length"], items = len(one), target[name]["items"]
            items[...] = 3
            for i, item in enumerate(one[: len(items)]):
                if isinstance(item, Mapping):
                    put(items[i : i + 1], item)
                else:
                    items[i] = item
        elif name == "corners":
            for i, item in enumerate(one):
                put(target[name][i : i + 1], item)
        else:
            target[name] = one


class Plain(CellFirmware):
    """The middle cell sends a message to the east, the others the silent one."""

    message = MESSAGE

    def __init__(self, given: Mapping[str, Any], bad_tick: int) -> None:
        super().__init__(NONE)
        self.given, self.bad_tick = given, bad_tick

    def init(self, cell: Cell) -> tuple[int, int]:
        return cell.column, 0

    def step(self, state: tuple[int, int], inputs: CellInputs) -> tuple[tuple[int, int], CellOutputs]:
        column, tick = state
        value = self.given if column == CULPRIT and tick == self.bad_tick else SILENCE
        del inputs
        return (column, tick + 1), CellOutputs((0.5, 0.0), {"east": value})


class Arrays(Firmware):
    """The same on arrays."""

    message = MESSAGE

    def __init__(self, given: Mapping[str, Any], bad_tick: int) -> None:
        super().__init__(NONE)
        self.given, self.bad_tick = given, bad_tick

    def init(self, cells: Cells) -> State:
        return {"column": cells.column, "tick": np.zeros(len(cells), np.int64)}

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        assert self.message is not None
        outbox = Outbox.empty(len(state["column"]), self.message)
        outbox.sent[:, EAST] = True
        for row in np.flatnonzero((state["column"] == CULPRIT) & (state["tick"] == self.bad_tick)):
            put(outbox.message[row, EAST], self.given)
        speed = np.full((len(state["column"]), 2), (0.5, 0.0))
        return {**state, "tick": state["tick"] + 1}, Outputs(speed, outbox)


GIVEN = with_numbers(MESSAGE, lambda kind: kind if kind == np.uint64 else np.dtype("<f8"), align=True)


class Scalar(ScalarProgram):
    """The same in scalar form."""

    message = MESSAGE
    constants_type = np.dtype([("given", GIVEN), ("bad_tick", "<i8")], align=True)
    state_type = np.dtype([("column", "<i8"), ("tick", "<i8")])

    def __init__(self, given: Mapping[str, Any], bad_tick: int) -> None:
        super().__init__(NONE)
        self.given, self.bad_tick = given, bad_tick

    def constants(self) -> dict[str, Any]:
        record = np.zeros((), dtype=GIVEN)
        put(record, self.given)
        return {"given": record, "bad_tick": self.bad_tick}

    def init(self, cells: Cells) -> State:
        return {"column": cells.column, "tick": np.zeros(len(cells), np.int64)}

    @staticmethod
    def cell_step(constants: Any, state: Any, inputs: Any, outputs: Any) -> None:
        outputs.speed_m_s[0] = 0.5
        outputs.sent[EAST] = 1
        if state.column == CULPRIT and state.tick == constants.bad_tick:
            given, message = constants.given, outputs.message[EAST]
            message.small, message.flag, message.wide = given.small, given.flag, given.wide
            message.pose.at.x, message.pose.at.turns = given.pose.at.x, given.pose.at.turns
            message.pose.sure = given.pose.sure
            message.route.length, message.marks.length = given.route.length, given.marks.length
            for i in range(3):
                message.vector[i] = given.vector[i]
            for i in range(4):
                message.route.items[i] = given.route.items[i]
            for i in range(2):
                message.corners[i].x, message.corners[i].turns = given.corners[i].x, given.corners[i].turns
                message.marks.items[i].x = given.marks.items[i].x
                message.marks.items[i].turns = given.marks.items[i].turns
                for j in range(2):
                    message.grid[i, j] = given.grid[i, j]
        state.tick += 1


FORMS: dict[str, Callable[[Mapping[str, Any], int], Firmware | CellFirmware]] = {
    "plain": Plain,
    "arrays": Arrays,
    "scalar": Scalar,
}


class WideScalar(ScalarProgram):
    """The middle cell sends 64-bit integers to the east: from an integer of either type, or from a float."""

    message = np.dtype([("mark", "?"), ("one", "<i8"), ("list", bounded_list("<u8", 3)), ("last", "<i8")])
    constants_type = np.dtype(
        [("signed", "<i8"), ("unsigned", "<u8"), ("fraction", "<f8"), ("kind", "<i8"), ("bad_tick", "<i8")]
    )
    state_type = np.dtype([("column", "<i8"), ("tick", "<i8")])

    def __init__(self, field: str, value: float | np.uint64, bad_tick: int) -> None:
        super().__init__(NONE)
        self.field, self.value, self.bad_tick = field, value, bad_tick

    def constants(self) -> dict[str, Any]:
        name = {int: "signed", np.uint64: "unsigned", float: "fraction"}[type(self.value)]
        kind = ("signed", "unsigned", "fraction").index(name) + 3 * (self.field != "one")
        return {name: self.value, "kind": kind, "bad_tick": self.bad_tick}

    init = Scalar.init  # pyright: ignore[reportAssignmentType]

    @staticmethod
    def cell_step(constants: Any, state: Any, inputs: Any, outputs: Any) -> None:
        outputs.speed_m_s[0] = 0.5
        outputs.sent[EAST] = 1
        message, kind = outputs.message[EAST], constants.kind
        message.mark, message.last = True, -1
        message.list.length = 2
        for i in range(3):
            message.list.items[i] = 6 + i
        if state.column == CULPRIT and state.tick == constants.bad_tick:
            if kind == 0:
                message.one = constants.signed
            elif kind == 1:
                message.one = constants.unsigned
            elif kind == 2:
                message.one = constants.fraction
            elif kind == 3:
                message.list.items[1] = constants.signed
            elif kind == 4:
                message.list.items[1] = constants.unsigned
            else:
                message.list.items[1] = constants.fraction
        state.tick += 1


I8 = "must be a whole number from -9223372036854775808 to 9223372036854775807 (int64)"
U8 = "must be a whole number from 0 to 18446744073709551615 (uint64)"
WIDE_FITS = [
    ("one", 2**62 + 1),
    ("one", -(2**63)),
    ("one", -(2.0**63)),
    ("one", np.uint64(2**63 - 1)),
    ("list", np.uint64(2**64 - 1)),
    ("list", 2**63 - 1),
    ("list", 2.0**63),
]
WIDE_MISFITS = [
    ("one", 3.7, f"one to the east is 3.7: {I8}"),
    ("one", float("nan"), f"one to the east is nan: {I8}"),
    ("one", float("-inf"), f"one to the east is -inf: {I8}"),
    ("one", 2.0**63, f"one to the east is 9223372036854775808: {I8}"),
    ("one", np.uint64(2**63 + 5), f"one to the east is 9223372036854775813: {I8}"),
    ("list", -1, f"list.items[1] to the east is -1: {U8}"),
    ("list", -(2**63) + 1, f"list.items[1] to the east is -9223372036854775807: {U8}"),
    ("list", -0.5, f"list.items[1] to the east is -0.5: {U8}"),
    ("list", 2.0**64, f"list.items[1] to the east is 18446744073709551616: {U8}"),
]


def wide_message(field: str, value: float | np.uint64) -> bytes:
    expected = np.zeros((), dtype=WideScalar.message)
    expected["mark"], expected["last"] = True, -1
    expected["list"]["length"], expected["list"]["items"][:2] = 2, (6, 7)
    if field == "one":
        expected["one"] = int(value)
    else:
        expected["list"]["items"][1] = int(value)
    return expected.tobytes()


@pytest.mark.filterwarnings("error")
def test_integers_of_64_bits_are_checked_in_scalar_form_in_python(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PYTHON, "1")
    for field, value in WIDE_FITS:
        shard, problems = stepped(WideScalar(field, value, 0), 0)
        assert problems == []
        assert arrived(shard).tobytes() == wide_message(field, value)
    for field, value, problem in WIDE_MISFITS:
        assert stepped(WideScalar(field, value, 0), 0)[1] == [f"message field {problem}"]


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_integers_of_64_bits_are_checked_in_compiled_steps() -> None:
    for tick in (1, COMPARED_TICKS + 2):  # stepped on arrays and compared; in one call
        for field, value in WIDE_FITS:
            shard, problems = stepped(WideScalar(field, value, tick), tick)
            assert problems == []
            assert arrived(shard).tobytes() == wide_message(field, value)
        for field, value, problem in WIDE_MISFITS:
            assert stepped(WideScalar(field, value, tick), tick)[1] == [f"message field {problem}"]


def shard_of(firmware: Firmware | CellFirmware) -> Shard:
    whole = PerCellAdapter(firmware) if isinstance(firmware, CellFirmware) else firmware
    position = np.stack((0.1 * LATTICE.columns, 0.1 * LATTICE.rows), axis=1)
    cells = Cells.of(LATTICE, position, 0.004096)
    return Shard(compiled(Board(whole)), cells, Partition.even(LATTICE, 1), 0)


def stepped(firmware: Firmware | CellFirmware, tick: int) -> tuple[Shard, list[str]]:
    """The shard after ``tick``, and the problems of the middle cell."""
    shard, presence = shard_of(firmware), np.zeros((len(LATTICE), 1), dtype=np.bool_)
    for early in range(tick):
        assert not shard.step(early, presence).failures
    outputs = shard.step(tick, presence)
    assert {failure.cell for failure in outputs.failures} <= {(0, CULPRIT)}
    assert outputs.drive[:, 0].tolist() == [0.5, 0.0 if outputs.failures else 0.5, 0.5]
    return shard, [failure.problem for failure in outputs.failures]


def arrived(shard: Shard) -> np.ndarray:
    inbox = shard._inbox(None)
    assert inbox is not None
    assert inbox.received[CULPRIT + 1, WEST]
    return inbox.message[CULPRIT + 1, WEST]


def changed(path: str, value: Any) -> dict[str, Any]:
    """The good message with another value at a dotted path."""

    def put_at(part: Any, steps: list[str]) -> Any:
        if not steps:
            return value
        if isinstance(part, Mapping):
            return {**part, steps[0]: put_at(part[steps[0]], steps[1:])}
        i = int(steps[0])
        return (*part[:i], put_at(part[i], steps[1:]), *part[i + 1 :])

    return put_at(GOOD, path.split("."))


I2 = "must be a whole number from -32768 to 32767 (int16)"
MISFITS = [
    ("small", 300, "small to the east is 300: must be a whole number from 0 to 255 (uint8)"),
    ("small", 3.7, "small to the east is 3.7: must be a whole number from 0 to 255 (uint8)"),
    ("small", float("nan"), "small to the east is nan: must be a whole number from 0 to 255 (uint8)"),
    ("flag", 2, "flag to the east is 2: must be true or false (bool)"),
    ("vector.2", 1e300, "vector[2] to the east is 1e+300: must be a finite number (float32)"),
    ("vector.0", float("inf"), "vector[0] to the east is inf: must be a finite number (float32)"),
    (
        "grid.1.0",
        2.0**31,
        "grid[1][0] to the east is 2147483648: must be a whole number from -2147483648 to 2147483647 (int32)",
    ),
    ("pose.at.turns", -40000, f"pose.at.turns to the east is -40000: {I2}"),
    ("pose.at.x", float("nan"), "pose.at.x to the east is nan: must be a finite number (float64)"),
    ("corners.1.turns", 0.5, f"corners.1.turns to the east is 0.5: {I2}"),
    ("route.1", 40000, f"route.items[1] to the east is 40000: {I2}"),
    ("marks.0.turns", 40000, f"marks.items.0.turns to the east is 40000: {I2}"),
    ("route", (1, 2, 3, 4, 5), "route.length to the east is 5: must be a whole number from 0 to 4 (uint8)"),
]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(("path", "value", "problem"), MISFITS)
@pytest.mark.filterwarnings("error")
def test_what_does_not_fit_fails_its_cell_with_the_same_words(
    form: str, path: str, value: Any, problem: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(PYTHON, "1")
    assert stepped(FORMS[form](changed(path, value), 0), 0)[1] == [f"message field {problem}"]


@pytest.mark.parametrize("form", FORMS)
def test_what_fits_arrives_with_zeros_behind_lists(form: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PYTHON, "1")
    shard, problems = stepped(FORMS[form](GOOD, 0), 0)
    assert problems == []
    message = arrived(shard)
    assert message.dtype == MESSAGE
    assert message["vector"].tolist() == [0.5, -1.0, float(np.float32(0.1))]
    assert message["grid"].tolist() == [[1, 2], [3, -4]]
    assert message["pose"].tolist() == ((1.5, -3), False)
    assert message["corners"].tolist() == [(2.5, 1), (-2.5, 2)]
    assert message["wide"] == 2**63 + 5
    assert message["route"]["length"] == 2
    assert message["route"]["items"].tolist() == [5, -6, 0, 0]
    assert message["marks"]["items"].tolist() == [(0.25, 9), (0.0, 0)]


def test_plain_programs_read_tuples_and_dictionaries() -> None:
    shard, _ = stepped(Plain(GOOD, 0), 0)
    presence = np.zeros((len(LATTICE), 1), dtype=np.bool_)
    got = cell_inputs(Inputs(presence, inbox=shard._inbox(None)), CULPRIT + 1).inbox["west"]
    assert got is not None
    assert got == {**GOOD, "vector": (0.5, -1.0, float(np.float32(0.1)))}
    assert type(got["vector"][0]) is float


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_compiled_steps_are_checked_alike_in_compared_ticks_and_after() -> None:
    for tick in (1, COMPARED_TICKS + 2):
        shard, problems = stepped(Scalar(GOOD, tick), tick)
        assert shard._kernel is not None
        assert problems == []
        assert arrived(shard).tobytes() == arrived(stepped(Arrays(GOOD, tick), tick)[0]).tobytes()
        for path, value, problem in MISFITS:
            assert stepped(Scalar(changed(path, value), tick), tick)[1] == [f"message field {problem}"]


class Reals(ScalarProgram):
    """Sends float64 alone, which the compiled step checks all at once."""

    message = np.dtype([("x", "<f8"), ("y", "<f8")])
    constants_type = np.dtype([("y", "<f8"), ("bad_tick", "<i8")])
    state_type = np.dtype([("column", "<i8"), ("tick", "<i8")])

    def __init__(self, y: float, bad_tick: int) -> None:
        super().__init__(NONE)
        self.y, self.bad_tick = y, bad_tick

    def constants(self) -> dict[str, Any]:
        return {"y": self.y, "bad_tick": self.bad_tick}

    def init(self, cells: Cells) -> State:
        return {"column": cells.column, "tick": np.zeros(len(cells), np.int64)}

    @staticmethod
    def cell_step(constants: Any, state: Any, inputs: Any, outputs: Any) -> None:
        outputs.speed_m_s[0] = 0.5
        outputs.message[WEST].y = constants.y  # is not sent
        outputs.sent[EAST] = 1
        if state.column == CULPRIT and state.tick == constants.bad_tick:
            outputs.message[EAST].y = constants.y
        state.tick += 1


@pytest.mark.parametrize("y", [float("nan"), float("inf"), -float("inf")])
def test_compiled_steps_refuse_float64_that_is_not_finite_where_it_is_sent(y: float) -> None:
    tick = COMPARED_TICKS + 2
    shard, problems = stepped(Reals(y, tick), tick)
    assert shard._kernel is not None
    assert problems == [f"message field y to the east is {y}: must be a finite number (float64)"]


@pytest.mark.parametrize(
    ("path", "value", "error"),
    [
        ("vector", (1.0, 2.0), "ValueError: message field vector to the east has 2 values: must have 3"),
        (
            "vector",
            1.0,
            "TypeError: message field vector to the east must be a list, a tuple or an array, not float",
        ),
        (
            "vector",
            "abc",
            "TypeError: message field vector to the east must be a list, a tuple or an array, not str",
        ),
        ("grid.1", (1,), "ValueError: message field grid[1] to the east has 1 values: must have 2"),
        ("pose.at", 3, "TypeError: message field pose.at to the east must be a mapping of x, turns, not int"),
        (
            "corners.0",
            {"x": 1.0},
            "ValueError: message field corners.0 to the east has fields ['x']; its type has ['turns', 'x']",
        ),
    ],
)
def test_a_message_of_another_structure_is_refused_by_name(path: str, value: Any, error: str) -> None:
    (problem,) = stepped(Plain(changed(path, value), 0), 0)[1]
    assert problem == error


@pytest.mark.parametrize("kind", [list, np.array])
def test_vectors_and_lists_may_be_lists_and_arrays(kind: Callable[[Any], Any]) -> None:
    given = {**GOOD, **{name: kind(GOOD[name]) for name in ("vector", "grid", "route")}}
    same = arrived(stepped(Plain(given, 0), 0)[0])
    assert same.tobytes() == arrived(stepped(Plain(GOOD, 0), 0)[0]).tobytes()


def test_a_bounded_list_is_declared_by_its_items_and_bound() -> None:
    assert bounded_list("<i2", 8) == np.dtype([("length", "u1"), ("items", "<i2", (8,))])
    assert bounded_list("<i2", 300)["length"] == np.dtype("<u2")
    for most in (0, 2**16):
        with pytest.raises(ValueError, match=f"most is {most}: must be 1 to 65535"):
            bounded_list("<i2", most)
