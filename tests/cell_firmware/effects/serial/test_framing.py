"""Messages as bytes."""

from __future__ import annotations

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

from cell_firmware.effects.serial.framing import Frame, bytes_of, check_of

MIXED = np.dtype([("n", ">i2"), ("ok", "?"), ("x", "<f4"), ("big", "<u8")], align=True)


def long_division(data: bytes) -> int:
    """The remainder by x^8 + x^2 + x + 1 of eight zeros behind the data, whose first eight bits are inverted."""
    rest = int.from_bytes(data, "big") << 8 ^ 0xFF << 8 * len(data)
    for place in reversed(range(8 * len(data))):
        if rest >> (place + 8) & 1:
            rest ^= 0b1_0000_0111 << place
    return rest


@given(st.binary(min_size=1, max_size=40))
def test_the_check_byte_is_the_remainder_of_a_long_division(data: bytes) -> None:
    assert check_of(np.frombuffer(data, np.uint8)[None])[0] == long_division(data)


def test_a_message_takes_its_fields_packed_little_endian_and_a_check_byte() -> None:
    assert bytes_of(MIXED) == 2 + 1 + 4 + 8 + 1
    message = np.array([[(-2, True, 0.5, 7)]], dtype=MIXED)
    packed = Frame(MIXED).pack(message)
    assert packed.shape == (1, 1, 15)
    assert packed.tobytes() == b"\xfe\xff\x01" + b"\x00\x00\x00\x3f" + b"\x07" + bytes(7)


@given(
    st.integers(-(2**15), 2**15 - 1),
    st.booleans(),
    st.floats(width=32, allow_nan=False, allow_infinity=False),
)
def test_what_was_packed_is_unpacked(n: int, ok: bool, x: float) -> None:
    frame, message = Frame(MIXED), np.array([(n, ok, x, 3)], dtype=MIXED)
    data = frame.pack(message)
    good, again = frame.unpack(np.concatenate((data, check_of(data)[:, None]), axis=1))
    assert good.all()
    assert again.dtype == MIXED
    assert again.tolist() == message.tolist()


@given(st.binary(min_size=8, max_size=8), st.integers(0, 8 * 8), st.integers(1, 255))
def test_errors_within_eight_bits_in_a_row_are_always_found(data: bytes, place: int, bits: int) -> None:
    frame = Frame(np.dtype([("a", "<u8")]))
    sent = data + bytes([long_division(data)])
    spoilt = (int.from_bytes(sent, "big") ^ bits << place).to_bytes(10, "big")[1:]
    assume(spoilt != sent)
    assert frame.unpack(np.frombuffer(sent, np.uint8)[None])[0].all()
    assert not frame.unpack(np.frombuffer(spoilt, np.uint8)[None])[0].any()


def test_a_line_of_zeros_and_bytes_that_are_no_values_bring_no_message() -> None:
    frame = Frame(np.dtype([("ok", "?"), ("x", "<f8")]))
    for ok, x, good in ((1, 0.5, True), (3, 0.5, False), (1, float("nan"), False), (0, float("inf"), False)):
        data = bytes([ok]) + np.float64(x).tobytes()
        found, _ = frame.unpack(np.frombuffer(data + bytes([long_division(data)]), np.uint8)[None])
        assert found.tolist() == [good]
    assert not frame.unpack(np.zeros((1, 10), dtype=np.uint8))[0].any()
