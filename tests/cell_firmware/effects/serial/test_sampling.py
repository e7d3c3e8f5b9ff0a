"""What is read of bytes whose sender's clock is another: held to the line's levels, bit by bit."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cell_firmware.effects.serial.framing import check_of
from cell_firmware.effects.serial.timing import LineSettings, sample_map
from tests.cell_firmware.effects.serial.line import BIT_NS, ONE_BYTE, PERIOD_NS, Bits, ReceiverBench

FAST = LineSettings(16 * 500, PERIOD_NS)
"""125,000 baud: room for many bytes in a tick."""
SLOW = LineSettings(BIT_NS, PERIOD_NS)


def framing(value: int, own_ppm: int, count: int = 10) -> tuple[int, int]:
    """Framing errors of so many such bytes back to back, and how many are received."""
    bench = ReceiverBench(FAST, np.dtype([("a", "u1", ()), ("b", "<u8")]), (0, own_ppm * 1000))
    for tick in range(1, 5):
        bench.tick(tick, tick * PERIOD_NS, [(0, bytes([value]) * count)] if tick == 1 else [])
    return bench.counted("framing"), bench.counted("received")


def test_a_receiver_six_per_cent_fast_finds_no_stop_bit_in_any_byte_of_zeros() -> None:
    assert framing(0x00, -60_000) == (10, 0)
    assert framing(0xFF, -60_000) == (0, 10)  # the last data bit stands in for it


def test_a_receiver_six_per_cent_slow_finds_the_next_start_bit_in_place_of_any_stop_bit() -> None:
    assert framing(0x00, 60_000) == framing(0xFF, 60_000) == (9, 1)  # nothing follows the last


def test_the_next_start_bit_counts_whichever_burst_brings_it() -> None:
    """Eight bytes back to back: within a window, over its end, and with a nanosecond's gap; the last is alone."""
    bench = ReceiverBench(SLOW, np.dtype([("a", "u1"), ("b", "<u8")]), (0, 60_000_000))
    byte_ns = SLOW.byte_ns
    over = 4 * byte_ns - PERIOD_NS
    bursts = {
        1: [(0, b"\xff" * 2), (2 * byte_ns, b"\xff" * 2)],
        2: [(over, b"\xff"), (over + byte_ns + 1, b"\xff" * 3)],
    }
    for tick in range(1, 8):
        bench.tick(tick, tick * PERIOD_NS, bursts.get(tick, []))
    assert (bench.counted("framing"), bench.counted("received")) == (7, 1)


@pytest.mark.parametrize(
    ("lines", "count", "counts"),
    [(FAST, 17, (16, 0, 1)), (LineSettings(BIT_NS, PERIOD_NS, 0, 2), 2, (1, 1, 0))],
)
def test_a_byte_with_a_framing_error_takes_up_the_register_but_no_place_in_a_ring(
    lines: LineSettings, count: int, counts: tuple[int, int, int]
) -> None:
    bench = ReceiverBench(lines, np.dtype([("a", "u1"), ("b", "<u8")]), (0, 60_000_000))
    for tick in range(1, 4):
        bench.tick(tick, tick * PERIOD_NS, [(0, b"\xff" * count)] if tick == 1 else [])
    assert tuple(map(bench.counted, ("framing", "overruns", "received"))) == counts


@pytest.mark.parametrize("own_ppm", [-40_000, 40_000, -50_000, 52_000])
@pytest.mark.parametrize("value", [0x00, 0xFF])
def test_four_and_five_per_cent_lose_nothing(own_ppm: int, value: int) -> None:
    assert framing(value, own_ppm) == (0, 10)


def test_the_limit_is_half_a_bit_in_nine_and_a_half() -> None:
    """Slow by 10 / 9.5, and fast by 9 / 9.5: 5.3 %."""
    for number, limit in ((10, Fraction(10) / Fraction(19, 2)), (8, Fraction(9) / Fraction(19, 2))):
        beyond = round((limit - 1) * 10**9)
        samples = sample_map(np.array([beyond - 10, beyond + 10]), np.zeros(2, dtype=np.int64))[:, 9].tolist()
        assert sorted(samples) == sorted([9, number])


