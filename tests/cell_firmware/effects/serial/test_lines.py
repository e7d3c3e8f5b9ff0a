"""What a line does with whole messages: held to times worked out by hand."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cell_firmware.effects.serial.framing import bytes_of, check_of
from cell_firmware.effects.serial.timing import E_CLOCK_NS, LineSettings, bit_ns
from cell_firmware.errors import FirmwareError
from tests.cell_firmware.effects.serial.line import (
    BIT_NS,
    ONE_BYTE,
    PERIOD_NS,
    WEST,
    Pair,
    ReceiverBench,
    two_cells,
)

TWO_SPEEDS = np.dtype([("vx_m_s", "<f8"), ("vy_m_s", "<f8")])
RING = LineSettings(BIT_NS, PERIOD_NS)
POLLED = LineSettings(BIT_NS, PERIOD_NS, ring_bytes=0)
BYTE_NS = 1_040_000


def check(*data: int) -> int:
    return int(check_of(np.array([data], dtype=np.uint8))[0])


@pytest.mark.parametrize(("baud", "clocks"), [(9615, 2080), (125_000, 160), (31_250, 640)])
def test_bytes_follow_each_other_every_ten_bits_of_e_clocks(baud: int, clocks: int) -> None:
    pair = Pair(LineSettings(bit_ns(baud), PERIOD_NS), TWO_SPEEDS)
    for k in range(6):
        pair.step((1.5, -2.5) if k == 0 else None)
    assert [later - start for (start, _), (later, _) in pairwise(pair.starts)] == [clocks * E_CLOCK_NS] * 16
    assert pair.starts[0][0] == 0
    data = np.array([(1.5, -2.5)], dtype=TWO_SPEEDS).tobytes()
    assert bytes(byte for _, byte in pair.starts) == data + bytes([check(*data)])


def test_a_line_that_is_never_idle_carries_three_point_nine_characters_a_period() -> None:
    pair, periods = Pair(RING, TWO_SPEEDS), 500
    for k in range(periods):
        pair.step((float(k), 0.0))
    characters = pair.counted("sent", 0, 1) * 18 / 17  # an idle one to each message
    assert characters / periods == pytest.approx(PERIOD_NS / BYTE_NS, abs=0.02)


def test_a_byte_is_readable_nine_and_a_half_bits_after_its_start_or_later() -> None:
    for early in (0, 1):
        bench = ReceiverBench(RING, ONE_BYTE)
        bench.tick(1, PERIOD_NS - early, [(PERIOD_NS - 19 * BIT_NS // 2, b"7")])
        assert bench.counted("received") == 1 - early


def test_a_byte_that_starts_with_a_period_is_read_in_the_next_and_the_fourth_in_the_one_after() -> None:
    pair = Pair(RING, TWO_SPEEDS)
    received: list[int] = []
    for k in range(6):
        pair.step((1.0, 2.0) if k == 0 else None)
        received.append(pair.counted("received"))
    # stop bits are sampled at 988, 2028, 3068 and 4108 us, and so on; periods end at 4096, 8192, ...
    assert received == [0, 3, 7, 11, 15, 17]


def test_a_message_that_spans_periods_arrives_once_an_idle_character_has_followed_it() -> None:
    pair = Pair(RING, TWO_SPEEDS)
    for k in range(8):
        pair.step((0.25, -1e300) if k == 1 else None)
    # 16 bytes, ten bits and nine more: 16.64 + 1.976 ms after the second period's beginning, in its fifth after that
    assert pair.received == [(1 + 5, (0.25, -1e300))]
    assert -(-(16 * BYTE_NS + 19 * BIT_NS) // PERIOD_NS) == 5
    assert RING.periods(bytes_of(TWO_SPEEDS)) == 5


def test_while_one_goes_out_the_newest_waits_and_what_it_replaces_is_counted() -> None:
    pair = Pair(RING, TWO_SPEEDS)
    for k in range(40):
        pair.step((float(k), 0.0))
    begins, said, free = [0], [0], 18 * BYTE_NS  # with the idle character
    while free < 40 * PERIOD_NS:
        begins.append(free)
        said.append(free // PERIOD_NS)  # the newest there is when it begins
        free += 18 * BYTE_NS
    there = [-(-(begin + 16 * BYTE_NS + 19 * BIT_NS) // PERIOD_NS) for begin in begins]
    expected = [(tick, (float(k), 0.0)) for tick, k in zip(there, said, strict=True) if tick < 40]
    assert pair.received == expected
    assert pair.counted("replaced", 0, 1) == 40 - len(said) - (said[-1] != 39)


def test_a_burst_that_is_lost_damages_its_message_and_the_next_is_right() -> None:
    for lost in range(5):
        pair = Pair(RING, TWO_SPEEDS)
        for k in range(14):
            pair.step((float(k), 1.0) if k in (0, 6) else None, lose=k == lost)
        assert [message for _, message in pair.received] == [(6.0, 1.0)]
        assert pair.counted("damaged") in ((1,) if lost in (0, 4) else (1, 2))


@pytest.mark.parametrize("more", [-1, 0, 1, 5])
def test_a_message_that_is_short_or_long_is_damaged_though_its_beginning_would_pass(more: int) -> None:
    bench = ReceiverBench(RING, np.dtype([("a", "<u2")]))
    frame = bytes([1, 2, check(1, 2), 3, 4, 5, 6, 7])
    for tick in range(1, 6):
        bench.tick(tick, tick * PERIOD_NS, [(0, frame[: 3 + more])] if tick == 1 else [])
    assert [message for message in bench.messages if message] == ([(0x0201,)] if more == 0 else [])
    assert bench.counted("damaged") == (more != 0)


def test_a_ring_that_is_full_loses_the_new_bytes_and_counts_them() -> None:
    fast = LineSettings(bit_ns(125_000), PERIOD_NS)
    bench = ReceiverBench(fast, np.dtype([(f"f{i}", "<u8") for i in range(3)]))
    bench.tick(1, PERIOD_NS, [(0, bytes(range(9))), (9 * fast.byte_ns, bytes(range(9, 20)))])
    assert (bench.counted("received"), bench.counted("overruns")) == (16, 4)
    assert bench.state["buffer"][1, WEST, :16].tolist() == list(range(16))
    bench.tick(2, 2 * PERIOD_NS, [(0, bytes(range(5)))])  # looked at: there is room again
    assert (bench.counted("received"), bench.counted("overruns")) == (21, 4)


def test_a_register_that_is_polled_keeps_the_first_byte_and_loses_the_second() -> None:
    pair = Pair(LineSettings(BIT_NS, PERIOD_NS, ring_bytes=0, polled_bytes=2), ONE_BYTE)
    for k in range(6):
        pair.step((0x5A,) if k == 0 else None)
    assert [byte for _, byte in pair.starts] == [0x5A, check(0x5A)]
    assert (pair.counted("received"), pair.counted("overruns")) == (1, 1)
    assert pair.state["buffer"][1, WEST, 0] == 0x5A
    assert (pair.received, pair.counted("damaged")) == ([], 1)


def test_a_driver_that_polls_sends_a_byte_a_period_and_a_period_without_ends_the_message() -> None:
    pair = Pair(POLLED, ONE_BYTE)
    for k in range(12):
        pair.step((k,))
    starts = [start // PERIOD_NS for start, _ in pair.starts]
    assert starts == [0, 1, 3, 4, 6, 7, 9, 10]
    assert all(start % PERIOD_NS == 0 for start, _ in pair.starts)
    # the bytes of periods 0 and 1 are read in 1 and 2; 3 brings none
    assert pair.received == [(3, (0,)), (6, (3,)), (9, (6,))]
    assert pair.counted("overruns") == pair.counted("damaged") == 0


def test_both_directions_of_a_link_are_lines_of_their_own() -> None:
    pair = Pair(RING, ONE_BYTE)
    for k in range(6):
        pair.step((k,), back=(100 + k,))
    assert [message for _, message in pair.received] == [(k,) for k in range(5)]
    assert pair.counted("received", 0, 1) == pair.counted("received")
    for name in ("overruns", "framing", "damaged", "unheard"):
        assert not pair.state[name].any()
    assert pair.part.counters(pair.state)["sent"] == pair.state["sent"].sum() == 4 * 6
    assert pair.part.registers(pair.state)["sent"].tolist() == [[0, 12, 0, 0], [0, 0, 0, 12]]


def test_a_reset_drops_messages_in_transmission_and_retains_counters() -> None:
    pair = Pair(RING, TWO_SPEEDS)
    for k in range(3):
        pair.step((float(k), 0.0))
    before = pair.state
    pair.state = pair.part.reset(two_cells(), before)
    assert pair.state["sent"].tolist() == before["sent"].tolist()
    assert pair.state["sent"].any()
    assert not pair.state["waits"].any()
    assert (pair.state["gone"] == 17).all()
    for _ in range(8):
        pair.step()
    assert pair.received == []


def test_states_that_are_handed_in_stay_as_they_were() -> None:
    pair = Pair(RING, TWO_SPEEDS)
    for k in range(30):
        before = {name: array.copy() for name, array in pair.state.items()}
        held = pair.state
        pair.step((float(k), 0.0), back=(0.0, float(k)))
        assert all((held[name] == array).all() for name, array in before.items())


@settings(max_examples=60, deadline=None)
@given(
    said=st.lists(st.one_of(st.none(), st.integers(0, 255)), min_size=1, max_size=30),
    baud=st.sampled_from([9615, 4808, 1202, 300, 125_000, 62_500]),
    polls=st.booleans(),
)
def test_only_sent_messages_are_received_and_the_last_one_always_is(
    said: list[Any], baud: int, polls: bool
) -> None:
    polls = polls and baud > 2441
    pair = Pair(LineSettings(bit_ns(baud), PERIOD_NS, ring_bytes=0 if polls else 16), ONE_BYTE)
    for word in said:
        pair.step(None if word is None else (word,))
    for _ in range(8 + 7 * 10 * bit_ns(baud) // PERIOD_NS):  # one on its way, one that waits
        pair.step()
    words = iter([word for word in said if word is not None])
    received = [message[0] for _, message in pair.received]
    assert all(any(word == one for one in words) for word in received)  # a part of it, in order
    sent = [word for word in said if word is not None]
    assert received[-1:] == sent[-1:]
    assert len(received) + pair.counted("replaced", 0, 1) == len(sent)
    assert pair.counted("damaged") == pair.counted("overruns") == 0


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        (LineSettings(bit_ns(1202), PERIOD_NS, ring_bytes=0), "a driver that polls needs the 8320000 ns"),
        (LineSettings(BIT_NS, PERIOD_NS, 0, 2, 8), "a message of 17 bytes takes 9 periods"),
        (LineSettings(BIT_NS, PERIOD_NS, dwell_periods=4), "the switch stays on a side for 4"),
        (LineSettings(BIT_NS, 2_000_000_000), "a control period may be 1000000000 ns, not 2000000000"),
    ],
)
def test_lines_over_which_no_message_would_ever_come_are_refused(
    settings: LineSettings, problem: str
) -> None:
    with pytest.raises(FirmwareError, match=problem):
        Pair(settings, TWO_SPEEDS)
