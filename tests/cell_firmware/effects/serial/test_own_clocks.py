"""Lines between cells that step at instants of their own, each window being exchanged when it is over."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cell_firmware.controller import StepTime
from cell_firmware.effects.serial.bursts import BurstType
from cell_firmware.effects.serial.framing import check_of
from cell_firmware.effects.serial.lines import SerialLines
from cell_firmware.effects.serial.timing import LineSettings, bit_ns
from cell_firmware.firmware import Inbox, Outbox
from tests.cell_firmware.effects.serial.line import (
    EAST,
    ONE_BYTE,
    PERIOD_NS,
    WEST,
    ReceiverBench,
    errors_of,
    two_cells,
)

BILLION = 10**9
MESSAGE = np.dtype([("a", "<u4")])


class OwnClocks:
    """Cell 0,0 sends cell 0,1 the number of its step, every step.

    Attributes:
        starts: When its bytes start.
        received: When cell 0,1 receives a message, and the message.
    """

    def __init__(
        self, settings: LineSettings, ppb: tuple[int, int], phase_ns: tuple[int, int], windows: int
    ) -> None:
        self._ppb, self._phase = ppb, phase_ns
        self.window_ns = PERIOD_NS * (BILLION - 60_000_000) // BILLION // windows
        self.part = SerialLines(settings, MESSAGE, self.window_ns, errors_of(*ppb))
        self.state = self.part.init(two_cells())
        self.starts: list[int] = []
        self.steps: tuple[list[int], list[int]] = ([], [])
        self.received: list[tuple[int, int]] = []
        self._parts = BurstType(settings.slots(MESSAGE.itemsize + 1)).parts

    def run(self, ticks: int) -> None:
        lines = Inbox(np.zeros((2, 4), dtype=np.bool_), np.zeros((2, 4), dtype=self.part.line))
        for tick in range(ticks):  # the window; its exchange is the next
            at = [self._instant(cell, tick) for cell in (0, 1)]
            self.state, inbox = self.part.receive(StepTime(tick + 1, np.array(at)), self.state, lines)
            if inbox.received[1, WEST]:
                self.received.append((at[1], int(inbox.message["a"][1, WEST])))
            lines = Inbox(np.zeros((2, 4), dtype=np.bool_), np.zeros((2, 4), dtype=self.part.line))
            rows = [cell for cell in (0, 1) if at[cell] >= 0]
            if not rows:
                continue
            out = self._send(tick, np.array(at), np.array(rows))
            for row, cell in enumerate(rows):
                self.steps[cell].append(at[cell])
                if cell == 0:
                    lines.received[1, WEST], lines.message[1, WEST] = (
                        out.sent[row, EAST],
                        out.message[row, EAST],
                    )
                    self._log(tick, out.message.view(self._parts)[row, EAST])

    def _send(self, tick: int, at: Any, rows: Any) -> Outbox:
        """Those that step send; the others' state stays as it is."""
        outbox = Outbox.empty(len(rows), MESSAGE)
        outbox.message["a"] = [[len(self.steps[row])] * 4 for row in rows]
        outbox.sent[:] = True
        taken = {name: array[rows] for name, array in self.state.items()}
        after, out = self.part.send(StepTime(tick + 1, at[rows]), taken, outbox)
        state = {name: array.copy() for name, array in self.state.items()}
        for name, array in after.items():
            state[name][rows] = array
        self.state = state
        return out

    def _instant(self, cell: int, tick: int) -> int:
        """When a cell steps in a window; negative where it doesn't."""
        number = len(self.steps[cell])
        at = self._phase[cell] + number * PERIOD_NS * (BILLION + self._ppb[cell]) // BILLION
        return at if at < (tick + 1) * self.window_ns else -1

    def _log(self, tick: int, burst: Any) -> None:
        byte_ns = self.part.settings.byte_ns
        byte_ns += byte_ns * self._ppb[0] // BILLION
        for run in (1, 2):
            begins = tick * self.window_ns + int(burst[f"start_{run}_ns"])
            self.starts += [begins + i * byte_ns for i in range(int(burst[f"bytes_{run}"]))]

    def end_of(self, last_start_ns: int) -> int:
        """When a message has ended for cell 0,1 whose last byte starts then: ten bits, nine of its own, the delay."""
        byte_ns, bit = self.part.settings.byte_ns, self.part.settings.bit_ns
        own = 9 * bit + 9 * bit * self._ppb[1] // BILLION
        return last_start_ns + byte_ns + byte_ns * self._ppb[0] // BILLION + own + self.window_ns + bit


