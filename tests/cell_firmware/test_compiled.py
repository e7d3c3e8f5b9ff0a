"""The compiled controller gives what the general one gives, which is written on arrays: every bit, every register."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from bus.lattice import Lattice
from bus.partition import Partition
from bus.state import load_state, save_state
from cell_firmware.board import has_kernels
from cell_firmware.board_presets import BOARDS
from cell_firmware.build import MotorFacts
from cell_firmware.cell import CellFirmware, CellInputs, CellOutputs, PerCellAdapter
from cell_firmware.compiled import CompiledController
from cell_firmware.effects.registry import CellEffects
from cell_firmware.effects.serial.framing import check_of
from cell_firmware.firmware import Cells, Firmware, Inputs, Outbox, Outputs, State
from cell_firmware.loader import load
from cell_firmware.program import NoParameters
from cell_firmware.specs import CellsSpec

TICKS = 300
MOTORS = MotorFacts(12.0, 1.2)
HC11: dict[str, Any] = {name: dict(table) for name, table in BOARDS["hc11"].items()}


def without(*names: str) -> dict[str, Any]:
    """The board's effects but some."""
    return {name: table for name, table in HC11.items() if name not in names}


class Moody(Firmware):
    """Sends now and then, raises now and then, does not serve its watchdog now and then; a number a period decides."""

    Parameters = NoParameters
    message = np.dtype([("a", "<f4"), ("b", "<i2"), ("c", "?")])

    def init(self, cells: Cells) -> State:
        """A number a cell."""
        return {"mood": cells.row * 7919 + cells.column * 104729 + 1, "heard": np.zeros(len(cells))}

    def warm_start(self, cells: Cells, state: State) -> State:
        """The number goes on."""
        return {**self.init(cells), "mood": state["mood"] + 1}

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        """One period."""
        inbox = inputs.inbox
        assert inbox is not None
        mood = (state["mood"] * 48271) % 2147483647
        heard = state["heard"] + np.where(inbox.received, inbox.message["a"], 0.0)[:, 0]
        outbox = Outbox.empty(len(mood), self.message)  # pyright: ignore[reportArgumentType]
        for side in range(4):
            outbox.sent[:, side] = (mood >> side) % 3 > 0
        outbox.message["a"], outbox.message["b"] = (mood % 1000)[:, None] / 8.0, (mood % 100)[:, None] - 50
        outbox.message["c"] = (mood % 2 == 0)[:, None]
        speed = np.stack((mood % 11 / 10.0 - 0.5, inputs.presence[:, 0] * 0.3), axis=1)
        failed = {int(i): "it had enough" for i in np.flatnonzero(mood % 401 == 0)}
        return {"mood": mood, "heard": heard}, Outputs(speed, outbox, failed, mood % 5 > 0)


class Plain(CellFirmware):
    """A program in plain Python that counts what it hears."""

    message = np.dtype([("count", "<u2")])

    def init(self, cell: Any) -> Any:
        """Nothing heard."""
        return 0

    def step(self, state: Any, inputs: CellInputs) -> tuple[Any, CellOutputs]:
        """Count."""
        state = (state + sum(message is not None for message in inputs.inbox.values())) % 60_000
        return state, CellOutputs(
            (0.1 * (state % 5), -0.1), {side: {"count": state} for side in ("north", "west")}
        )


def bundled(name: str, **parameters: Any) -> Firmware:
    """A bundled program."""
    return load(CellsSpec(firmware=name, parameters=parameters))


FIELD = {"kind": "vortex", "rate_rad_s": 1.0, "centre_m": [0.1, 0.1]}
PROGRAMS: dict[str, Callable[[], Firmware]] = {
    "heat_diffusion": lambda: bundled(
        "heat_diffusion", initial=[{"cell": [0, 0], "speed_m_s": [0.4, -0.2]}], ttl_periods=3
    ),
    "presence_field": lambda: bundled("presence_field", field=FIELD, reach=2, ttl_periods=2),
    "velocity_field": lambda: bundled("velocity_field", field=FIELD),
    "exploding": lambda: bundled(
        "heat_diffusion", initial=[{"cell": [0, 0], "speed_m_s": [0.4, -0.2]}], diffusion_number=1e99
    ),
    "moody": lambda: Moody(NoParameters()),
    "plain": lambda: PerCellAdapter(Plain(NoParameters())),
}
EFFECTS: dict[str, dict[str, Any]] = {
    "none": {},
    "hc11": HC11,
    "clocks": {"clock": {"error_ppm": 5_000.0}},
    "mailbox": without("serial"),
    "serial": {"serial": {"baud": 9615}},
    "slow serial": {"serial": {"baud": 2404}},
    "watchdog": {"cop": {"timeout_s": 0.016384, "reboot_s": 0.01}},
    "floating": without("fixed_point"),
    "floating, no encoder": without("fixed_point", "encoder"),
    "word": without("encoder", "pwm"),
    "pwm": {"pwm": {"levels": 100}},
    "polled": {"serial": {"baud": 9615, "ring_bytes": 0}},
    "polled twice": {**without("serial"), "serial": {"baud": 9615, "ring_bytes": 0, "bytes_per_period": 2}},
    "shared": {**without("serial"), "serial": {"baud": 9615, "sharing": "mux"}},
    "shared, polled": {"serial": {"baud": 9615, "sharing": "mux", "ring_bytes": 0, "dwell_periods": 30}},
    "skewed": {"clock": {"error_ppm": 50_000.0}, "serial": {"baud": 2404}},
    "hc11, byte by byte": HC11,
    "serial, byte by byte": {"serial": {"baud": 31250}},
}
LIVE = ("hc11, byte by byte", "serial, byte by byte")
"""Boards to which faults may be injected."""


