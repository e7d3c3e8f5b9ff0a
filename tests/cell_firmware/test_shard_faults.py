"""Shards step their compiled cells in ticks in which no fault acts on them; nothing differs but the time it takes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bus.fault import FaultInstance
from bus.lattice import NO_TICK_LIMIT, Lattice
from bus.partition import Partition
from bus.state import load_state, save_state
from cell_firmware.board import LINKS
from cell_firmware.board_presets import BOARDS
from cell_firmware.build import MotorFacts
from cell_firmware.compiled import CompiledController
from cell_firmware.effects.registry import CellEffects
from cell_firmware.faults.base import CellFault
from cell_firmware.firmware import Firmware, Inputs, Outputs, State
from cell_firmware.loader import load
from cell_firmware.program import NoParameters
from cell_firmware.specs import CellsSpec
from tests.cell_firmware.faults.instances import instances
from tests.cell_firmware.test_compiled import Moody

BEGIN, END, TICKS = 20, 45, 80
HC11: dict[str, Any] = {name: dict(table) for name, table in BOARDS["hc11"].items()}
LATTICE = Lattice((0, column) for column in range(6))
EFFECTS: dict[str, dict[str, Any]] = {
    "none": {},
    "hc11": HC11,
    "mailbox": {name: table for name, table in HC11.items() if name != "serial"},
    "serial": {"serial": {"baud": 31250}},
    "shared": {
        "serial": {"baud": 9615, "sharing": "mux", "ring_bytes": 0, "dwell_periods": 20},
        "cop": {"timeout_s": 0.016384, "reboot_s": 0.01},
    },
    "watchdog": {"cop": {"timeout_s": 0.016384, "reboot_s": 0.01}},
    "debounced": {"sensor": {"debounce_ticks": 3}},
    "filtered": {"link_loss": {"probability": 0.1}},
}
TABLES: dict[str, tuple[dict[str, Any], ...]] = {
    "hang": ({"kind": "hang", "cell": (0, 1)},),
    "crash and slow clock": (
        {"kind": "crash", "cell": (0, 0), "end": 50},
        {"kind": "slow_clock", "factor": 0.4, "cell": (0, 1), "first": 35},
    ),
    "reboots": (
        {"kind": "reboot", "cell": (0, 4), "delay_s": 0.02},
        {"kind": "hang", "cell": (0, 5), "first": 60, "end": 64},
    ),
    "a link and a sensor": (
        {"kind": "link_delay", "ticks": 4, "cell": (0, 1), "side": "west"},
        {"kind": "sensor_flip", "rate": 0.3, "cell": (0, 4)},
    ),
    "damaged messages": ({"kind": "link_corrupt", "probability": 0.5, "bits": 3, "cell": (0, 0)},),
    "lies": (
        {"kind": "lie", "mode": "random", "cell": (0, 5)},
        {"kind": "lie", "mode": "factor", "by": 9.0, "cell": (0, 1)},
    ),
    "noise": ({"kind": "babble", "cell": (0, 2)},),
    "hanging noise": ({"kind": "babble", "cell": (0, 3)}, {"kind": "hang", "cell": (0, 3), "first": 30}),
}
STRUCK: dict[str, set[int]] = {
    "hang": {1},
    "crash and slow clock": {0, 1},
    "reboots": {4},
    "a link and a sensor": {0, 1, 4},
    "damaged messages": {0, 1},
    "lies": {0, 2, 4},
    "noise": {2},
    "hanging noise": {3},
}
"""Cells on which a fault acts in tick 40; of a lie they are those that receive it."""


class Fragile(Moody):
    """Raises every now and then, and hangs until its watchdog resets it."""

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        """One period."""
        state, outputs = super().step(state, inputs)
        failed = {int(i): "it had enough" for i in np.flatnonzero(state["mood"] % 29 == 0)}
        return state, replace(outputs, failed=failed)


def array(
    lockstep: Any,
    shards: int,
    faults: list[FaultInstance[CellFault]],
    effects: str = "hc11",
    *,
    live: bool = False,
    link_ticks: int = 1,
    program: str = "heat_diffusion",
) -> Any:
    """Cells in a row that diffuse speeds."""
    parameters: dict[str, Any] = {
        "heat_diffusion": {"initial": [{"cell": [0, 0], "speed_m_s": [0.4, -0.2]}], "ttl_periods": 3},
        "average_consensus": {"values": [{"columns": [0, 0], "value": 1.0}]},
    }
    firmware: Firmware = Fragile(NoParameters())
    if program != "fragile":
        firmware = load(CellsSpec(firmware=program, parameters=parameters.get(program, {})))
    enabled = CellEffects.model_validate(EFFECTS[effects])
    clocks = None if enabled.clock is None else enabled.clock.clocks(LATTICE, CellsSpec().period_ns, 5)
    motors = MotorFacts(12.0, 1.2) if "pwm" in EFFECTS[effects] else None
    partition = Partition.even(LATTICE, shards)
    return lockstep(firmware, partition, motors, enabled, 3, clocks, faults, live=live, link_ticks=link_ticks)


def on_arrays(run: Any) -> Any:
    """Have all ticks of a run stepped on arrays, with the wrappers of all its faults."""
    for shard in run.shards:
        shard._undisturbed = (SimpleNamespace(passes_on=lambda state: False), None)
        shard._controller, shard._kernel = shard._general, None
    return run


def faults_of(name: str, first: int = BEGIN, end: int = END) -> list[FaultInstance[CellFault]]:
    return instances(LATTICE, *TABLES[name], first=first, end=end)


def step(run: Any, tick: int) -> bytes:
    """A tick in which parcels lie here and there."""
    presence = np.array([[(tick // 7 + cell) % 3 == 0] for cell in range(len(LATTICE))])
    return run.step(presence, np.full((len(LATTICE), 2), 0.001 * tick)).tobytes()


def shown(run: Any) -> tuple[Counter[str], dict[str, dict[tuple[int, ...], bytes]]]:
    """Counters of all shards together, and registers by name and cell."""
    counters, registers = Counter[str](), dict[str, dict[tuple[int, ...], bytes]]()
    for shard in run.shards:
        counters.update(shard.counters())
        cells, values = shard.registers()
        for name, array in values.items():
            rows = zip(cells.tolist(), array, strict=True)
            registers.setdefault(name, {}).update((tuple(cell), row.tobytes()) for cell, row in rows)
    return counters, registers


def disturbed(run: Any) -> set[int]:
    """Cells whose shard steps them otherwise than by its kernel."""
    return {int(cell) for shard in run.shards if shard._kernel is None for cell in shard.indices}


def compare(name: str, effects: str, lockstep: Any, *, live: bool, link_ticks: int = 1) -> Counter[str]:
    """Step a run on arrays, in one shard, and others in one, two and six shards; return the counters."""

    def made(shards: int) -> tuple[Any, list[FaultInstance[CellFault]]]:
        faults = faults_of(name)
        scheduled = [] if live else faults
        return array(lockstep, shards, scheduled, effects, live=live, link_ticks=link_ticks), faults

    runs = [made(shards) for shards in (1, 1, 2, 6)]
    reference = on_arrays(runs[0][0])
    for tick in range(TICKS):
        if live:
            for run, faults in runs:
                inject(run, faults, tick)
        expected = step(reference, tick)
        for run, _ in runs[1:]:
            assert step(run, tick) == expected, (tick, len(run.shards))
            if tick % 8 == 7:
                assert shown(run) == shown(reference)
        if tick in (BEGIN - 1, TICKS - 1) and "link_loss" not in EFFECTS[effects]:
            assert [disturbed(run) for run, _ in runs[1:]] == [set[int]()] * 3
        if tick == 40 and "link_loss" not in EFFECTS[effects]:
            assert disturbed(runs[-1][0]) == STRUCK[name]
    assert not reference.failures
    return shown(reference)[0]


def inject(run: Any, faults: list[FaultInstance[CellFault]], tick: int) -> None:
    """Inject the faults that begin in a tick."""
    for fault in faults:
        if fault.start_tick == tick:
            for shard, site in zip(run.shards, run.sites, strict=True):
                shard.inject(fault, site, LATTICE)


@pytest.mark.parametrize("name", list(TABLES))
def test_before_while_and_after_faults_act_all_is_as_on_arrays(name: str, lockstep: Any) -> None:
    """Of faults that are planned, and of faults that are injected when they begin."""
    counters = compare(name, "hc11", lockstep, live=name in ("hang", "a link and a sensor", "lies"))
    assert any(number for counter, number in counters.items() if counter.startswith("faults."))


@pytest.mark.parametrize(("name", "effects"), [("lies", "mailbox"), ("noise", "none"), ("hang", "watchdog")])
def test_other_boards_step_alike_with_faults(name: str, effects: str, lockstep: Any) -> None:
    counters = compare(name, effects, lockstep, live=False)
    assert (counters["faults.words.refused"] > 20) == (name != "hang")


@pytest.mark.slow
@pytest.mark.parametrize("effects", list(EFFECTS))
def test_every_board_steps_alike_with_every_fault(effects: str, lockstep: Any) -> None:
    for place, name in enumerate(TABLES):
        compare(name, effects, lockstep, live=(place + len(effects)) % 2 == 0)


@pytest.mark.parametrize("name", ["hang", "noise"])
def test_messages_that_are_longer_under_way_are_read_alike(name: str, lockstep: Any) -> None:
    """A program that has restarted reads none that was sent before; noise is refused where it arrives."""
    compare(name, "none", lockstep, live=True, link_ticks=3)


def test_cells_far_from_a_fault_refuse_messages_in_their_compiled_form(lockstep: Any) -> None:
    run = array(lockstep, 6, faults_of("noise"), "none")
    for tick in range(END):
        step(run, tick)
        assert disturbed(run) <= {2}
        if tick == END - 5:
            before = run.shards[1].registers()[1]["words.refused"]
    refused = [shard.counters()["faults.words.refused"] for shard in run.shards]
    assert min(refused[1], refused[3]) > 10
    assert run.shards[1].registers()[1]["words.refused"].tolist() == [refused[1]]
    assert before < refused[1], "what was read before doesn't change"


def test_programs_with_a_check_of_their_own_are_stepped_compiled_but_not_in_one_call(lockstep: Any) -> None:
    reference, run = (array(lockstep, n, faults_of("noise"), "none", program="push_sum") for n in (1, 6))
    on_arrays(reference)
    for tick in range(TICKS):
        assert step(reference, tick) == step(run, tick)
        compiled = [isinstance(shard._controller, CompiledController) for shard in run.shards]
        assert compiled == [cell != 2 or not BEGIN <= tick <= END for cell in range(6)]
    assert shown(run) == shown(reference)
    assert shown(run)[0]["faults.words.refused"] > 20


def test_programs_without_a_compiled_form_step_alike(lockstep: Any) -> None:
    for name in ("noise", "hang"):
        reference, run = (
            array(lockstep, n, faults_of(name), "none", program="average_consensus") for n in (1, 6)
        )
        on_arrays(reference)
        for tick in range(END + 10):
            assert step(reference, tick) == step(run, tick), tick
        assert shown(run) == shown(reference)


@pytest.mark.parametrize("effects", ["shared", "hc11"])
def test_cells_that_watchdogs_reset_step_alike_with_faults_elsewhere(effects: str, lockstep: Any) -> None:
    reference, run = (
        array(lockstep, n, faults_of("hanging noise"), effects, program="fragile") for n in (1, 6)
    )
    on_arrays(reference)
    for tick in range(TICKS):
        assert step(reference, tick) == step(run, tick), tick
    assert shown(run) == shown(reference)
    assert shown(run)[0]["cop.hangs"] > 3


@pytest.mark.parametrize("name", ["hang", "lies"])
@pytest.mark.parametrize("effects", ["none", "hc11"])
def test_a_checkpoint_before_while_and_after_a_fault_acts_is_as_on_arrays(
    name: str, effects: str, lockstep: Any
) -> None:
    reference = on_arrays(array(lockstep, 3, faults_of(name), effects))
    run, drives = array(lockstep, 3, faults_of(name), effects), list[bytes]()
    taken: dict[int, tuple[list[bytes], Any]] = {}
    for tick in range(TICKS):
        if tick in (BEGIN - 5, 40, END + 15):
            taken[tick] = [save_state(shard) for shard in run.shards], list(run.links)
            assert parts(run) == parts(reference)
        drives.append(step(run, tick))
        assert drives[-1] == step(reference, tick)
    for tick, (saved, links) in taken.items():
        for again in (
            array(lockstep, 3, faults_of(name), effects),
            run,
        ):  # another one, and this one goes back
            for shard, data in zip(again.shards, saved, strict=True):
                load_state(shard, data)
            again._later[:], again.links, again.tick = [], links, tick
            assert [step(again, later) for later in range(tick, TICKS)] == drives[tick:]
            assert shown(again) == shown(reference)


@pytest.mark.parametrize("name", ["hang", "lies", "damaged messages"])
def test_a_repaired_fault_returns_cells_to_their_kernel(name: str, lockstep: Any) -> None:
    """It is repaired in the tick in which the repair is known, as at run time."""
    reference, run = on_arrays(array(lockstep, 1, faults_of(name))), array(lockstep, 6, [], live=True)
    faults = faults_of(name, end=NO_TICK_LIMIT)
    for tick in range(TICKS):
        inject(run, faults, tick)
        if tick == END:
            for shard, fault in each(run.shards, faults):
                shard.repair(fault.number, END)
        assert step(reference, tick) == step(run, tick), tick
    assert shown(run) == shown(reference)
    assert disturbed(run) == set()


def test_a_fault_that_is_repaired_before_it_begins_acts_alike(lockstep: Any) -> None:
    both = [array(lockstep, shards, faults_of("hang")) for shards in (1, 3)]
    on_arrays(both[0])
    for tick in range(END):
        if tick == 10:
            for run in both:
                for shard in run.shards:
                    shard.repair(0, 12)
        assert step(both[0], tick) == step(both[1], tick), tick
    assert shown(both[0]) == shown(both[1])


def test_cells_that_die_leave_what_they_have_refused_in_the_counters(lockstep: Any) -> None:
    both = [array(lockstep, shards, faults_of("noise"), "none") for shards in (1, 3)]
    on_arrays(both[0])
    for tick in range(TICKS):
        if tick in (35, 60):
            for run in both:
                run.retire([(0, 1 if tick == 35 else 3)])
        assert step(both[0], tick) == step(both[1], tick), tick
        assert shown(both[0]) == shown(both[1])


def test_a_fault_whose_cells_have_died_leaves_the_others_their_kernel(lockstep: Any) -> None:
    run = array(lockstep, 1, faults_of("hang", end=NO_TICK_LIMIT), "none")
    for tick in range(40):
        if tick == 30:
            run.retire([(0, 1)])
        step(run, tick)
        assert disturbed(run) == (set(range(6)) if BEGIN <= tick < 30 else set())


def parts(run: Any) -> list[dict[tuple[str, str], bytes]]:
    """State of every shard's cells as a checkpoint has it, but for lines, which leave other bytes where none count."""
    return [
        {
            (part, name): array.tobytes()
            for part, arrays in shard._memory.items()
            for name, array in arrays.items()
            if part != LINKS
        }
        for shard in run.shards
    ]


def each(shards: Any, faults: list[FaultInstance[CellFault]]) -> Iterator[tuple[Any, Any]]:
    """Every shard with every fault."""
    return ((shard, fault) for shard in shards for fault in faults)