PPB = st.integers(-20_000_000, 20_000_000)
PHASE = st.integers(0, PERIOD_NS - 1)


@settings(max_examples=30, deadline=None)
@given(
    ppb=st.tuples(PPB, PPB),
    phase_ns=st.tuples(PHASE, PHASE),
    windows=st.sampled_from([1, 1, 3]),
    baud=st.sampled_from([9615, 31_250, 2404]),
)
def test_messages_are_read_at_the_first_step_after_their_end_however_clocks_and_windows_lie(
    ppb: tuple[int, int], phase_ns: tuple[int, int], windows: int, baud: int
) -> None:
    pair = OwnClocks(LineSettings(bit_ns(baud), PERIOD_NS), ppb, phase_ns, windows)
    pair.run((16 + 20 * bit_ns(baud) * 10 // PERIOD_NS) * windows)
    ends = [pair.end_of(start) for start in pair.starts[4::5]]  # four bytes and a check byte
    steps = pair.steps[1]
    expected = [min(at for at in steps if at >= end) for end in ends if end <= steps[-1]]
    # of two that end between two steps the later one is read
    assert [at for at, _ in pair.received] == sorted(set(expected))
    numbers = [number for _, number in pair.received]
    assert numbers == sorted(set(numbers))
    for name in ("framing", "damaged", "overruns"):
        assert not pair.state[name].any()
    assert len(pair.received) > 2


@pytest.mark.parametrize("ppb", [(20_000_000, -20_000_000), (-20_000_000, 20_000_000)])
def test_a_message_ends_ten_bits_of_the_sender_s_and_nine_of_the_receiver_s_after_its_last_start(
    ppb: tuple[int, int],
) -> None:
    """And a window and a bit, by no clock, for the exchange."""
    byte_ns, nine_bits = 1_040_000 * (BILLION + ppb[0]) // BILLION, 936_000 * (BILLION + ppb[1]) // BILLION
    end = byte_ns + byte_ns + nine_bits + PERIOD_NS + 104_000
    for early in (0, 1):
        bench = ReceiverBench(LineSettings(bit_ns(9615), PERIOD_NS), ONE_BYTE, ppb)
        bench.tick(1, -1, [(0, bytes([7, int(check_of(np.array([[7]], dtype=np.uint8))[0])]))])
        bench.tick(2, end - early, [])
        assert bench.messages == [None, None if early else (7,)]


def test_of_bursts_that_arrive_while_a_cell_does_not_read_the_oldest_is_lost_and_counted() -> None:
    bench = ReceiverBench(LineSettings(bit_ns(9615), PERIOD_NS), ONE_BYTE, (0, 0))
    for tick in range(1, 11):
        bench.tick(tick, -1, [(0, bytes([tick] * 3))])
    lost = bench.counted("overruns")
    assert 0 < lost < 30
    assert lost % 3 == 0
    bench.tick(11, 14 * PERIOD_NS, [])
    assert bench.counted("received") + bench.counted("overruns") == 30


@pytest.mark.parametrize("ppb", [(0, 0), (100_000, -100_000), (-30_000_000, 0)])
def test_bytes_start_at_the_sender_s_steps_and_follow_by_its_clock(ppb: tuple[int, int]) -> None:
    pair = OwnClocks(LineSettings(bit_ns(9615), PERIOD_NS), ppb, (1_234_567, 77), 1)
    pair.run(40)
    byte_ns = 1_040_000 + 1_040_000 * ppb[0] // BILLION
    # a message takes five bytes and an idle character, and there is always one that waits
    number = np.arange(len(pair.starts))
    ideal = pair.steps[0][0] + (number + number // 5) * byte_ns
    assert pair.starts[0] == 1_234_567
    assert np.abs(np.array(pair.starts) - ideal).max() <= 40  # a nanosecond a period


def test_clocks_that_are_too_far_apart_lose_everything_whole_messages_and_all() -> None:
    pair = OwnClocks(LineSettings(bit_ns(9615), PERIOD_NS), (-30_000_000, 30_000_000), (0, 2_000_000), 1)
    pair.run(60)
    assert pair.received == []
    assert pair.state["framing"][1, WEST] > 100