class Pair:
    """Two locksteps of the same cells: with the compiled and with the general controller."""

    def __init__(
        self, lockstep: Any, program: str, effects: str, shards: int, motors: MotorFacts | None
    ) -> None:
        lattice = Lattice((r, c) for r in range(3) for c in range(4) if (r, c) != (1, 2))
        enabled = CellEffects.model_validate(EFFECTS[effects])
        clocks = None if enabled.clock is None else enabled.clock.clocks(lattice, CellsSpec().period_ns, 5)
        partition = Partition.even(lattice, shards)
        live = effects in LIVE
        self.both = [
            lockstep(PROGRAMS[program](), partition, motors, enabled, 3, clocks, live=live) for _ in range(2)
        ]
        for shard in self.both[0].shards:
            assert isinstance(shard._controller, CompiledController) == has_kernels(shard._controller.general)
        for shard in self.both[1].shards:
            shard._controller, shard._kernel = shard._controller.general, None
        self.draw = np.random.default_rng([shards, len(program)])
        self.travel = np.zeros((len(lattice), 2))
        self.presence = np.zeros((len(lattice), 1), dtype=np.bool_)
        self.motors = motors

    def step(self) -> None:
        """A tick of both, with the same inputs; the drives must be the same bytes."""
        self.presence ^= self.draw.random(self.presence.shape) < 0.1
        encoder = None if self.motors is None else self.travel.copy()
        compiled, general = (one.step(self.presence.copy(), encoder) for one in self.both)
        assert compiled.tobytes() == general.tobytes(), self.both[0].tick
        for ours, theirs in zip(self.both[0].links, self.both[1].links, strict=True):
            assert ours is None or (
                ours.sent.tobytes() == theirs.sent.tobytes()
                and ours.message.tobytes() == theirs.message.tobytes()
            )
        self.travel += np.nan_to_num(general) * 0.01 * self.draw.uniform(0.5, 1.5, self.travel.shape)

    def compare(self) -> None:
        """Failures, registers, and counters must be the same."""
        ours, theirs = self.both
        assert [(f.cell, f.tick, f.problem) for f in ours.failures] == [
            (f.cell, f.tick, f.problem) for f in theirs.failures
        ]
        for one, other in zip(ours.shards, theirs.shards, strict=True):
            assert one.counters() == other.counters()
            cells, registers = one.registers()
            other_cells, others = other.registers()
            assert cells.tolist() == other_cells.tolist()
            assert registers.keys() == others.keys()
            for name, values in registers.items():
                assert values.dtype == others[name].dtype, name
                assert values.tobytes() == others[name].tobytes(), name


@pytest.mark.parametrize(
    ("program", "effects"),
    [
        ("moody", "hc11"),
        ("plain", "mailbox"),
        ("moody", "serial"),
        ("moody", "hc11, byte by byte"),
        ("heat_diffusion", "shared, polled"),
    ],
)
def test_the_compiled_controller_gives_the_same_bits(lockstep: Any, program: str, effects: str) -> None:
    compare_for(TICKS, lockstep, program, effects, shards=4)


@pytest.mark.slow
@pytest.mark.parametrize("shards", [pytest.param(1, marks=pytest.mark.nightly), 4])
@pytest.mark.parametrize("effects", list(EFFECTS))
@pytest.mark.parametrize("program", [name for name in PROGRAMS if name != "exploding"])
def test_the_compiled_controller_gives_the_same_bits_for_every_board(
    lockstep: Any, program: str, effects: str, shards: int
) -> None:
    compare_for(TICKS, lockstep, program, effects, shards)


