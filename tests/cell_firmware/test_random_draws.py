"""Random numbers of programs: the generator, its statistics, and the same numbers in every form and partition."""

from __future__ import annotations

import itertools
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from bus.lattice import Lattice
from bus.partition import Partition
from bus.random_streams import stream_key
from cell_firmware.board import Board
from cell_firmware.cell import Cell, CellFirmware, CellInputs, CellOutputs, PerCellAdapter
from cell_firmware.clocks import ArrayClocks, CellClocks
from cell_firmware.controller import StepTime
from cell_firmware.errors import FirmwareError
from cell_firmware.firmware import Cells, Firmware, Inbox, Inputs, Outbox, Outputs, State
from cell_firmware.loader import find
from cell_firmware.program import NoParameters
from cell_firmware.random_draws import CellStreams
from cell_firmware.scalar_program import COMPARED_TICKS, PYTHON, ScalarProgram

TICKS = COMPARED_TICKS + 4
MESSAGE = np.dtype([("slot", "<i4")])


class Plain(CellFirmware):
    """Sends at a random time in a random slot, and drives what it drew."""

    message = MESSAGE
    random = ("turn", "slot")

    def init(self, cell: Cell) -> tuple[float, int]:
        return cell.random["turn"], 0

    def step(self, state: tuple[float, int], inputs: CellInputs) -> tuple[tuple[float, int], CellOutputs]:
        begun, heard = state
        heard += sum(message["slot"] for message in inputs.inbox.values() if message is not None)
        slot = int(16 * inputs.random["slot"])
        sides = inputs.inbox if inputs.random["turn"] < 0.5 else ()
        outbox = {side: {"slot": slot} for side in sides}
        return (begun, heard), CellOutputs((begun + inputs.random["turn"], float(heard)), outbox)


class Arrays(Firmware):
    """The same on arrays."""

    message = MESSAGE
    random = ("turn", "slot")

    def init(self, cells: Cells) -> State:
        return {"begun": cells.random["turn"].copy(), "heard": np.zeros(len(cells), dtype=np.int64)}

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        assert inputs.inbox is not None
        slots = inputs.inbox.message["slot"]
        heard = state["heard"] + slots[:, 0] + slots[:, 1] + slots[:, 2] + slots[:, 3]
        outbox = Outbox.to_all(self.message, slot=np.floor(16 * inputs.random["slot"]))
        outbox.sent[...] = (inputs.random["turn"] < 0.5)[:, None]
        speed = np.stack((state["begun"] + inputs.random["turn"], heard.astype(np.float64)), axis=1)
        return {**state, "heard": heard}, Outputs(speed, outbox)


class Scalar(ScalarProgram):
    """The same in scalar form."""

    message = MESSAGE
    random = ("turn", "slot")
    state_type = np.dtype([("begun", "<f8"), ("heard", "<i8")])

    def init(self, cells: Cells) -> State:
        return {"begun": cells.random["turn"].copy(), "heard": np.zeros(len(cells), dtype=np.int64)}

    @staticmethod
    def cell_step(constants: Any, state: Any, inputs: Any, outputs: Any) -> None:
        for side in range(4):
            if inputs.received[side]:
                state.heard += inputs.message[side].slot
            outputs.sent[side] = inputs.random.turn < 0.5
            outputs.message[side].slot = int(16 * inputs.random.slot)
        outputs.speed_m_s[0] = state.begun + inputs.random.turn
        outputs.speed_m_s[1] = state.heard


def firmware_of(kind: Any) -> Firmware:
    program = kind(NoParameters())
    return PerCellAdapter(program) if isinstance(program, CellFirmware) else program


def words(seed: int, name: str, tick: int, row: int, column: int) -> list[int]:
    """Philox 4x32-10 in Python's integers, by the paper's text."""
    word, k = 0xFFFFFFFF, list(stream_key(seed, f"firmware {name}"))
    c = [tick & word, tick >> 32, row, column]
    for _ in range(10):
        p, q = 0xD2511F53 * c[0], 0xCD9E8D57 * c[2]
        c = [(q >> 32) ^ c[1] ^ k[0], q & word, (p >> 32) ^ c[3] ^ k[1], p & word]
        k = [(k[0] + 0x9E3779B9) & word, (k[1] + 0xBB67AE85) & word]
    return c


@pytest.mark.parametrize(
    ("counter", "key", "expected"),
    [
        ([0] * 4, [0] * 2, [0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8]),
        ([0xFFFFFFFF] * 4, [0xFFFFFFFF] * 2, [0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD]),
        (
            [0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344],
            [0xA4093822, 0x299F31D0],
            [0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1],
        ),
    ],
)
def test_the_generator_gives_the_published_words(
    counter: list[int], key: list[int], expected: list[int]
) -> None:
    """Known answers of the library Random123, by the paper's authors."""
    from cell_firmware.kernels.draws import encrypt

    found = np.zeros(4, dtype=np.uint64)
    encrypt(np.array(counter, dtype=np.uint64), np.array(key, dtype=np.uint64), found)
    assert found.tolist() == expected


