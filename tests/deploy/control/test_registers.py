"""What is seen of cells that run elsewhere, whoever says it."""

from __future__ import annotations

import time

import numpy as np

from bus.lockstep.registers import RegisterFrame, encode_registers
from bus.transports.memory import MemoryBus
from deploy.control.registers import collect, ranges, registers_key


def frame(tick: int, cells: list[list[int]], **registers: list[float]) -> bytes:
    arrays = {name: np.array(values) for name, values in registers.items()}
    return encode_registers(RegisterFrame(tick, np.array(cells), arrays))


def test_registers_that_not_all_cells_have_alike_are_not_put_in_ranges() -> None:
    cells = {(0, 0): {"a": [1.0, 3.0], "b": 2, "c": 1.0}, (0, 1): {"a": [5.0, -1.0], "b": [1, 2]}}
    assert ranges(cells) == {"a": (-1.0, 2.0, 5.0)}


def test_frames_that_are_none_are_passed_over_and_the_last_word_of_a_cell_stands() -> None:
    bus = MemoryBus()
    cells, viewer = bus.endpoint(), bus.endpoint()

    viewer.subscribe(registers_key("*"))
    put = cells.publisher("mdms/run-1/shard/0/registers").put
    for payload in (b"\xc1", frame(3, [[0, 1]], a=[1.0]), b"", frame(4, [[0, 1], [2, 2]], a=[2.0, 3.0])):
        put(payload)
    seen = collect(viewer, {(0, 1), (2, 2)}, time.monotonic() + 5.0)
    assert (seen.run, seen.tick) == ("run-1", 4)
    assert seen.cells == {(0, 1): {"a": 2.0}, (2, 2): {"a": 3.0}}


def test_all_cells_are_no_longer_waited_for_than_until_they_have_answered() -> None:
    bus = MemoryBus()
    cells, viewer = bus.endpoint(), bus.endpoint()
    viewer.subscribe(registers_key("*"))
    cells.publisher("mdms/run-1/shard/0/registers").put(frame(4, [[0, 1], [2, 2]], a=[2.0, 3.0]))
    begun = time.monotonic()
    assert len(collect(viewer, set(), begun + 60.0, 2).cells) == 2
    assert time.monotonic() - begun < 0.9  # the time in which other shards would answer
