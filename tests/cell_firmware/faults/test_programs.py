"""Programs that hang, reboot, or run too slowly: what becomes of pins, messages, watchdog and memory."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError

from bus.fault import FaultInstance
from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.clocks import ArrayClocks, CellClocks
from cell_firmware.effects.cop.spec import CopSpec
from cell_firmware.effects.registry import CellEffects
from cell_firmware.faults.base import CellFault
from cell_firmware.faults.kinds.slow_clock import SlowClockFault
from cell_firmware.firmware import Cells, Firmware, Inputs, Outbox, Outputs, State
from cell_firmware.program import NoParameters
from tests.cell_firmware.faults.instances import instances

Grid = Callable[..., Lattice]
PERIOD_NS = 4_096_000
NOTHING = 0.0


class Counting(Firmware):
    """Drives how often it has run since it began, along x, and what its western neighbour sent last, along y."""

    message = np.dtype([("count", "<i8")])

    def __init__(self) -> None:
        super().__init__(NoParameters())

    def init(self, cells: Cells) -> State:
        return {"count": np.zeros(len(cells), dtype=np.int64)}

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        count = state["count"] + 1
        assert inputs.inbox is not None
        speed = np.stack((count, inputs.inbox.message["count"][:, 3]), axis=1).astype(np.float64)
        return {"count": count}, Outputs(speed, Outbox.to_all(self.message, count=count))


def driven(
    grid: Grid,
    lockstep: Any,
    ticks: int,
    *faults: dict[str, Any],
    shards: int = 1,
    effects: CellEffects | None = None,
    clocks: ArrayClocks | None = None,
    **times: int,
) -> tuple[NDArray[np.float64], dict[str, int]]:
    """Drives of 0,0 and 0,1, ``(ticks, 2, 2)``; faults affect 0,0. And what was counted."""
    lattice = grid(1, 2)
    here = instances(lattice, *({"cell": (0, 0), **fault} for fault in faults), **times)
    steps = lockstep(Counting(), Partition.even(lattice, shards), None, effects, 0, clocks, here)
    found = np.array([steps.step() for _ in range(ticks)])
    assert not steps.failures
    return found, dict(sum((shard.counters() for shard in steps.shards[1:]), steps.shards[0].counters()))


@pytest.mark.parametrize("shards", [1, 2])
def test_a_program_that_hangs_holds_its_pins_and_sends_nothing_until_it_is_repaired_and_restarts(
    shards: int, grid: Grid, lockstep: Any
) -> None:
    found, counted = driven(grid, lockstep, 10, {"kind": "hang"}, first=3, end=6, shards=shards)
    assert found[:, 0, 0].tolist() == [1, 2, 3, 3, 3, 3, 1, 2, 3, 4]
    assert found[:, 1, 1].tolist() == [0, 1, 2, 3, 0, 0, 0, 1, 2, 3]
    assert found[:, 1, 0].tolist() == list(range(1, 11)), "nobody else notices"
    assert counted == {"faults.hang.periods": 3, "faults.begun_anew": 1}


def test_a_watchdog_resets_a_program_that_hangs_which_hangs_again_while_the_fault_acts(
    grid: Grid, lockstep: Any
) -> None:
    effects = CellEffects(cop=CopSpec(timeout_s=0.065536, reboot_s=0.02))
    found, counted = driven(grid, lockstep, 60, {"kind": "hang"}, first=5, end=48, effects=effects)
    x = found[:, 0, 0]
    # last served in tick 4, at 16.4 ms: reset by the divider's boundary at 81.9 ms, tick 20; next at 167.8 ms, tick 44
    assert x[:5].tolist() == [1, 2, 3, 4, 5]
    assert (x[5:20] == 5).all()
    assert (x[20:48] == NOTHING).all(), (
        "after a reset the pins are low, and what hangs at once leaves them so"
    )
    running = np.flatnonzero(x[48:] > 0)[0] + 48
    assert x[running:].tolist() == list(range(1, 61 - running))
    assert counted["cop.resets"] == 2
    assert running == 49, "the second reset's 20 ms, to the boundary"


def test_a_rebooted_cell_loses_its_state_stands_and_restarts_after_its_delay(
    grid: Grid, lockstep: Any
) -> None:
    found, counted = driven(grid, lockstep, 9, {"kind": "reboot"}, first=3, end=6)
    assert found[:, 0, 0].tolist() == [1, 2, 3, 0, 0, 0, 1, 2, 3]
    assert found[:, 1, 1].tolist() == [0, 1, 2, 3, 0, 0, 0, 1, 2]
    assert counted == {"faults.reboot.periods": 3, "faults.begun_anew": 1}
    at_once, counted = driven(grid, lockstep, 6, {"kind": "reboot"}, first=3, end=3)
    assert at_once[:, 0, 0].tolist() == [1, 2, 3, 1, 2, 3]
    assert counted == {"faults.reboot.periods": 0, "faults.begun_anew": 1}


@pytest.mark.parametrize("factor", ["0.5", "0.3", "0.999999", "0.142857", "0.01"])
def test_a_slow_clock_runs_its_program_in_exactly_that_share_of_its_periods(
    factor: str, grid: Grid, lockstep: Any
) -> None:
    found, counted = driven(grid, lockstep, 307, {"kind": "slow_clock", "factor": float(factor)}, first=2)
    runs = [2 + int(Fraction(factor) * periods) for periods in range(1, 306)]
    assert found[2:, 0, 0].tolist() == runs
    assert counted == {"faults.slow_clock.periods": 305 - (runs[-1] - 2)}


def clocks(lattice: Lattice, *ppb: int, windows: int) -> ArrayClocks:
    window_ns = PERIOD_NS * 94 // 100 // windows
    phases = np.zeros(len(lattice), dtype=np.int64)
    return ArrayClocks(lattice, CellClocks(PERIOD_NS, window_ns, np.array(ppb), phases))


@pytest.mark.parametrize("windows", [1, 2, 3])
def test_with_clocks_of_their_own_it_is_the_share_of_the_cell_s_own_periods(
    windows: int, grid: Grid, lockstep: Any
) -> None:
    own = clocks(grid(1, 2), 30_000_000, -20_000_000, windows=windows)
    ticks = 100 * windows
    found, counted = driven(grid, lockstep, ticks, {"kind": "slow_clock", "factor": 0.5}, clocks=own)
    free, _ = driven(grid, lockstep, ticks, clocks=own)
    assert (found[:, 0, 0] == free[:, 0, 0] // 2).all()
    assert counted["faults.slow_clock.periods"] == free[-1, 0, 0] - found[-1, 0, 0]


@pytest.mark.parametrize("end", range(20, 26))
def test_a_repair_reaches_a_cell_that_has_no_instant_in_its_window(
    end: int, grid: Grid, lockstep: Any
) -> None:
    own = clocks(grid(1, 2), 0, 0, windows=3)
    found, counted = driven(grid, lockstep, 60, {"kind": "hang"}, first=10, end=end, clocks=own)
    assert counted["faults.begun_anew"] == 1
    after = found[end:, 0, 0]
    numbers = after[np.flatnonzero(np.diff(after, prepend=-1.0))].tolist()
    begins = numbers.index(1.0)
    assert begins <= 1, "what it had holds until its next instant"
    assert numbers[begins:] == list(range(1, len(numbers) - begins + 1))


def test_the_watchdog_of_a_slow_cell_is_as_slow(grid: Grid, lockstep: Any) -> None:
    effects = CellEffects(cop=CopSpec(timeout_s=0.016384, reboot_s=0.0))
    slow = {"kind": "slow_clock", "factor": 0.1}
    _, counted = driven(grid, lockstep, 200, slow, effects=effects)
    assert counted["cop.resets"] == 0, "every tenth period is four times the timeout"
    _, fast = driven(grid, lockstep, 400, {"kind": "hang"}, effects=effects)
    _, both = driven(grid, lockstep, 400, {"kind": "hang"}, slow, effects=effects)
    assert both["cop.resets"] == fast["cop.resets"] // 10 > 0


def test_a_fault_of_one_cell_is_joined_to_a_running_array_to_the_same_effect(
    grid: Grid, lockstep: Any
) -> None:
    lattice = grid(1, 2)
    tables = (
        {"kind": "slow_clock", "factor": 0.3},
        {"kind": "hang"},
        {"kind": "lie", "mode": "factor", "by": 3},
    )
    faults: list[FaultInstance[CellFault]] = instances(
        lattice, *({"cell": (0, 0), **table} for table in tables), first=7, end=11
    )
    scheduled = lockstep(Counting(), Partition.even(lattice, 1), None, None, 0, None, faults)
    live = lockstep(Counting(), Partition.even(lattice, 1), live=True)
    for tick in range(20):
        if tick == 7:
            for fault in faults:
                live.shards[0].inject(fault, live.sites[0], lattice)
        assert (scheduled.step() == live.step()).all(), tick


LIE = {"kind": "lie", "mode": "factor", "by": 3}
SLOW = {"kind": "slow_clock", "factor": 0.3}
HANG = {"kind": "hang"}


@pytest.mark.parametrize(
    "tables",
    [(HANG, SLOW, LIE), (LIE, SLOW, HANG), (HANG, HANG, {"kind": "crash"}), (SLOW, SLOW), (LIE, LIE)],
)
@pytest.mark.parametrize("windows", [0, 2])
def test_faults_joined_one_by_one_act_and_count_as_if_they_had_been_there_from_the_start(
    windows: int, tables: tuple[dict[str, Any], ...], grid: Grid, lockstep: Any
) -> None:
    lattice = grid(1, 2)
    own = clocks(lattice, 3_000, -4_000, windows=windows) if windows else None
    timed = ({**table, "first": 5 + 3 * i, "end": 11 + 4 * i} for i, table in enumerate(tables))
    faults = instances(lattice, *({"cell": (0, 0), **table} for table in timed))
    scheduled = lockstep(Counting(), Partition.even(lattice, 1), None, None, 0, own, faults)
    live = lockstep(Counting(), Partition.even(lattice, 1), None, None, 0, own, live=True)
    for tick in range(28):
        for fault in faults:
            if fault.start_tick == tick:
                live.shards[0].inject(fault, live.sites[0], lattice)
        assert (scheduled.step() == live.step()).all(), tick
    assert scheduled.shards[0].counters() == live.shards[0].counters()


def test_a_cell_that_is_away_drives_nothing_and_one_that_is_reset_while_it_hangs_keeps_low_pins(
    grid: Grid, lockstep: Any
) -> None:
    found, counted = driven(grid, lockstep, 9, {"kind": "crash"}, first=3, end=6)
    assert found[:, 0, 0].tolist() == [1, 2, 3, 0, 0, 0, 1, 2, 3]
    assert counted == {"faults.crash.periods": 3, "faults.begun_anew": 1}
    reset = {"kind": "reboot", "first": 5, "end": 5}
    found, counted = driven(grid, lockstep, 9, {"kind": "hang", "first": 0, "end": 1}, HANG, reset, first=3)
    assert found[:, 0, 0].tolist() == [0, 1, 2, 2, 2, 0, 0, 0, 0]
    assert counted == {"faults.hang.periods": 7, "faults.reboot.periods": 0, "faults.begun_anew": 1}


@pytest.mark.parametrize(("first", "end"), [(13, 26), (14, 27)])
def test_with_clocks_of_their_own_cells_stand_in_the_periods_whose_pins_change_while_the_fault_acts(
    first: int, end: int, grid: Grid, lockstep: Any
) -> None:
    own = clocks(grid(1, 2), 0, 0, windows=3)
    found, counted = driven(grid, lockstep, 40, HANG, first=first, end=end, clocks=own)
    free, _ = driven(grid, lockstep, 40, clocks=own)
    changes, without = (np.flatnonzero(np.diff(x, prepend=0.0)) for x in (found[:, 0, 0], free[:, 0, 0]))
    stood = (without >= first) & (without < end)
    assert changes.tolist() == without[~stood].tolist()
    assert counted["faults.hang.periods"] == stood.sum() == 4


@pytest.mark.parametrize("factor", [0.0, 1.0, 0.1234567])
def test_factors_that_are_none_or_have_too_many_places_are_refused(factor: float) -> None:
    with pytest.raises(ValidationError, match="factor"):
        SlowClockFault.model_validate({"cell": (0, 0), "factor": factor})
