"""Messages of every cell's program, counted where the program hands them over."""

from __future__ import annotations

import numpy as np
import pytest

from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.build import build_controller
from cell_firmware.effects.base import ShardContext
from cell_firmware.effects.registry import CellEffects
from cell_firmware.firmware import Cells, Firmware, Inputs, Outbox, Outputs, State
from cell_firmware.program import NoParameters
from cell_firmware.shard import Shard
from cell_firmware.specs import CellsSpec
from tests.cell_firmware.conftest import cells_of

TICKS = 12
SPEC = CellsSpec()


class Talks(Firmware):
    """Says something to all sides in every period that its own count of periods is even in."""

    message = np.dtype([("word", "u1")])

    def init(self, cells: Cells) -> State:
        return {"period": np.zeros(len(cells), dtype=np.int64)}

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        n = len(state["period"])
        even = state["period"] % 2 == 0
        outbox = Outbox(np.repeat(even[:, None], 4, axis=1), np.zeros((n, 4), dtype=self.message))
        return {"period": state["period"] + 1}, Outputs(np.zeros((n, 2)), outbox)


def shard(effects: CellEffects) -> Shard:
    """2 x 3 cells, 7 links, in one shard."""
    lattice = Lattice((row, column) for row in range(2) for column in range(3))
    partition, firmware = Partition.even(lattice, 1), Talks(NoParameters())
    clocks = None if effects.clock is None else effects.clock.clocks(lattice, SPEC.period_ns, 3)
    controller = build_controller(firmware, SPEC, effects, None, clocks, metered=True)
    site = ShardContext(partition.cells(0), 1, controller.link_type, seed=5)
    return Shard(controller, cells_of(lattice), partition, 0, effects.input_filters(site))


def run(effects: CellEffects, ticks: int = TICKS) -> Shard:
    running = shard(effects)
    for tick in range(ticks):
        running.step(tick, np.zeros((6, 1), dtype=np.bool_))
    return running


def test_what_a_program_says_where_nobody_is_does_not_count() -> None:
    counted = run(CellEffects()).counters()
    assert counted["messages.sent"] == TICKS // 2 * 14
    assert counted["messages.received"] == TICKS // 2 * 14
    _, registers = run(CellEffects(), ticks=3).registers()
    assert registers["messages.sent"].tolist() == [4, 6, 4, 4, 6, 4]
    assert registers["messages.received"].tolist() == [2, 3, 2, 2, 3, 2]


def test_lost_messages_count_as_sent_and_not_as_received() -> None:
    counted = run(CellEffects.model_validate({"link_loss": {"probability": 0.3}})).counters()
    assert counted["messages.sent"] - counted["messages.received"] == counted["link_loss.lost"] > 0


@pytest.mark.parametrize("baud", [9615, 125_000])
def test_over_lines_whole_messages_count_and_not_bytes(baud: int) -> None:
    counted = run(CellEffects.model_validate({"serial": {"baud": baud}}), ticks=13).counters()
    assert counted["messages.sent"] == 7 * 14
    assert counted["messages.received"] == 6 * 14
    assert counted["serial.received"] == 2 * 6 * 14  # bytes: a field and a check


def test_with_clocks_of_their_own_cells_count_the_periods_that_were_theirs() -> None:
    clocked = run(CellEffects.model_validate({"clock": {"error_ppm": 0.0}}), ticks=20)
    _, registers = clocked.registers()
    links = np.array([2, 3, 2, 2, 3, 2])
    np.testing.assert_array_equal(registers["messages.sent"], links * -(-registers["clock.count"] // 2))


def test_the_dead_keep_what_they_had_counted() -> None:
    running = run(CellEffects(), ticks=3)
    running.retire([(0, 0)])
    running.step(3, np.zeros((6, 1), dtype=np.bool_))
    running.step(4, np.zeros((6, 1), dtype=np.bool_))
    assert running.counters()["messages.sent"] == 2 * 14 + 12


def test_a_reset_does_not_touch_the_counts() -> None:
    class Stumbles(Talks):
        def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
            if (state["period"] >= 4).any():
                raise OverflowError
            return super().step(state, inputs)

    lattice = Lattice([(0, 0), (0, 1)])
    effects = CellEffects.model_validate({"cop": {"timeout_s": 0.016384, "reboot_s": 0.05}})
    controller = build_controller(Stumbles(NoParameters()), SPEC, effects, None, metered=True)
    running = Shard(controller, cells_of(lattice), Partition.even(lattice, 1), 0)
    for tick in range(48):
        running.step(tick, np.zeros((2, 1), dtype=np.bool_))
    counted = running.counters()
    assert counted["cop.resets"] > 2
    assert counted["messages.sent"] == 2 * counted["cop.hangs"]  # twice from each start to where it hangs


def test_cells_that_were_not_counted_have_no_counters() -> None:
    controller = build_controller(Talks(NoParameters()), SPEC, CellEffects(), None)
    lattice = Lattice([(0, 0)])
    assert "messages.sent" not in controller.registers(controller.init(cells_of(lattice)))
