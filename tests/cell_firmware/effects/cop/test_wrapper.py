"""Cells with a watchdog: when a hung program is reset, what is lost, and that nobody else notices."""

from __future__ import annotations

from fractions import Fraction
from math import ceil
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from pydantic import ValidationError

from bus.partition import Partition
from cell_firmware.board import Board
from cell_firmware.cell import Cell, CellFirmware, CellInputs, CellOutputs, PerCellAdapter
from cell_firmware.clocks import ArrayClocks, CellClocks
from cell_firmware.components import WheelDriver
from cell_firmware.controller import Controller, StepTime
from cell_firmware.effects.clock.mailbox import Mailbox
from cell_firmware.effects.clock.wrapper import LocalClockWrapper
from cell_firmware.effects.cop.spec import TIMEOUTS_S, CopSpec
from cell_firmware.effects.cop.wrapper import WatchdogWrapper
from cell_firmware.effects.serial.lines import SerialLines
from cell_firmware.effects.serial.timing import LineSettings
from cell_firmware.errors import FirmwareFailed
from cell_firmware.firmware import Cells, Firmware, Inbox, Inputs, Outbox, Outputs, State
from cell_firmware.program import NoParameters
from cell_firmware.shard import Shard
from cell_firmware.specs import SpeedLoopSpec
from cell_firmware.speed_loop import SpeedLoop
from tests.cell_firmware.exchange import exchange

PERIOD_S, PERIOD_NS = 0.004096, 4_096_000


class Counting(Firmware):
    """Counts its steps since its start and messages received, and sends its count; on one column it fails."""

    message = np.dtype([("steps", "<i4")])
    hangs: ClassVar[dict[int, int]] = {1: 30}
    """By column, the count at which it raises; the second time it does not."""
    silent: ClassVar[dict[int, int]] = {}
    """By column, the count from which it no longer serves."""

    def __init__(self) -> None:
        super().__init__(self.Parameters())
        self.begun: list[list[int]] = []

    def init(self, cells: Cells) -> State:
        self.begun.append(cells.column.tolist())
        fails = np.array([self.hangs.get(column, -1) for column in cells.column.tolist()])
        quiet = np.array([self.silent.get(column, 1 << 30) for column in cells.column.tolist()])
        return {"steps": np.zeros(len(cells), dtype=np.int64), "fails": fails, "quiet": quiet}

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        steps = state["steps"]
        if (steps == state["fails"]).any():
            raise RuntimeError("stuck")
        outbox = Outbox.empty(len(steps), self.message)
        outbox.sent[:], outbox.message["steps"] = True, steps[:, None]
        inbox = inputs.inbox
        assert inbox is not None
        received = np.where(inbox.received, inbox.message["steps"] + 1, 0)
        speed = np.stack((steps + 1.0, received[:, 1] + 1000.0 * received[:, 3]), axis=1)
        served = steps < state["quiet"]
        return {**state, "steps": steps + 1}, Outputs(speed, outbox, served=None if served.all() else served)


class Patient(Counting):
    """Hangs never, but on some columns stops serving."""

    hangs: ClassVar[dict[int, int]] = {}
    silent: ClassVar[dict[int, int]] = {2: 10}


def watchdog(firmware: Firmware, timeout_s: float, reboot_s: float = 0.0, **board: Any) -> WatchdogWrapper:
    return WatchdogWrapper(
        Board(firmware, **board), CopSpec(timeout_s=timeout_s, reboot_s=reboot_s), PERIOD_NS
    )


def drives(controller: Controller, partition: Partition, cells: Cells, ticks: int) -> NDArray[np.float64]:
    """``(ticks, n, 2)`` of a lone shard; everybody takes part to the end."""
    shard = Shard(controller, cells, partition, 0)
    n, found = len(cells), []
    for tick in range(ticks):
        out = shard.step(tick, np.zeros((n, 1), dtype=np.bool_))
        assert out.failures == ()
        found.append(out.drive.copy())
    return np.array(found)


@pytest.fixture
def row(grid: Any, everything: Any) -> tuple[Partition, Cells]:
    """Four cells side by side, west to east."""
    lattice = grid(1, 4)
    return Partition.even(lattice, 1), everything(lattice)


