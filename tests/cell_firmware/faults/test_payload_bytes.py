"""Messages as bytes on the wire: whole, or as runs on serial lines."""

from __future__ import annotations

import numpy as np

from cell_firmware.effects.serial.bursts import BurstType
from cell_firmware.faults.payload_bytes import MessageBytes, PayloadView, SerialBytes

SAID = np.dtype([("real", "<f8"), ("flag", "?")])


def test_what_a_link_carries_says_how_its_bytes_are_read() -> None:
    stamped = np.dtype([*((name, SAID[name]) for name in ("real", "flag")), ("stamp", "<i8")])
    whole, bursts = PayloadView.of(stamped, SAID), PayloadView.of(BurstType(12).wire, SAID)
    assert isinstance(whole, MessageBytes)
    assert whole.width == 9, "a stamp is no byte of what is said"
    assert isinstance(bursts, SerialBytes)
    assert bursts.width == 16


def test_the_bytes_of_both_runs_are_read_and_written_and_nothing_else_changes() -> None:
    burst = BurstType(8)
    bursts = SerialBytes(burst)
    messages = np.zeros(2, dtype=burst.wire)
    messages["bytes_1"], messages["bytes_2"] = [2, 6], [3, 6]
    messages["start_2_ns"], messages["word_0"] = 77, 0x0807060504030201
    before = messages.copy()
    data, count = bursts.read(messages)
    assert (data.tolist(), count.tolist()) == ([list(range(1, 9))] * 2, [5, 8])
    data[:] = 9
    after = bursts.write(messages, data)
    assert after["word_0"].tolist() == [0x0909090909090909] * 2
    assert np.array_equal(messages, before)
    assert all(np.array_equal(after[name], before[name]) for name in ("bytes_1", "bytes_2", "start_2_ns"))


def test_whole_messages_are_written_over_copies() -> None:
    whole, messages = MessageBytes(SAID), np.zeros(1, dtype=SAID)
    data, count = whole.read(messages)
    assert count.tolist() == [9]
    data[0, 8] = 7
    assert whole.write(messages, data)["flag"].tolist() == [True]
    assert messages["flag"].tolist() == [False]
