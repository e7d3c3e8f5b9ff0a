"""The deadline of programs: interrupted, named, given up, and left alone where they return."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.board import Board
from cell_firmware.cell import Cell, CellFirmware, CellInputs, CellOutputs, PerCellAdapter
from cell_firmware.errors import FirmwareFailed
from cell_firmware.firmware import Cells
from cell_firmware.program import NoParameters
from cell_firmware.shard import Shard
from deploy.workers.overrun import Watchdog

LIMIT_S = 0.4


class Slow(CellFirmware):
    """Column 1 doesn't return; how, is its class's to say."""

    until: threading.Event

    def init(self, cell: Cell) -> int:
        return cell.column

    def step(self, state: int, inputs: CellInputs) -> tuple[int, CellOutputs]:
        del inputs
        if state in (1, 3):
            self.wait()
        return state, CellOutputs((0.1, 0.0))

    def wait(self) -> None:
        while True:
            pass


class Stubborn(Slow):
    """Ignores the first interruption."""

    def wait(self) -> None:
        try:
            super().wait()
        except BaseException:  # noqa: BLE001 - as a careless program does
            super().wait()


class Held(Slow):
    """A debugger holds column 1 for as long as three deadlines, in Python code of its own."""

    def wait(self) -> None:
        held = {"__name__": "pdb", "time": time}
        exec(f"end = time.monotonic() + {3 * LIMIT_S}\nwhile time.monotonic() < end: time.sleep(0.01)", held)


class Asleep(Slow):
    """Waits in C, where no exception reaches it."""

    def wait(self) -> None:
        self.until.wait(20.0)


@pytest.fixture
def until() -> Iterator[threading.Event]:
    event = threading.Event()
    yield event
    event.set()


def _shard(program: type[CellFirmware]) -> Shard:
    lattice = Lattice((0, column) for column in range(4))
    position_m = np.stack((0.1 * lattice.columns, 0.1 * lattice.rows), axis=1)
    cells = Cells.of(lattice, position_m, 0.004096)
    return Shard(Board(PerCellAdapter(program(NoParameters()))), cells, Partition.even(lattice, 1), 0)


def _step(shard: Shard, overseer: Watchdog) -> tuple[FirmwareFailed, ...]:
    with overseer:
        return shard.step(0, np.zeros((4, 1), dtype=np.bool_)).failures


@pytest.mark.parametrize("program", [Slow, Stubborn])
def test_programs_that_loop_are_interrupted_named_and_the_others_stepped(program: type[CellFirmware]) -> None:
    busy: list[float] = []
    with closing(Watchdog(LIMIT_S, "a rule", lambda: busy.append(time.monotonic()))) as overseer:
        failures = _step(_shard(program), overseer)
    assert [failure.cell for failure in failures] == [(0, 1), (0, 3)]
    for failure in failures:
        assert failure.problem == "NeverReturned: the step had not returned after 0.4 s (a rule)"
        assert "in wait" in failure.trace
    assert len(busy) >= 4
    assert not overseer.given_up


def test_a_program_that_a_debugger_holds_is_let_be_and_named() -> None:
    told: list[str] = []
    held: list[tuple[int, int]] = []
    with closing(Watchdog(LIMIT_S, "a rule", lambda: told.append("busy"), held=held.append)) as overseer:
        assert _step(_shard(Held), overseer) == ()
    assert set(held) == {(0, 1), (0, 3)}
    assert len(held) >= 20
    assert not overseer.given_up


def test_a_program_that_can_not_be_interrupted_is_given_up_by_name(until: threading.Event) -> None:
    Slow.until = until
    told: list[tuple[Any, ...]] = []

    def hopeless(*what: Any) -> None:
        told.append(what)
        until.set()

    with closing(Watchdog(LIMIT_S, "a rule", hopeless=hopeless)) as overseer:
        _step(_shard(Asleep), overseer)
        assert overseer.given_up
    ((cell, problem, trace),) = told
    assert (cell, problem) == ((0, 1), "NeverReturned: the step had not returned after 0.4 s (a rule)")
    assert "self.until.wait(20.0)" in trace
    assert "test_overrun.py" not in trace.partition("cell.py")[0]


def test_steps_that_return_in_time_are_let_be_however_many_there_are() -> None:
    told: list[object] = []
    with closing(Watchdog(LIMIT_S, "a rule", lambda: told.append("busy"))) as overseer:
        for _ in range(10):
            with overseer:
                time.sleep(LIMIT_S / 8)
    assert told == []


def test_an_interruption_that_comes_too_late_hits_nothing() -> None:
    with closing(Watchdog(LIMIT_S, "a rule")) as overseer:
        shard = _shard(Slow)
        _step(shard, overseer)
        ended = time.monotonic() + LIMIT_S
        while time.monotonic() < ended:
            pass


WATCHED = """
import sys
from contextlib import closing
from tests.deploy.workers.test_overrun import LIMIT_S, Slow, Watchdog, _shard, _step

def called() -> None:
    pass

with closing(Watchdog(LIMIT_S, "a rule")) as overseer:
    assert len(_step(_shard(Slow), overseer)) == 2
for watch in (sys.setprofile, sys.settrace):
    watch(lambda *_: None)
    called()
    watch(None)
print("ok")
"""


def test_after_an_interruption_a_debugger_and_a_profiler_work() -> None:
    """In a process of its own: where it fails, nothing but a kill ends it."""
    command, root = [sys.executable, "-c", WATCHED], Path(__file__).parents[3]
    ended = subprocess.run(command, cwd=root, capture_output=True, text=True, timeout=30, check=False)
    assert (ended.stdout, ended.stderr, ended.returncode) == ("ok\n", "", 0)