@pytest.mark.parametrize("effects", ["hc11, byte by byte", "polled twice", "shared"])
def test_bytes_that_are_disturbed_on_the_way_are_read_alike(lockstep: Any, effects: str) -> None:
    """Bytes change, come too many, too late or again, and what a line carries is lost."""
    pair = Pair(lockstep, "moody", effects, 4, MOTORS)
    draw = np.random.default_rng(7)
    for _ in range(TICKS):
        pair.step()
        for ours, theirs in zip(pair.both[0].links, pair.both[1].links, strict=True):
            data = ours.message.view(np.uint8).reshape(len(ours.message), -1)
            hit = draw.random(data.shape) < 0.01
            data[hit] = draw.integers(0, 256, int(hit.sum()))
            ours.message["start_1_ns"] %= 4_000_000
            ours.message["start_2_ns"] %= 8_000_000
            ours.sent[:] |= draw.random(len(ours.sent)) < 0.1
            ours.sent[:] &= draw.random(len(ours.sent)) < 0.9
            ours.message[~ours.sent] = np.zeros((), dtype=ours.message.dtype)
            theirs.message[:], theirs.sent[:] = ours.message, ours.sent
    pair.compare()
    counters = sum((shard.counters() for shard in pair.both[0].shards), Counter[str]())
    assert counters["serial.damaged"] > 100
    assert (counters["serial.overruns"] > 10) == (effects == "polled twice")


def test_frames_with_a_check_byte_but_values_that_no_program_sends_are_damaged_alike(lockstep: Any) -> None:
    pair = Pair(lockstep, "moody", "serial, byte by byte", 4, MOTORS)
    draw = np.random.default_rng(11)
    infinite = np.array([0x00, 0x00, 0x80, 0x7F, 0x01, 0x02, 0x00], dtype=np.uint8)  # infinity, 513, false
    for _ in range(60):
        pair.step()
        for ours, theirs in zip(pair.both[0].links, pair.both[1].links, strict=True):
            frames = np.zeros((len(ours.sent), 8), dtype=np.uint8)
            frames[:, :7] = draw.integers(0, 256, (len(frames), 7))
            frames[:, 6] %= 3  # a truth value, or 2
            frames[::4, :7] = infinite
            frames[:, 7] = check_of(frames[:, :7])
            ours.message[:] = np.zeros((), dtype=ours.message.dtype)
            ours.message["bytes_1"], ours.message["start_1_ns"], ours.sent[:] = 8, 1_000, True
            ours.message["word_0"] = frames.view("<u8")[:, 0]
            theirs.message[:], theirs.sent[:] = ours.message, ours.sent
    pair.compare()
    counters = sum((shard.counters() for shard in pair.both[0].shards), Counter[str]())
    assert counters["serial.damaged"] > 100


def compare_for(ticks: int, lockstep: Any, program: str, effects: str, shards: int) -> None:
    """Step a pair, in which two cells die on the way."""
    needs_motors = effects == "none" or bool({"pwm", "encoder", "fixed_point"} & EFFECTS[effects].keys())
    pair = Pair(lockstep, program, effects, shards, MOTORS if needs_motors or shards == 4 else None)
    for k in range(ticks):
        if k == 100:
            for one in pair.both:
                one.retire([(0, 1), (2, 3)])
        pair.step()
        if k % 50 == 0:
            pair.compare()
    pair.compare()


def test_a_program_that_hangs_under_the_compiled_controller_is_reset(lockstep: Any) -> None:
    """The comparison above would not tell if no watchdog ever bit."""
    pair = Pair(lockstep, "moody", "watchdog", 1, None)
    for _ in range(TICKS):
        pair.step()
    counters = pair.both[0].shards[0].counters()
    assert counters["cop.hangs"] > 3
    assert counters["cop.resets"] > 3


@pytest.mark.parametrize("effects", ["none", "watchdog"])
def test_a_program_in_scalar_form_that_drives_no_number_fails_alike(lockstep: Any, effects: str) -> None:
    """Without a watchdog its cell is lost, and the others go on; with one it hangs and is reset."""
    pair = Pair(lockstep, "exploding", effects, 2, None)
    for _ in range(40):
        pair.step()
        pair.compare()
    ours = pair.both[0]
    if effects == "none":
        assert len({failure.cell for failure in ours.failures}) > 3
        assert "not finite" in ours.failures[0].problem
    else:
        assert sum(shard.counters()["cop.hangs"] for shard in ours.shards) > 3


def test_a_snapshot_goes_from_either_controller_to_the_other(lockstep: Any) -> None:
    pair = Pair(lockstep, "heat_diffusion", "hc11", 1, MOTORS)
    for _ in range(120):
        pair.step()
    ours, theirs = (one.shards[0] for one in pair.both)
    saved, others = save_state(ours), save_state(theirs)
    load_state(ours, others)
    load_state(theirs, saved)
    for _ in range(120):
        pair.step()
    pair.compare()


def test_registers_and_snapshots_are_not_changed_by_later_ticks(lockstep: Any) -> None:
    """The compiled controller changes the boards' memory in place."""
    pair = Pair(lockstep, "heat_diffusion", "hc11", 1, MOTORS)
    for _ in range(50):
        pair.step()
    shard = pair.both[0].shards[0]
    registers, saved = shard.registers()[1], save_state(shard)
    before = {name: values.tobytes() for name, values in registers.items()}
    for _ in range(20):
        pair.step()
    assert {name: values.tobytes() for name, values in registers.items()} == before
    load_state(shard, saved)
    assert {name: values.tobytes() for name, values in shard.registers()[1].items()} == before
