"""Messages that go whole, held to the same messages going byte by byte."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.board import Board
from cell_firmware.clocks import ArrayClocks, CellClocks
from cell_firmware.components import LinkDriver
from cell_firmware.effects.clock.wrapper import LocalClockWrapper
from cell_firmware.effects.cop.spec import CopSpec
from cell_firmware.effects.cop.wrapper import WatchdogWrapper
from cell_firmware.effects.serial.lines import SerialLines
from cell_firmware.effects.serial.message_level import MessageLevelLines, is_exact_for
from cell_firmware.effects.serial.timing import LineSettings, bit_ns
from cell_firmware.firmware import Cells, Firmware, Inputs, Outbox, Outputs, State
from cell_firmware.program import NoParameters
from cell_firmware.shard import Shard

PERIOD_NS = 4_096_000
LATTICE = Lattice((row, column) for row in range(2) for column in range(3))
CELLS = Cells.of(LATTICE, np.zeros((len(LATTICE), 2)), 0.004096)


class Chatty(Firmware):
    """Says something on some sides in some periods, and remembers the last word of each side, and how many came."""

    def __init__(self, length: int, often: int, hangs: tuple[int, int]) -> None:
        super().__init__(NoParameters())
        self.more = [f"b{i}" for i in range(length - 4)]
        self.words = np.dtype([("began", "<u4"), *((name, "u1") for name in self.more)])
        self.message = self.words  # pyright: ignore[reportIncompatibleVariableOverride, reportAttributeAccessIssue]
        self._often, self._hangs = often, hangs

    def init(self, cells: Cells) -> State:
        n = len(cells)
        return {
            "cell": (cells.row * 16 + cells.column).astype(np.int64),
            "step": np.zeros(n, dtype=np.int64),
            "word": np.zeros((n, 4), dtype=np.int64),
            "came": np.zeros((n, 4), dtype=np.int64),
        }

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        inbox = inputs.inbox
        assert inbox is not None
        n, step, cell = len(state["cell"]), state["step"], state["cell"]
        if ((cell == self._hangs[0]) & (step == self._hangs[1])).any():
            raise RuntimeError("hangs")
        outbox = Outbox.empty(n, self.words)
        mix = (step[:, None] * 7 + cell[:, None] * 5 + np.arange(4) * 3) % 11
        outbox.sent[:] = mix < self._often
        outbox.message["began"] = (step * 256 + cell)[:, None] * 4 + np.arange(4)
        for name in self.more:
            outbox.message[name] = (mix + ord(name[-1])).astype(np.uint8)
        last = inbox.message[self.more[-1]].astype(np.int64) if self.more else 0
        word = np.where(inbox.received, inbox.message["began"].astype(np.int64) * 256 + last, state["word"])
        after = {**state, "step": step + 1, "word": word, "came": state["came"] + inbox.received}
        return after, Outputs(np.zeros((n, 2)), outbox)


@dataclass
class Scenario:
    """What happens on the lines."""

    baud: int
    length: int
    often: int
    exchanges: int
    ppb: list[int] | None
    phase_ns: list[int]
    dies: tuple[int, int]
    hangs: tuple[int, int]
    reboot_s: float | None

    @property
    def lines(self) -> LineSettings:
        return LineSettings(bit_ns(self.baud), PERIOD_NS)

    @property
    def window_ns(self) -> int:
        return PERIOD_NS if self.ppb is None else PERIOD_NS * 99 // 100 // self.exchanges

    def run(
        self, kind: type[SerialLines] | type[MessageLevelLines], ticks: int
    ) -> list[dict[str, NDArray[Any]]]:
        """Registers of all cells, tick by tick."""
        firmware, errors, clocks = Chatty(self.length, self.often, self.hangs), None, None
        if self.ppb is not None:
            own = CellClocks(PERIOD_NS, self.window_ns, np.array(self.ppb), np.array(self.phase_ns))
            clocks = ArrayClocks(LATTICE, own)
            errors = clocks.ppb
        links: LinkDriver = kind(
            self.lines, firmware.words, None if clocks is None else self.window_ns, errors
        )
        controller: Any = Board(firmware, None, links)
        if self.reboot_s is not None:
            controller = WatchdogWrapper(
                controller, CopSpec(timeout_s=0.016384, reboot_s=self.reboot_s), PERIOD_NS
            )
        if clocks is not None:
            controller = LocalClockWrapper(controller, clocks)
        shard = Shard(controller, CELLS, Partition.even(LATTICE, 1), 0)
        registers: list[dict[str, NDArray[Any]]] = []
        for tick in range(ticks):
            if tick == self.dies[1]:
                shard.retire([LATTICE.cells[self.dies[0]]])
            shard.step(tick, np.zeros((len(LATTICE), 1), dtype=np.bool_))
            registers.append({name: value.copy() for name, value in shard.registers()[1].items()})
        return registers


scenarios = st.builds(
    Scenario,
    baud=st.sampled_from([31250, 9615, 4808, 2404]),
    length=st.sampled_from([4, 5, 9, 17]),
    often=st.integers(1, 11),
    exchanges=st.sampled_from([1, 1, 2]),
    ppb=st.none() | st.lists(st.integers(-9_000_000, 9_000_000), min_size=6, max_size=6),
    phase_ns=st.lists(st.integers(0, PERIOD_NS - 1), min_size=6, max_size=6),
    dies=st.tuples(st.integers(0, 5), st.integers(0, 90)),
    hangs=st.tuples(st.sampled_from([0, 1, 2, 16, 17, 18, 99]), st.integers(1, 40)),
    reboot_s=st.none() | st.sampled_from([0.01, 0.03]),
)


JUST_THERE = Scenario(9615, 4, 6, 1, [0] * 6, [0, 2_103_040] * 3, (0, 999), (99, 0), None)
"""Messages are whole exactly when their receivers step: 60 bits and a window after their senders did."""
JUST_FREE = Scenario(31250, 62, 11, 1, None, [], (0, 999), (99, 0), None)
"""Lines are free again exactly when the cells step: 64 characters take five periods."""
LONG = Scenario(
    9615, 9, 6, 1, [9_000_000, -9_000_000, 0, 1, 2, 3], [0, 1, 2, 3, 4, 5], (0, 999), (99, 0), None
)


@pytest.mark.slow
@settings(max_examples=60)
@given(scenarios, st.just(90))
@example(LONG, 1_100)  # beyond what 32 bits hold in nanoseconds
@example(JUST_THERE, 90)
@example(JUST_FREE, 90)
def test_programs_receive_the_same_messages_at_the_same_times_as_from_bytes(
    scenario: Scenario, ticks: int
) -> None:
    if scenario.reboot_s is None:
        scenario.hangs = (99, 0)
    assume(is_exact_for(scenario.lines, scenario.window_ns, 9_000_000))
    by_bytes, whole = (scenario.run(kind, ticks) for kind in (SerialLines, MessageLevelLines))
    for tick, (one, other) in enumerate(zip(by_bytes, whole, strict=True)):
        for name in ("firmware.came", "firmware.word", "serial.replaced"):
            np.testing.assert_array_equal(one[name], other[name], err_msg=f"{name} in tick {tick}")


def test_counters_count_whole_messages() -> None:
    scenario = Scenario(9615, 9, 3, 1, None, [], (0, 999), (99, 0), None)
    by_bytes, whole = (scenario.run(kind, 200)[-1] for kind in (SerialLines, MessageLevelLines))
    for name in ("serial.sent", "serial.received"):
        short = by_bytes[name] - whole[name]
        assert (whole[name] % 10 == 0).all()
        assert (short >= 0).all()
        assert (short <= 20).all()
        assert whole[name].sum() > 0
    assert set(by_bytes) == set(whole)


@pytest.mark.parametrize(
    ("changes", "window_ns", "worst_ppb"),
    [
        ({"ring_bytes": 0}, PERIOD_NS, 0),
        ({"dwell_periods": 8}, PERIOD_NS, 0),
        ({"bit_ns": bit_ns(125_000)}, PERIOD_NS, 0),  # 51 bytes between two looks, and 16 places
        ({}, PERIOD_NS, 26_000_000),  # the stop bit's sample may miss it
        ({}, PERIOD_NS // 16, 0),  # a message would be under way for too many exchanges
        ({"period_ns": 2_000_000_000}, 2_000_000_000, 0),
    ],
)
def test_lines_on_which_something_may_happen_to_a_byte_are_none_of_these(
    changes: dict[str, Any], window_ns: int, worst_ppb: int
) -> None:
    usual = {"bit_ns": bit_ns(9615), "period_ns": PERIOD_NS}
    assert is_exact_for(LineSettings(**usual), PERIOD_NS, 25_000_000)
    assert not is_exact_for(LineSettings(**{**usual, **changes}), window_ns, worst_ppb)
