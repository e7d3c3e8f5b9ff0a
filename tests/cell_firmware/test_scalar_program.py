"""Programs of users in scalar form: compiled, held to the same source in Python, refused where they can't be."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.board import Board
from cell_firmware.errors import FirmwareError, FirmwareFailed
from cell_firmware.firmware import Cells
from cell_firmware.loader import find, load
from cell_firmware.scalar import constants_problem
from cell_firmware.scalar_program import COMPARED_TICKS, PYTHON, ScalarProgram, run_in_python
from cell_firmware.shard import Shard
from cell_firmware.specs import CellsSpec

PROGRAM = """
import numpy as np
from mdms import ScalarProgram, scalar_function
from mdms.kit import aged

FADE = 0.75

@scalar_function
def faded(value):
    return FADE * value

class Spread(ScalarProgram):
    message = np.dtype([("u", "<f8"), ("here", "?")])
    constants_type = np.dtype([("gain", "<f8")])
    state_type = np.dtype([("u", "<f8"), ("count", "<i2"), ("seen", "u1"), ("valid", "<i8")])

    def constants(self):
        return {"gain": 0.2}

    def init(self, cells):
        n = len(cells)
        return {"u": 0.1 * cells.row, "count": np.zeros(n, np.int16), "seen": np.zeros(n, np.bool_),
                "valid": np.zeros(n, np.int64)}

    @staticmethod
    def cell_step(constants, state, inputs, outputs):
        total = 0.0
        for side in range(4):
            if inputs.received[side]:
                total += inputs.message[side].u - state.u
                if inputs.message[side].here:
                    state.seen = 1
        state.valid = aged(inputs.received[1] != 0, state.valid, 3)
        state.u = faded(state.u + constants.gain * total)
        state.count = state.count + STEP
        for side in range(4):
            outputs.sent[side] = 1
            outputs.message[side].u = state.u
            outputs.message[side].here = inputs.presence[0] != 0
        outputs.speed_m_s[0], outputs.speed_m_s[1] = state.u, 0.5 * state.seen + state.valid
