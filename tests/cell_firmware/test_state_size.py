"""Steps of many boards wait for memory: what a cell has there stays small, and what isn't needed isn't written."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cell_firmware.kernels.lines import LINE
from tests.cell_firmware.test_compiled import MOTORS, Pair

CACHE_LINE = 64
BUDGET_BYTES = {"hc11": 1_460, "hc11, byte by byte": 3_060}
"""Of a cell with a whole board, its program and its messages. A step of 100,000 such cells took 1.7 times as long a
cell as one of 1,000 when they were 1,611 and 3,463 (docs/decisions/0091-a-cells-state-is-small.md). More is a choice:
measure ``python tests/benchmarks/cells/compiled_step.py --cells 1000 --cells 100000`` before and after."""


@pytest.mark.parametrize("effects", list(BUDGET_BYTES))
def test_a_cell_with_a_whole_board_has_no_more_bytes_than_its_budget(lockstep: Any, effects: str) -> None:
    pair = Pair(lockstep, "heat_diffusion", effects, 1, MOTORS)
    pair.step()
    (shard,) = pair.both[0].shards
    kernel = shard._kernel
    arrays = [array for outbox in (*kernel.outboxes, kernel._spare) for array in outbox]
    arrays += [*kernel._owned, *getattr(kernel._controller._bound.uarts, "arrays", ())]
    sizes = {id(array): array.nbytes for array in arrays if len(array) >= len(shard)}
    assert sum(sizes.values()) <= BUDGET_BYTES[effects] * len(shard)


def test_what_every_tick_needs_of_a_serial_line_lies_in_two_cache_lines() -> None:
    fields = {name: (field[1], field[0].itemsize) for name, field in (LINE.fields or {}).items()}
    always = ("since", "ppb", "reaches", "waits", "goes", "last_ns", "free_ns", "replaced")
    assert max(sum(fields[name]) for name in always) <= 2 * CACHE_LINE
    assert LINE.itemsize % CACHE_LINE == 0


@pytest.mark.parametrize("effects", ["none", "hc11", "serial, byte by byte"])
def test_slots_without_a_message_are_zeros_whatever_was_there(lockstep: Any, effects: str) -> None:
    """A tick leaves slots as they are where it sends nothing and nothing was."""
    pair = Pair(lockstep, "heat_diffusion", effects, 1, MOTORS)
    for tick in range(30):
        for one in pair.both if tick == 10 else ():
            (shard,) = one.shards
            outbox = shard.outbox
            outbox.sent[...] = False
            outbox.message.view(np.uint8)[...] = 0xA5
            shard.outbox = outbox
        if tick == 20:
            for one in pair.both:
                one.retire([(0, 1)])
        pair.step()
        if tick > 10:
            sent, message = pair.both[0].shards[0]._outboxes[-1]
            assert not message[~sent].view(np.uint8).any(), tick
    pair.compare()


def test_watchdogs_that_are_not_looked_at_in_every_tick_reset_in_the_right_one(lockstep: Any) -> None:
    """With clocks of their own cells skip windows, or a reset is due while none of the others' is."""
    pair = Pair(lockstep, "exploding", "hc11", 2, MOTORS)
    for tick in range(150):
        pair.step()
        pair.compare()
        if tick == 100:
            pair.both[0].retire([(2, 3)])
            pair.both[1].retire([(2, 3)])
    assert sum(shard.counters()["cop.resets"] for shard in pair.both[0].shards) > 3