@pytest.mark.parametrize("timeout_s", TIMEOUTS_S[:3])
@pytest.mark.parametrize("hang", [0, 1, 29, 30, 31, 32, 33])
@pytest.mark.parametrize("reboot_s", [0.0, 0.01, 0.05])
def test_a_program_that_hangs_is_reset_at_the_first_boundary_after_its_timeout_and_restarts(
    row: tuple[Partition, Cells],
    monkeypatch: pytest.MonkeyPatch,
    timeout_s: float,
    hang: int,
    reboot_s: float,
) -> None:
    monkeypatch.setattr(Counting, "hangs", {1: hang})
    found = drives(watchdog(Counting(), timeout_s, reboot_s), *row, 130)[:, 1, 0]
    # the last service in step hang - 1, or power-on; the divider's boundaries are multiples of 16.384 ms
    last, period = max(hang - 1, 0) * Fraction(4096, 1_000_000), Fraction(4096, 1_000_000)
    divider, timeout = Fraction(16_384, 1_000_000), Fraction(str(timeout_s))
    reset = ceil((last + timeout) / divider) * divider
    assert timeout <= reset - last < timeout + divider
    down, up = ceil(reset / period), ceil((reset + Fraction(str(reboot_s))) / period)
    wanted = np.concatenate(
        [
            np.arange(hang) + 1.0,
            np.full(down - hang, float(hang)),  # as the pins were
            np.zeros(up - down),
            np.arange(130 - up) + 1.0,
        ]
    )
    until = min(up + hang, 130)  # then it hangs again
    assert found[:until].tolist() == wanted[:until].tolist()