RUN = st.lists(st.sampled_from([0x00, 0xFF, 0x55, 0x80, 0x01, 0x7F, 0xA3]), min_size=1, max_size=4)
PPM = st.sampled_from([-60_000, -45_000, 45_000, 60_000]) | st.integers(-60_000, 60_000)
GAP = st.sampled_from([0, 0, 1, BIT_NS // 8, BIT_NS // 2, BIT_NS, 5 * BIT_NS, 12 * BIT_NS, 40 * BIT_NS])


@settings(max_examples=80, deadline=None)
@given(
    runs=st.lists(st.tuples(GAP, RUN), min_size=1, max_size=8),
    sender_ppm=PPM,
    own_ppm=PPM,
)
def test_bytes_gaps_and_clocks_of_any_kind_are_read_as_the_line_s_levels_say(
    runs: list[tuple[int, list[int]]], sender_ppm: int, own_ppm: int
) -> None:
    byte_ns = SLOW.byte_ns + SLOW.byte_ns * sender_ppm // 10**6
    line = Bits(Fraction(BIT_NS * (10**6 + sender_ppm), 10**6), Fraction(BIT_NS * (10**6 + own_ppm), 10**6))
    ticks: list[list[tuple[int, bytes]]] = [[]]
    free = 0
    for gap, data in runs:
        if len(ticks[-1]) == 2:  # a tick has no more runs
            free = max(free, len(ticks) * PERIOD_NS)
        start = free + gap
        ticks += [[] for _ in range(start // PERIOD_NS + 1 - len(ticks))]
        ticks[-1].append((start % PERIOD_NS, bytes(data)))
        line.starts += [(start + i * byte_ns, value) for i, value in enumerate(data)]
        free = start + len(data) * byte_ns
    bench = ReceiverBench(SLOW, np.dtype([("a", "u1"), ("b", "<u8")]), (sender_ppm * 1000, own_ppm * 1000))
    for tick in range(1, len(ticks) + 6):
        bench.tick(tick, tick * PERIOD_NS, ticks[tick - 1] if tick <= len(ticks) else [])
    read = [line.read(start) for start, _ in line.starts]
    assert bench.counted("framing") == sum(not good for _, good in read)
    assert bench.counted("received") == sum(good for _, good in read)


@settings(max_examples=80, deadline=None)
@given(
    values=st.integers(0, 255), sender_ppm=st.integers(-60_000, 60_000), own_ppm=st.integers(-60_000, 60_000)
)
def test_the_message_is_what_the_levels_say_and_damaged_where_its_check_byte_is_not(
    values: int, sender_ppm: int, own_ppm: int
) -> None:
    frame = bytes([values, int(check_of(np.array([[values]], dtype=np.uint8))[0])])
    byte_ns = FAST.byte_ns + FAST.byte_ns * sender_ppm // 10**6
    line = Bits(
        Fraction(FAST.bit_ns * (10**6 + sender_ppm), 10**6),
        Fraction(FAST.bit_ns * (10**6 + own_ppm), 10**6),
        [(i * byte_ns, v) for i, v in enumerate(frame)],
    )
    read = [line.read(start) for start, _ in line.starts]
    good_values = [value for value, good in read if good]
    whole = (
        len(good_values) == 2 and check_of(np.array([[good_values[0]]], dtype=np.uint8))[0] == good_values[1]
    )
    bench = ReceiverBench(FAST, ONE_BYTE, (sender_ppm * 1000, own_ppm * 1000))
    for tick in range(1, 6):
        bench.tick(tick, tick * PERIOD_NS, [(0, frame)] if tick == 1 else [])
    assert [m for m in bench.messages if m is not None] == ([(good_values[0],)] if whole else [])
    assert bench.counted("damaged") == (bool(good_values) and not whole)
