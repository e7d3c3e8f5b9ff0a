"""Payloads of binary fields: the bytes of a MessagePack packer, and none accepted that its unpacker reads otherwise."""

from __future__ import annotations

from typing import Any, cast

import msgpack  # pyright: ignore[reportMissingTypeStubs]
import pytest

from bus.wire.msgpack_codec import TICK_LIMIT, VERSION
from bus.wire.packed import FEW, BinaryLayout

SIZES = {"presence": 3, "encoder_m": None, "drive": FEW}
PARTS = (b"abc", bytes(range(256)) * (FEW // 256))
TICKS = (0, 127, 128, 65_535, 65_536, 2**32, TICK_LIMIT - 1)


def _packed(tick: object, **changed: object) -> bytes:
    fields = {
        "v": VERSION,
        "tick": tick,
        "presence": PARTS[0],
        "encoder_m": None,
        "drive": PARTS[1],
        **changed,
    }
    return cast("Any", msgpack).packb(fields)


@pytest.mark.parametrize("tick", TICKS)
def test_bytes_are_a_packers(tick: int) -> None:
    layout = BinaryLayout(SIZES)
    assert (
        layout.write(tick, PARTS) == layout.write(tick, [memoryview(part) for part in PARTS]) == _packed(tick)
    )


@pytest.mark.parametrize("tick", TICKS)
def test_what_was_written_is_read(tick: int) -> None:
    found = BinaryLayout(SIZES).read(_packed(tick))
    assert found is not None
    assert found[0] == tick
    assert tuple(map(bytes, found[1])) == PARTS


def test_further_fields_can_be_appended() -> None:
    payload = (
        BinaryLayout(SIZES, open_map=1).write(5, PARTS) + cast("Any", msgpack).packb({"picture": None})[1:]
    )
    assert payload == _packed(5, picture=None)


@pytest.mark.parametrize(
    "payload",
    [
        _packed(TICK_LIMIT),
        _packed(-1),
        _packed(1.5),
        _packed(True),
        _packed(7, v=VERSION + 1),
        _packed(7, presence=b"abcd"),
        _packed(7, encoder_m=False),
        _packed(7, drive=PARTS[1] + b"x"),
        _packed(7)[:-1],
        _packed(7) + b"\xc0",
        _packed(7).replace(b"drive", b"drove"),
        bytes(len(_packed(7))),
    ],
)
def test_anything_else_is_left_to_the_unpacker(payload: bytes) -> None:
    assert BinaryLayout(SIZES).read(payload) is None


def test_small_payloads_are_left_to_the_unpacker() -> None:
    layout = BinaryLayout({"drive": 16})
    assert layout.read(layout.write(1, [bytes(16)])) is None