def test_a_hung_cell_neither_sends_nor_receives_and_is_a_neighbour_again_after_its_reset(
    row: tuple[Partition, Cells],
) -> None:
    found = drives(watchdog(Counting(), TIMEOUTS_S[0], 0.02), *row, 60)
    # hung from 30, last served at 29: 118.784 ms + 16.384 ms = 135.168 ms; the boundary is 147.456 ms, instant 36;
    # up from 167.456 ms on, instant 41
    assert found[30:36, 1].tolist() == [[30.0, found[29, 1, 1]]] * 6
    assert not found[36:41, 1].any()
    assert found[41, 1, 0] == 1.0
    # what cell 2 receives of it from the west, thousands: nothing sent in 30..40
    received = (found[:, 2, 1] // 1000).tolist()
    assert received[1:31] == list(range(1, 31))
    assert received[31:42] == [0.0] * 11
    assert received[42:] == [float(k) for k in range(1, 19)]
    # it receives from its neighbours from its first step on
    assert found[41, 1, 1] == 41.0 + 1000.0 * 41.0
    # and the others go on counting
    assert found[:, 3, 0].tolist() == [k + 1.0 for k in range(60)]


def test_a_program_that_runs_but_does_not_serve_goes_on_until_it_is_reset(
    row: tuple[Partition, Cells],
) -> None:
    found = drives(watchdog(Patient(), TIMEOUTS_S[0]), *row, 40)
    # last served at instant 9, 36.864 ms: reset at 65.536 ms, instant 16; again 9 + 16 = 25: 131.072 ms, instant 32
    assert found[:, 2, 0].tolist() == [*range(1, 17), *range(1, 17), *range(1, 9)]
    assert found[:, 1, 0].tolist() == list(range(1, 41))


def test_who_hangs_changes_nothing_about_who_does_not_serve(
    row: tuple[Partition, Cells], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Counting, "hangs", {1: 29})
    monkeypatch.setattr(Counting, "silent", {2: 29})
    found = drives(watchdog(Counting(), TIMEOUTS_S[0]), *row, 45)
    # both were last served in 28: 114.688 ms + 16.384 ms is a boundary, instant 32
    assert found[:, 1, 0].tolist() == [*range(1, 30), 29, 29, 29, *range(1, 14)]
    assert found[:, 2, 0].tolist() == [*range(1, 33), *range(1, 14)]


@pytest.mark.parametrize("firmware", [Counting, Patient])
def test_a_cell_alone_gets_the_same_bytes_as_among_many(
    firmware: type[Counting], everything: Any, grid: Any
) -> None:
    cells = everything(grid(1, 4))
    together = watchdog(firmware(), TIMEOUTS_S[0], 0.02)
    state = together.init(cells)
    alone = [watchdog(firmware(), TIMEOUTS_S[0], 0.02) for _ in range(4)]
    states = [one.init(cells.select(np.array([i]))) for i, one in enumerate(alone)]
    draw = np.random.default_rng(1)
    for tick in range(90):
        inbox = Inbox(draw.random((4, 4)) < 0.5, np.zeros((4, 4), dtype=Counting.message))
        inputs, now = Inputs(np.zeros((4, 1), dtype=np.bool_), None, inbox), StepTime(tick, np.array(0))
        state, out = exchange(together, now, state, inputs)
        assert out.outbox is not None
        for i in range(4):
            mine = np.array([i])
            states[i], single = exchange(alone[i], now, states[i], inputs.select(mine))
            assert single.drive.tobytes() == out.drive[mine].tobytes()
            sent = np.zeros(4, bool) if single.outbox is None else single.outbox.sent[0]
            assert sent.tolist() == out.outbox.sent[i].tolist()
            for part, arrays in states[i].parts.items():
                for name, array in arrays.items():
                    if name != "drive" or part != "firmware":
                        assert array.tobytes() == state.parts[part][name][mine].tobytes(), (part, name, tick)


class Odometer(WheelDriver):
    """Volts are the speed; remembers its steps, and through a reset how often it was reset."""

    def init(self, cells: Cells) -> State:
        return {"steps": np.zeros(len(cells)), "resets": np.zeros(len(cells))}

    def reset(self, cells: Cells, state: State) -> State:
        return {**self.init(cells), "resets": state["resets"] + 1.0}

    def step(self, state: State, reference_m_s: Any, encoder_m: Any) -> tuple[State, Any]:
        return {**state, "steps": state["steps"] + 1.0}, reference_m_s


def test_a_reset_reinitialises_power_on_state_and_retains_what_a_component_declares(
    everything: Any, grid: Any
) -> None:
    cells = everything(grid(1, 3))
    firmware = Counting()
    board = watchdog(firmware, TIMEOUTS_S[0], wheels=Odometer())
    state = board.init(cells)
    inbox = Inbox(np.zeros((3, 4), dtype=np.bool_), np.zeros((3, 4), dtype=Counting.message))
    for tick in range(38):
        inputs = Inputs(np.zeros((3, 1), dtype=np.bool_), np.zeros((3, 2)), inbox)
        state, _ = exchange(board, StepTime(tick, np.array(0)), state, inputs)
    assert firmware.begun == [[0, 1, 2], [1]]
    assert state.parts["speed_loop"]["resets"].tolist() == [0.0, 1.0, 0.0]
    assert state.parts["speed_loop"]["steps"].tolist() == [38.0, 2.0, 38.0]
    assert state.parts["firmware"]["steps"].tolist() == [38, 2, 38]
    assert board.counters(state) == {"cop.hangs": 1, "cop.resets": 1}
    shown = board.registers(state)
    assert shown["cop.resets"].tolist() == [0, 1, 0]
    assert shown["cop.hung"].tolist() == [False] * 3


def test_a_speed_loop_restarts_without_a_jump(everything: Any, grid: Any) -> None:
    """Its first reading after a reset is standing still, as after power-on, wherever the wheel is by then."""
    cells = everything(grid(1, 3))
    loop = SpeedLoop(SpeedLoopSpec(), PERIOD_S, 12.0)
    board, plain = (watchdog(Counting(), TIMEOUTS_S[0], wheels=loop) for _ in range(2))
    state, fresh = board.init(cells), plain.init(cells)
    inbox = Inbox(np.zeros((3, 4), dtype=np.bool_), np.zeros((3, 4), dtype=Counting.message))
    for tick in range(36):
        inputs = Inputs(np.zeros((3, 1), dtype=np.bool_), np.full((3, 2), 0.01 * tick), inbox)
        state, _ = exchange(board, StepTime(tick, np.array(0)), state, inputs)
    inputs = Inputs(np.zeros((3, 1), dtype=np.bool_), np.full((3, 2), 7.0), inbox)
    _, after = exchange(board, StepTime(36, np.array(0)), state, inputs)
    _, first = exchange(plain, StepTime(0, np.array(0)), fresh, inputs)
    assert after.drive[1].tobytes() == first.drive[1].tobytes()
    assert after.drive[0].tobytes() != first.drive[0].tobytes()


def test_a_switch_between_four_lines_turns_whether_the_program_runs_or_not(
    everything: Any, grid: Any
) -> None:
    settings = LineSettings(bit_ns=104_000, period_ns=PERIOD_NS, dwell_periods=3)
    cells = everything(grid(1, 4))
    lines = SerialLines(settings, Counting.message)
    board = watchdog(Counting(), TIMEOUTS_S[0], 0.02, links=lines)
    shard, unheard = Shard(board, cells, Partition.even(grid(1, 4), 1), 0), []
    for tick in range(70):
        shard.step(tick, np.zeros((4, 1), dtype=np.bool_))
        assert set(shard._state.parts["serial"]["periods"].tolist()) == {tick + 1}
        unheard.append(shard.counters()["serial.unheard"])
    # hung from instant 30, up from 41: neighbours face each other as before, and receive all
    assert unheard[47] == unheard[69]
    assert shard.counters()["cop.resets"] == 1
    received = shard.registers()[1]["serial.received"]
    assert (received[2] > 0).sum() == 2


def test_what_mailboxes_counted_outlives_a_reset(everything: Any, grid: Any) -> None:
    cells, lines = everything(grid(1, 2)), Mailbox(Counting.message, PERIOD_NS)
    state = {**lines.init(cells), "overwritten": np.full((2, 4), 3), "waits": np.ones((2, 4), dtype=np.bool_)}
    after = lines.reset(cells, state)
    assert (after["overwritten"] == 3).all()
    assert not after["waits"].any()


def test_in_its_own_time_a_cell_is_reset_alike_however_far_its_crystal_is_off(
    row: tuple[Partition, Cells],
) -> None:
    partition, cells = row
    ppb = np.array([0, 50_000_000, -50_000_000, 0])
    clocks = CellClocks(PERIOD_NS, PERIOD_NS * 95 // 100, ppb, np.array([0, 3_000_000, 10, 0]))
    lines = Mailbox(Counting.message, clocks.window_ns)
    clocked = LocalClockWrapper(
        watchdog(Counting(), TIMEOUTS_S[0], 0.02, links=lines), ArrayClocks(partition.lattice, clocks)
    )
    shard = Shard(clocked, cells, partition, 0)
    seen, before, hung = [], -1, []
    for tick in range(120):
        out = shard.step(tick, np.zeros((4, 1), dtype=np.bool_))
        hung += [(one.cell, one.tick - tick) for one in out.hung]
        count = int(shard.registers()[1]["clock.count"][1])
        if count > before and count:
            seen.append(out.drive[1, 0])
        before = count
    plain = drives(watchdog(Counting(), TIMEOUTS_S[0], 0.02), partition, cells, len(seen))[:, 1, 0]
    assert len(seen) > 100
    assert seen == plain.tolist()
    assert len(hung) > 1
    assert set(hung) == {((0, 1), 0)}  # reported in the exchange in which the plant receives it


def test_hangs_are_reported_when_they_begin_and_no_cell_is_lost(row: tuple[Partition, Cells]) -> None:
    partition, cells = row
    shard = Shard(watchdog(Counting(), TIMEOUTS_S[0]), cells, partition, 0)
    hung = {}
    for tick in range(70):
        out = shard.step(tick, np.zeros((4, 1), dtype=np.bool_))
        if out.hung:
            hung[tick] = [(one.cell, one.tick, one.problem) for one in out.hung]
            assert "raise RuntimeError" in out.hung[0].trace
    # reset at instant 36, and 30 steps later it hangs again
    assert hung == {tick: [((0, 1), tick, "RuntimeError: stuck")] for tick in (30, 66)}
    assert len(shard.alive) == 4
    assert shard.counters() == {"cop.hangs": 2, "cop.resets": 1}
    shard.retire([(0, 1)])
    assert shard.counters() == {"cop.hangs": 2, "cop.resets": 1}


@settings(max_examples=40, deadline=None)
@given(
    serves=st.lists(st.booleans(), min_size=80, max_size=80),
    timeout=st.sampled_from(TIMEOUTS_S[:2]),
    reboot_periods=st.fractions(0, 6, max_denominator=8),
)
def test_resets_are_those_of_a_counter_that_ticks_with_the_divider(
    serves: list[bool], timeout: float, reboot_periods: Fraction, everything: Any, grid: Any
) -> None:
    """Against the chip's own way: a counter that a service clears, and that the divider's boundaries advance."""
    cells = everything(grid(1, 1))
    reboot_s = float(reboot_periods * 4_096_000 // 1000 * Fraction(1, 1_000_000))
    board = watchdog(PerCellAdapter(_Script(serves)), timeout, reboot_s)
    state, resets = board.init(cells), []
    inputs = Inputs(np.zeros((1, 1), dtype=np.bool_))
    for tick in range(80):
        before = int(state.parts["cop"]["resets"][0])
        state, _ = exchange(board, StepTime(tick, np.array(0)), state, inputs)
        if state.parts["cop"]["resets"][0] > before:
            resets.append(tick)
    assert resets == _by_counter(serves, round(timeout / 0.016384), round(reboot_s * 1e9))


def _by_counter(serves: list[bool], most: int, reboot_ns: int) -> list[int]:
    """Instants at which resets are seen: a counter of whole divider cycles begun since the last service."""
    divider, served, starts, found, step = 16_384_000, 0, 0, [], 0
    for tick in range(len(serves)):
        now = tick * PERIOD_NS
        # a boundary at the very service counts, as it does for -0: whole cycles from the next boundary on
        first = served if served % divider == 0 else (served // divider + 1) * divider
        boundary = first
        for _ in range(most):
            boundary += divider
        if now >= boundary:
            found.append(tick)
            starts = served = boundary + reboot_ns
            step = 0
        if now >= starts:
            if serves[step]:
                served = now
            step += 1
    return found


class _Script(CellFirmware):
    """Serves as a list says, from each start on."""

    def __init__(self, serves: list[bool]) -> None:
        super().__init__(self.Parameters())
        self.serves = serves

    def init(self, cell: Cell) -> int:
        return 0

    def step(self, state: int, inputs: CellInputs) -> tuple[int, CellOutputs]:
        return state + 1, CellOutputs((0.0, 0.0), served=self.serves[state])


def test_what_firmware_says_of_its_service_must_be_a_bit_a_cell(everything: Any, grid: Any) -> None:
    class Odd(Firmware):
        def init(self, cells: Cells) -> State:
            return {}

        def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
            n = len(inputs.presence)
            return state, Outputs(np.zeros((n, 2)), served=np.ones(n, dtype=np.int64))  # type: ignore[arg-type]

    board = Board(Odd(Odd.Parameters()))
    _, out = exchange(
        board,
        StepTime(0, np.array(0)),
        board.init(everything(grid(1, 1))),
        Inputs(np.zeros((1, 1), dtype=np.bool_)),
    )
    assert "served must be None or bool of shape (1,), not int64 of shape (1,)" in out.failures[0].problem


@pytest.mark.parametrize(
    "cop", [{}, {"timeout_s": 0.02}, {"timeout_s": 0.016384, "reboot_s": -1.0}, {"timeout_s": -0.016384}]
)
def test_settings_that_the_chip_does_not_have_are_refused(cop: dict[str, float]) -> None:
    with pytest.raises(ValidationError, match="reboot_s" if "reboot_s" in cop else "timeout_s"):
        CopSpec.model_validate(cop)


class Survivor(CellFirmware):
    """Raises in its third step after each start; counts its starts in memory that a watchdog's reset leaves."""

    keeps: ClassVar[bool] = True

    def init(self, cell: Cell) -> tuple[int, int]:
        return 1, 0

    def warm_start(self, cell: Cell, state: tuple[int, int]) -> tuple[int, int]:
        return (state[0] + 1, 0) if self.keeps else super().warm_start(cell, state)

    def step(self, state: tuple[int, int], inputs: CellInputs) -> tuple[tuple[int, int], CellOutputs]:
        starts, steps = state
        if steps == 2:
            raise RuntimeError("hangs")
        return (starts, steps + 1), CellOutputs((float(starts), 0.0))


@pytest.mark.parametrize("keeps", [True, False])
def test_memory_that_a_program_sets_aside_survives_a_watchdogs_reset(
    row: tuple[Partition, Cells], monkeypatch: pytest.MonkeyPatch, keeps: bool
) -> None:
    monkeypatch.setattr(Survivor, "keeps", keeps)
    found = drives(watchdog(PerCellAdapter(Survivor(NoParameters())), TIMEOUTS_S[0]), *row, 40)[:, :, 0]
    assert sorted(set(found.ravel().tolist())) == ([1.0, 2.0, 3.0, 4.0, 5.0] if keeps else [1.0])


def test_memory_does_not_survive_a_loss_of_power(row: tuple[Partition, Cells]) -> None:
    controller = watchdog(PerCellAdapter(Survivor(NoParameters())), TIMEOUTS_S[0])
    state = controller.init(row[1])
    retained = controller.controller.reset(controller.unwrap_state(state), warm=True)
    lost = controller.controller.reset(retained)
    assert [one.parts["firmware"]["cell"][0] for one in (retained, lost)] == [(2, 0), (1, 0)]


def test_a_program_that_does_not_start_after_a_reset_is_named(row: tuple[Partition, Cells]) -> None:
    class Lost(Survivor):
        def warm_start(self, cell: Cell, state: tuple[int, int]) -> tuple[int, int]:
            return state if cell.column != 2 else (1 // 0, 0)

    with pytest.raises(FirmwareFailed, match=r"cell 0,2 failed.*warm_start: ZeroDivisionError"):
        drives(watchdog(PerCellAdapter(Lost(NoParameters())), TIMEOUTS_S[0]), *row, 12)