"""


def program(folder: Path, text: str, **replaced: str) -> Any:
    """The class of a program, from a file."""
    for old, new in replaced.items():
        text = text.replace(old, new)
    path = folder / "spread.py"
    path.write_text(text)
    return find(str(path))


def shard(kind: Any, rows: int = 3, columns: int = 4) -> Shard:
    lattice = Lattice((row, column) for row in range(rows) for column in range(columns))
    position_m = np.stack((0.1 * lattice.columns, 0.1 * lattice.rows), axis=1)
    cells = Cells.of(lattice, position_m, 0.004096)
    return Shard(Board(kind(kind.Parameters())), cells, Partition.even(lattice, 1), 0)


def drives(of: Shard, ticks: int) -> np.ndarray:
    """The drives of all ticks, under presence bits that wander."""
    bits = np.random.default_rng(7).random((ticks, len(of), 1)) < 0.2
    found = []
    for tick in range(ticks):
        outputs = of.step(tick, bits[tick])
        assert outputs.failures == ()
        found.append(outputs.drive.copy())
    return np.array(found)


@pytest.mark.slow
@pytest.mark.timeout(240)
def test_both_forms_give_the_same_drives_in_the_compared_ticks_and_after(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kind = program(tmp_path, PROGRAM, STEP="1")
    compiled = drives(shard(kind), 5 * COMPARED_TICKS)
    monkeypatch.setenv(PYTHON, "1")
    plain = drives(shard(kind), 5 * COMPARED_TICKS)
    assert plain.any()
    np.testing.assert_array_equal(compiled, plain)
    monkeypatch.delenv(PYTHON)
    # the same types with another step: another program
    wrapping = program(tmp_path, PROGRAM, STEP="20000\n        state.u += state.count + state.count > 32767")
    outputs = shard(wrapping).step(0, np.zeros((12, 1), np.bool_))
    assert len(outputs.failures) == 12
    problem = outputs.failures[0].problem
    assert problem.startswith("FormsDiffer: state.u is 1.0 compiled, and 0.0 in Python"), problem
    # ticks from payload to payload don't pass the comparison by
    kernel = shard(wrapping)._kernel
    assert kernel is not None
    assert kernel.run(COMPARED_TICKS - 1) is None
    # only what says that it returns soon is stepped in a thread of the transport
    assert not shard(kind).is_brief
    monkeypatch.setattr(kind, "is_brief", True)
    assert shard(kind).is_brief


def test_a_step_in_python_reads_and_writes_records(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PYTHON, "1")
    found = drives(shard(program(tmp_path, PROGRAM, STEP="1"), 2, 1), 3)
    u = np.array([0.0, 0.1])
    sent = None
    for tick in range(3):
        total = np.zeros(2) if sent is None else sent[::-1] - u
        u = 0.75 * (u + 0.2 * total)
        sent = u.copy()
        np.testing.assert_array_equal(found[tick][:, 0], u)


def test_fields_may_be_called_as_what_records_of_numpy_have(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(PYTHON, "1")
    expected = drives(shard(program(tmp_path, PROGRAM, STEP="1")), 12)
    other = PROGRAM.replace("state.u", "state.sum").replace(
        'state_type = np.dtype([("u"', 'state_type = np.dtype([("sum"'
    )
    other = other.replace('return {"u"', 'return {"sum"').replace("count", "size").replace('"here"', '"max"')
    other = other.replace("].here", "].max").replace("gain", "real")
    np.testing.assert_array_equal(drives(shard(program(tmp_path, other, STEP="1")), 12), expected)


def test_half_floats_are_refused_compiled_and_run_as_python(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kind = program(tmp_path, PROGRAM.replace('("u", "<f8"), ("here"', '("u", "<f2"), ("here"'), STEP="1")
    with pytest.raises(FirmwareError, match="can't be compiled: NotImplementedError: float16"):
        kind(kind.Parameters()).scalar_kernels()
    monkeypatch.setenv(PYTHON, "1")
    assert drives(shard(kind), 3).any()


def test_an_error_in_python_is_the_cell_s(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PYTHON, "1")
    one = shard(program(tmp_path, PROGRAM, STEP="1 // (state.count - state.count)"))
    with np.errstate(all="raise"):
        outputs = one.step(0, np.zeros((12, 1), np.bool_))
    assert {failure.problem.partition(":")[0] for failure in outputs.failures} <= {"ZeroDivisionError", ""}


class Elsewhere(ScalarProgram):
    state_type = np.dtype([("u", "<f8")])

    def init(self, cells: Cells) -> dict[str, np.ndarray]:
        return {"u": np.zeros(len(cells))}

    @staticmethod
    def cell_step(constants: Any, state: Any, inputs: Any, outputs: Any) -> None:
        del constants, inputs, outputs
        run_in_python(state, state, state, state, state)


def test_a_step_that_calls_what_can_t_be_compiled_with_it_is_refused_by_name() -> None:
    with pytest.raises(
        FirmwareError, match=r"Elsewhere\.cell_step calls run_in_python: it may call functions that are"
    ):
        load(CellsSpec(firmware=f"{__name__}:Elsewhere"))


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        (
            "state.valid = aged",
            "state.vaild = aged",
            "line 33 of spread.py: state has no field vaild; nearest: valid",
        ),
        (
            "outputs.message[side].u =",
            "outputs.message[side].w =",
            "line 38 of spread.py: outputs.message[side] has no field w; fields: u, here",
        ),
        ("total = 0.0", "total = zero", "line 27 of spread.py: name zero is not defined"),
        (
            "cell_step(constants, ",
            "cell_step(self, constants, ",
            (
                "has parameters self, constants, state, inputs, outputs: must be a static method of constants, state, "
                "inputs, outputs"
            ),
        ),
        (
            "outputs.message[side].u = state.u",
            "message = outputs.message[side]; message.v = state.u",
            "line 38 of spread.py: message has no field v; fields: u, here",
        ),
    ],
)
@pytest.mark.parametrize("in_python", [False, True])
def test_mistakes_that_show_in_the_source_are_refused_with_their_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, old: str, new: str, problem: str, in_python: bool
) -> None:
    if in_python:
        monkeypatch.setenv(PYTHON, "1")
    assert old in PROGRAM
    kind = program(tmp_path, PROGRAM.replace(old, new), STEP="1")
    with pytest.raises(FirmwareError) as caught:
        kind(kind.Parameters()).scalar_kernels()
    assert str(caught.value) == f"Spread.cell_step: {problem}"


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ('"u": 0.1 * cells.row, ', "", "state must have the fields u, count, seen, valid; missing u"),
        ('"u": 0.1', '"v": 0.1', "state must have the fields u, count, seen, valid; missing u; unknown v"),
        (
            "np.zeros(n, np.int16)",
            "np.full(n, 0.5)",
            "state['count'] has values that a field of int16 can't hold",
        ),
        (
            "np.zeros(n, np.int16)",
            "np.full(n, 40000)",
            "state['count'] has values that a field of int16 can't hold",
        ),
        ("np.zeros(n, np.int16)", "np.zeros((n, 2))", "state['count'] has the shape (1, 2): must be (1,)"),
    ],
)
def test_an_initial_state_must_have_the_fields_of_the_records(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, old: str, new: str, problem: str
) -> None:
    monkeypatch.setenv(PYTHON, "1")
    assert old in PROGRAM
    with pytest.raises(FirmwareFailed) as caught:
        drives(shard(program(tmp_path, PROGRAM.replace(old, new), STEP="1")), 1)
    assert caught.value.problem == f"init: {problem}"


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        ("None", "must return a dict with the fields gain, not NoneType"),
        ('{"gian": 0.2}', "must have the fields gain; missing gain; unknown gian"),
        ("{}", "must have the fields gain; missing gain"),
        ('{"gain": "fast"}', "gain is 'fast': must be float64"),
        ('{"gain": None}', "gain is None: must be float64"),
        ('{"gain": [1.0, 2.0]}', "gain is [1.0, 2.0]: must be float64"),
        ('{"gain": 1 / 0}', "raised ZeroDivisionError: division by zero"),
    ],
)
def test_constants_must_be_those_of_their_type(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: str, problem: str
) -> None:
    monkeypatch.setenv(PYTHON, "1")
    (tmp_path / "spread.py").write_text(PROGRAM.replace('{"gain": 0.2}', given).replace("STEP", "1"))
    with pytest.raises(FirmwareError, match=re.escape(f"firmware 'spread.py': constants() {problem}")):
        load(CellsSpec(firmware="spread.py"), tmp_path)


@pytest.mark.parametrize(
    ("kind", "value", "problem"),
    [
        ("<i8", 2, None),
        ("<i8", 2.0, None),
        ("<i8", 2.5, "n is 2.5: int64 would cut it to 2"),
        ("u1", 300, "n is 300: must be uint8"),
        ("u1", np.array(300), "n is array(300): uint8 would cut it to 44"),
        ("<f4", 0.1, None),
        (("<f8", (2,)), (0.0, 1.0), None),
        (("<i8", (2,)), (0.0, 1.5), "n is (0.0, 1.5): ('<i8', (2,)) would cut it to [0, 1]"),
        ([("x", "<f8")], (1.0,), None),
    ],
)
def test_constants_are_never_cut(kind: Any, value: object, problem: str | None) -> None:
    assert (
        constants_problem(
            np.dtype([("n", kind)] if not isinstance(kind, tuple) else [("n", *kind)]), {"n": value}
        )
        == problem
    )


def test_a_name_of_two_types_is_not_followed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PYTHON, "1")
    text = PROGRAM.replace(
        "total = 0.0", "one = state\n        one = outputs\n        total = 0.0 * one.served"
    )
    assert drives(shard(program(tmp_path, text, STEP="1")), 3).any()


@pytest.mark.slow
@pytest.mark.timeout(240)
def test_a_step_that_can_t_be_compiled_is_refused_with_numba_s_reason_and_the_line(tmp_path: Path) -> None:
    program(tmp_path, PROGRAM, STEP="sum([state.u])")
    with pytest.raises(FirmwareError) as caught:
        load(CellsSpec(firmware=str(tmp_path / "spread.py")))
    assert str(caught.value) == (
        "Spread.cell_step can't be compiled: line 35 of spread.py: there is no sum(list(float64)<iv=None>) (in: "
        f"state.count = state.count + sum([state.u])); to run it as Python, set {PYTHON}=1"
    )