def test_a_number_is_the_papers_function_of_seed_name_tick_row_and_column(
    grid: Callable[..., Lattice], everything: Callable[..., Cells]
) -> None:
    cells = everything(grid(3, 4))
    for seed in (0, 1, 2**62):
        streams = CellStreams(("a", "b"), seed)
        for tick in (-1, 0, 7, 2**33):
            draws = streams.of_tick(tick, cells.row, cells.column)
            for name in ("a", "b"):
                for i in range(len(cells)):
                    first, second, *_ = words(seed, name, tick + 1, *cells.name(i))
                    assert draws[name][i] == ((first << 21) | (second >> 11)) * 2.0**-53


@pytest.fixture(scope="module")
def numbers(grid: Callable[..., Lattice], everything: Callable[..., Cells]) -> np.ndarray:
    """``(seeds, ticks, names, rows, columns)`` of 20 seeds, 12 ticks, 3 names, and 30 x 30 cells."""
    cells = everything(grid(30, 30))
    found = [
        [
            list(CellStreams(("a", "b", "c"), seed).of_tick(tick, cells.row, cells.column).values())
            for tick in range(12)
        ]
        for seed in range(20)
    ]
    return np.array(found).reshape(20, 12, 3, 30, 30)


def test_numbers_are_uniform(numbers: np.ndarray) -> None:
    """Chi-squared over 64 bins and Kolmogorov-Smirnov, for each seed: the least of 20 p-values, times 20, is no less
    than 0.01."""
    assert numbers.min() >= 0.0
    assert numbers.max() < 1.0
    for values in numbers.reshape(20, -1):
        counts, _ = np.histogram(values, 64, (0.0, 1.0))
        assert stats.chisquare(counts).pvalue > 0.01 / 20
        assert stats.kstest(values, "uniform").pvalue > 0.01 / 20


@pytest.mark.parametrize("bit", [0, 1, 8, 31, 32, 52])
def test_every_bit_of_a_number_is_even(numbers: np.ndarray, bit: int) -> None:
    whole = (numbers * 2.0**53).astype(np.uint64)
    for values in (whole >> np.uint64(bit)).reshape(20, -1) & np.uint64(1):
        assert stats.binomtest(int(values.sum()), values.size).pvalue > 0.01 / 20


@pytest.mark.parametrize("axis", [1, 2, 3, 4], ids=["ticks", "names", "rows", "columns"])
def test_neighbouring_numbers_are_independent(numbers: np.ndarray, axis: int) -> None:
    """Pearson's correlation, and chi-squared over 8 x 8 bins of pairs, for each seed."""
    length = numbers.shape[axis]
    one, other = numbers.take(range(length - 1), axis), numbers.take(range(1, length), axis)
    for a, b in zip(one.reshape(20, -1), other.reshape(20, -1), strict=True):
        assert correlation_p(a, b) > 0.01 / 20
        pairs, _, _ = np.histogram2d(a, b, 8, ((0.0, 1.0), (0.0, 1.0)))
        assert stats.chisquare(pairs.ravel()).pvalue > 0.01 / 20


def test_seeds_are_independent(numbers: np.ndarray) -> None:
    found = numbers.reshape(20, -1)
    for a, b in itertools.pairwise(found):
        assert correlation_p(a, b) > 0.01 / 19


def correlation_p(a: np.ndarray, b: np.ndarray) -> float:
    """Two-sided p-value of Pearson's correlation."""
    _, p = stats.pearsonr(a, b)
    return float(p)


