"""Cells that step at instants of their own, among each other and against a list of what happens when."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from math import floor
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bus.lattice import OPPOSITE, Lattice
from bus.partition import Partition
from cell_firmware.board import Board
from cell_firmware.clocks import ArrayClocks, CellClocks
from cell_firmware.controller import StepTime
from cell_firmware.effects.clock.mailbox import Mailbox
from cell_firmware.effects.clock.wrapper import LocalClockWrapper
from cell_firmware.effects.link_delay import LinkDelaySpec
from cell_firmware.effects.registry import CellEffects
from cell_firmware.firmware import Cells, Firmware, Inputs, Outbox, Outputs, State
from cell_firmware.program import NoParameters
from tests.cell_firmware.exchange import exchange as exchanged

PERIOD_NS = 4_096_000

Received = dict[tuple[int, int, int], list[int]]
"""By row, column and number of the step, what was received on each side; −1 for nothing."""


class Counting(Firmware):
    """Drives and sends the number of its step, counted from 1; notes what it receives."""

    speculative = False  # it notes every step, and those that are rolled back are none

    message = np.dtype([("after_ns", "<i4")])  # the name that a stamp would like to have

    def __init__(self) -> None:
        super().__init__(NoParameters())
        self.received: Received = {}

    def init(self, cells: Cells) -> State:
        return {"step": np.zeros(len(cells), dtype=np.int64), "row": cells.row, "column": cells.column}

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        assert inputs.inbox is not None
        received, numbers = inputs.inbox.received, inputs.inbox.message["after_ns"]
        assert not numbers[~received].any(), "a slot without a message reads zero"
        number = state["step"] + 1
        for row, column, step, got in zip(
            state["row"].tolist(), state["column"].tolist(), number.tolist(),
            np.where(received, numbers, -1).tolist(), strict=True,
        ):  # fmt: skip
            self.received[row, column, step] = got
        message = np.empty(received.shape, dtype=self.message)
        message["after_ns"] = number[:, None]
        drive = np.stack((number, inputs.presence[:, 0]), axis=1).astype(np.float64)
        return {**state, "step": number}, Outputs(drive, Outbox(np.ones_like(received), message))


def clocks_of(lattice: Lattice, ppb: list[int], phase_ns: list[int], exchanges: int = 1) -> ArrayClocks:
    window_ns = PERIOD_NS * (10**9 + min(ppb)) // 10**9 // exchanges
    return ArrayClocks(lattice, CellClocks(PERIOD_NS, window_ns, np.array(ppb), np.array(phase_ns)))


def instants(clocks: CellClocks, cell: int, until_ns: int) -> list[int]:
    """By definition."""
    factor = PERIOD_NS * (1 + Fraction(int(clocks.ppb[cell]), 10**9))
    found: list[int] = []
    while (at := int(clocks.phase_ns[cell]) + floor(len(found) * factor)) < until_ns:
        found.append(at)
    return found


def test_two_cells_100_ppm_apart_slip_a_period_in_41_s(
    grid: Callable[..., Lattice], lockstep: Callable[..., Any]
):
    lattice = grid(1, 2)
    steps = lockstep(
        Counting(), Partition.even(lattice, 1), clocks=clocks_of(lattice, [-50_000, 50_000], [0, 0])
    )
    steps.step()
    for exchange in range(1, 10_200):  # 41.8 s
        fast, slow = steps.step()[:, 0].tolist()
        assert fast == exchange
        if slow < exchange:
            break
    assert slow == exchange - 1
    assert 40 <= exchange * PERIOD_NS * 1e-9 <= 42


@pytest.mark.parametrize("exchanges", [1, 3])
def test_every_cell_steps_as_often_as_its_clock_ticks(
    exchanges: int, grid: Callable[..., Lattice], run: Callable[..., Any]
):
    lattice = grid(2, 3)
    draw = np.random.default_rng(exchanges)
    ppb, phase = draw.integers(-60_000_000, 60_000_001, 6), draw.integers(0, PERIOD_NS, 6)
    clocks = clocks_of(lattice, ppb.tolist(), phase.tolist(), exchanges)
    drives = run(Counting(), Partition.even(lattice, 2), 700, clocks=clocks).drives
    for cell in range(6):
        for ticks in (1, 2, 100, 699):
            assert drives[ticks, cell, 0] == len(
                instants(clocks.clocks, cell, ticks * clocks.clocks.window_ns)
            )


def expected(clocks: ArrayClocks, until_ns: int, delay_ns: int) -> tuple[Received, int]:
    """What each step receives and how many messages are replaced, from all that happens, in order of time.

    At one instant messages are there before cells read.
    """
    lattice, found = clocks.lattice, {}
    at = [instants(clocks.clocks, cell, until_ns) for cell in range(len(lattice))]
    boxes: dict[tuple[int, int], int] = {}
    replaced = 0
    happens: list[tuple[int, int, int, int]] = []
    for cell, times in enumerate(at):
        for step, time in enumerate(times, start=1):
            happens += [(time, 1, cell, step), (time + delay_ns, 0, cell, step)]
    for time, reads, cell, step in sorted(happens):
        if time >= until_ns:
            break
        for side, neighbour in enumerate(lattice.neighbours[cell].tolist()):
            if reads:
                found.setdefault((*lattice.cells[cell], step), []).append(boxes.pop((cell, side), -1))
            elif neighbour >= 0:
                replaced += (neighbour, OPPOSITE[side]) in boxes
                boxes[neighbour, OPPOSITE[side]] = step
    return found, replaced


@settings(max_examples=40)
@given(data=st.data())
def test_a_message_is_read_once_a_window_after_it_was_sent_unless_a_newer_one_is_there(
    grid: Callable[..., Lattice], run: Callable[..., Any], data: st.DataObject
):
    lattice = grid(data.draw(st.integers(1, 2)), data.draw(st.integers(2, 3)))
    n = len(lattice)
    errors = st.integers(-60_000_000, 60_000_000) | st.sampled_from([0, 50_000_000])
    phases = st.integers(0, PERIOD_NS - 1) | st.sampled_from([0, 1, PERIOD_NS // 2])
    clocks = clocks_of(
        lattice,
        data.draw(st.lists(errors, min_size=n, max_size=n)),
        data.draw(st.lists(phases, min_size=n, max_size=n)),
        data.draw(st.integers(1, 4)),
    )
    ticks, delay = 40, data.draw(st.integers(0, 2))
    effects = CellEffects(link_delay=LinkDelaySpec(ticks=delay))
    firmware = Counting()
    counted = run(firmware, Partition.even(lattice, 1), ticks, clocks=clocks, effects=effects).counted
    window_ns = clocks.clocks.window_ns
    received, replaced = expected(clocks, (ticks - 1) * window_ns, (1 + delay) * window_ns)
    assert firmware.received == received
    assert counted["clock.overwritten"] == replaced


def test_with_equal_clocks_all_is_as_without_clocks_one_exchange_later(
    grid: Callable[..., Lattice], run: Callable[..., Any]
):
    lattice = grid(2, 3)
    partition, ticks = Partition.even(lattice, 2), 12
    presence = np.random.default_rng(3).random((ticks, 6, 1)) < 0.5
    later = np.concatenate((presence[:1], presence[:-1]))
    plain, clocked = Counting(), Counting()
    drives = run(plain, partition, ticks, presence=presence).drives
    shifted = run(
        clocked, partition, ticks, presence=later, clocks=clocks_of(lattice, [0] * 6, [0] * 6)
    ).drives
    assert not shifted[0].any()
    np.testing.assert_array_equal(shifted[1:], drives[:-1])
    assert clocked.received == {key: got for key, got in plain.received.items() if key[2] < ticks}


def test_a_cell_that_is_not_stepped_receives_nothing_and_keeps_its_state(
    grid: Callable[..., Lattice], run: Callable[..., Any]
):
    lattice = grid(1, 2)
    clocks = clocks_of(lattice, [0, 0], [0, PERIOD_NS - 1], 4)
    presence = np.zeros((9, 2, 1), dtype=np.bool_)
    presence[1, 0] = presence[2:5, 0] = presence[4, 1] = (
        True  # cell 0 reads in windows 0 and 4, cell 1 in 3 and 7
    )
    drives = run(Counting(), Partition.even(lattice, 1), 9, presence=presence, clocks=clocks).drives
    assert drives[:, 0].tolist() == [[0, 0], *[[1, 1]] * 4, *[[2, 0]] * 4]
    assert drives[:, 1].tolist() == [*[[0, 0]] * 4, *[[1, 1]] * 4, [2, 0]]


def test_a_cell_that_fails_at_its_instant_is_named_and_the_others_go_on(
    grid: Callable[..., Lattice], run: Callable[..., Any]
):
    class Failing(Counting):
        def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
            if ((state["column"] == 1) & (state["step"] == 2)).any():
                raise ValueError("no")
            return super().step(state, inputs)

    lattice = grid(1, 3)
    clocks = clocks_of(lattice, [0] * 3, [0, PERIOD_NS // 2, 0], 2)
    came = run(Failing(), Partition.even(lattice, 1), 9, clocks=clocks)
    assert [(failure.cell, failure.tick) for failure in came.failures] == [((0, 1), 6)]
    assert came.drives[:, 1, 0].tolist() == [0, 0, 1, 1, 2, 2, 0, 0, 0]
    assert came.drives[:, 2, 0].tolist() == [0, 1, 1, 2, 2, 3, 3, 4, 4]


def test_failures_are_reported_by_row_and_tick(
    grid: Callable[..., Lattice], everything: Callable[..., Cells]
):
    class Failing(Counting):
        message = None  # pyright: ignore[reportAssignmentType, reportIncompatibleVariableOverride]

        def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
            raise ValueError("no")

    lattice, bits = grid(1, 3), np.zeros((3, 1), dtype=np.bool_)
    controller = LocalClockWrapper(Board(Failing()), clocks_of(lattice, [0] * 3, [PERIOD_NS // 2, 0, 0], 2))
    state = controller.init(everything(lattice))
    _, outputs = exchanged(controller, StepTime(1, np.array(0)), state, Inputs(bits))
    assert {i: (failure.cell, failure.tick) for i, failure in outputs.failures.items()} == {
        1: ((0, 1), 1),
        2: ((0, 2), 1),
    }


def test_registers_show_the_state_of_the_clocks(
    grid: Callable[..., Lattice], everything: Callable[..., Cells]
):
    lattice = grid(1, 2)
    clocks = clocks_of(lattice, [0, 7], [0, 5])
    controller = LocalClockWrapper(
        Board(Counting(), None, Mailbox(Counting.message, clocks.clocks.window_ns)), clocks
    )
    registers = controller.registers(controller.init(everything(lattice)))
    assert registers["clock.ppb"].tolist() == [0, 7]
    assert registers["clock.count"].tolist() == [0, 0]