@pytest.mark.parametrize(
    ("kind", "in_python"),
    [
        (Arrays, ""),
        pytest.param(Scalar, "1", marks=pytest.mark.slow),
        pytest.param(Scalar, "", marks=pytest.mark.slow),
    ],
)
@pytest.mark.timeout(240)
def test_all_forms_have_the_same_numbers(
    kind: Any,
    in_python: str,
    grid: Callable[..., Lattice],
    run: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv(PYTHON, in_python)
    whole = Partition.even(grid(3, 4, missing=[(1, 2)]), 1)
    # the kernel's tick begins after those that are compared, and goes on with fewer cells
    dead = {COMPARED_TICKS + 1: [(0, 1)]}
    plain, other = (run(firmware_of(one), whole, TICKS, dead=dead, seed=5) for one in (Plain, kind))
    assert plain.failures == other.failures == []
    assert plain.drives.tobytes() == other.drives.tobytes()
    assert len(set(plain.drives[:, :, 0].ravel().tolist())) > 100


@pytest.mark.parametrize("kind", [Plain, Arrays])
def test_numbers_do_not_depend_on_the_partition_or_the_array(
    kind: Any, grid: Callable[..., Lattice], run: Callable[..., Any]
) -> None:
    lattice = grid(2, 4)
    whole = run(firmware_of(kind), Partition.even(lattice, 1), TICKS, seed=5)
    for partition in (Partition.even(lattice, 3), Partition.each(lattice)):
        assert run(firmware_of(kind), partition, TICKS, seed=5).drives.tobytes() == whole.drives.tobytes()
    alone = run(firmware_of(kind), Partition.even(Lattice([(1, 2)]), 1), TICKS, seed=5)
    index = lattice.cells.index((1, 2))
    assert alone.drives[:, 0, 0].tobytes() == whole.drives[:, index, 0].tobytes()
    other = run(firmware_of(kind), Partition.even(lattice, 1), TICKS, seed=6)
    assert not np.isin(other.drives[:, :, 0], whole.drives[:, :, 0]).any()


def test_cells_with_clocks_of_their_own_draw_by_window_compiled_or_not(
    grid: Callable[..., Lattice], run: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    lattice = grid(2, 3)
    n, period_ns = len(lattice), 4_096_000
    clocks = CellClocks(
        period_ns, period_ns // 2, np.zeros(n, dtype=np.int64), np.arange(n, dtype=np.int64) * 500_000
    )
    boards = ArrayClocks(lattice, clocks)
    whole = Partition.even(lattice, 1)
    compiled = run(firmware_of(Arrays), whole, 20, clocks=boards, seed=5)
    monkeypatch.setattr("cell_firmware.shard.has_kernels", lambda _: False)
    general = run(firmware_of(Arrays), whole, 20, clocks=boards, seed=5)
    assert compiled.failures == general.failures == []
    assert compiled.drives.tobytes() == general.drives.tobytes()
    assert np.unique(compiled.drives[:, :, 0]).size > 40


def test_a_step_is_given_the_same_numbers_again(everything: Callable[..., Cells]) -> None:
    """State and inputs are all that a step depends on: restoring them restores the run."""
    board = Board(firmware_of(Arrays), seed=9)
    cells = everything(Lattice([(0, 0), (0, 1)]))
    state = board.init(cells)
    inbox = Inbox(np.zeros((2, 4), dtype=np.bool_), np.zeros((2, 4), dtype=MESSAGE))
    inputs = Inputs(np.zeros((2, 1), dtype=np.bool_), inbox=inbox)
    first = board.compute(StepTime(3, np.array(0)), state, inputs)[1].drive
    board.compute(StepTime(4, np.array(0)), state, inputs)
    assert board.compute(StepTime(3, np.array(0)), state, inputs)[1].drive.tobytes() == first.tobytes()
    again = board.reset(state)
    assert again.parts["firmware"]["begun"].tobytes() == state.parts["firmware"]["begun"].tobytes()


def test_a_name_that_is_not_declared_fails_the_cell_and_says_what_to_do(
    grid: Callable[..., Lattice], run: Callable[..., Any]
) -> None:
    class Odd(Plain):
        random = ("turn",)

    (failure, *_) = run(firmware_of(Odd), Partition.even(grid(1, 2), 1), 1).failures
    assert failure.cell == (0, 0)
    assert "'slot' is not among the program's random numbers; it declares turn: add it to" in failure.problem


@pytest.mark.parametrize("random", ["['turn']", "'turn'", "('turn', 'turn')", "('a b',)"])
def test_names_that_are_no_tuple_of_different_identifiers_are_refused(random: str, tmp_path: Path) -> None:
    path = tmp_path / "odd.py"
    path.write_text(
        "from mdms import CellFirmware\n\n\nclass Odd(CellFirmware):\n"
        f"    random = {random}\n"
        "    def init(self, cell): ...\n    def step(self, state, inputs): ...\n"
    )
    with pytest.raises(FirmwareError, match="random must be a tuple of different names, such as"):
        find(str(path))


def test_a_program_that_draws_nothing_has_no_streams_no_fields_and_no_kernel_of_them() -> None:
    """What isn't there costs nothing: no draw, no field of a record, no module."""
    script = """
import sys
import numpy as np
from cell_firmware.build import build_controller, kernel_modules
from cell_firmware.effects.registry import CellEffects
from cell_firmware.loader import load
from cell_firmware.specs import CellsSpec
spec = CellsSpec(firmware="wave")
controller = build_controller(load(spec), spec, CellEffects(), None)
assert controller.streams is None
assert "cell_firmware.kernels.draws" not in kernel_modules(controller, CellEffects())
assert "cell_firmware.kernels.draws" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", script], check=True, timeout=60)
    from cell_firmware.kernels.program import inputs_type

    assert "random" not in (inputs_type(MESSAGE).names or ())
