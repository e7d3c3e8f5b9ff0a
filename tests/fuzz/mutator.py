"""Spoils valid payloads, the same way for the same seed: bytes, lengths, and what is inside the envelope."""

from __future__ import annotations

import copy
import json
import random
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple, final

import msgpack

_MARKS: Final = bytes(
    [0x00, 0x7F, 0x80, 0x81, 0x8F, 0x90, 0x91, 0x9F, 0xA0, 0xA1, 0xBF, *range(0xC0, 0xE1), 0xFF]
)
"""What MessagePack puts before values of each type."""
_LENGTHS: Final = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFF_FFFF, 0xFFFF_FFFF)
_NUMBERS: Final = (
    -1, 0, 1, 2, 63, 64, 127, 128, 255, 256, 2**31, 2**32, 2**53 + 1, 2**62 - 1, 2**62, 2**63 - 1, 2**63,
    2**64 - 1, -(2**63), 0.0, -0.0, 1.0, 0.5, 1e308, -1e-320, float("inf"), float("-inf"), float("nan"),
)  # fmt: skip
_MOST_EDITS: Final = 4


class Form(NamedTuple):
    """What payloads are written in."""

    unpack: Callable[[bytes], Any]
    pack: Callable[[Any], bytes]


def _json(value: Any) -> bytes:
    return json.dumps(value, default=repr, skipkeys=True).encode()


MESSAGEPACK: Final = Form(msgpack.unpackb, msgpack.packb)
JSON: Final = Form(json.loads, _json)


def _deep(levels: int) -> Any:
    nested: Any = []
    for _ in range(levels):
        nested = [nested]
    return nested


_OTHERS: Final[tuple[Any, ...]] = (
    None, True, False, "", "v", "tick", "é" * 40, "\x00", "\x1b[2J", "\u202e", "x" * 5000, b"", b"\x00", b"\xff" * 16,
    bytes(4096), [], [[]], [0] * 300, [[0, 0]] * 300, _deep(60), {}, {"v": 1}, {b"v": 1}, [None, None], [[0, 0], [0]],
    msgpack.ExtType(1, b""), msgpack.ExtType(99, b"12345678"), msgpack.Timestamp(0), msgpack.Timestamp(2**40, 1),
    float("nan"), [float("nan"), 0.0], [1, 2.0], ["<f8", [], b""], ["<f8", [2**62], b""], ["|O", [], b""],
)  # fmt: skip


@final
class Mutator:
    """Makes spoilt payloads without end.

    Args:
        frames: Valid payloads.
        purpose: What for, and the seed: the same words, the same payloads.
        form: What they are written in, so that what is in them is spoilt too; None: they are bytes.
    """

    def __init__(self, frames: Sequence[bytes], purpose: str, form: Form | None = MESSAGEPACK) -> None:
        self._frames = frames
        self._inside = [None if form is None else form.unpack(frame) for frame in frames]
        self._pack = MESSAGEPACK.pack if form is None else form.pack
        self._draw = random.Random(purpose)
        self._edits: tuple[Callable[[bytearray], None], ...] = (
            self._flip, self._mark, self._anything, self._insert, self._remove, self._repeat, self._cut, self._splice,
            self._length, self._zeros,
        )  # fmt: skip

    def next(self) -> bytes:
        """One of them."""
        draw = self._draw
        i = draw.randrange(len(self._frames))
        inside = self._inside[i]
        if inside is not None and draw.random() < 0.75:
            found = self._spoilt_inside(inside)
            if draw.random() < 0.8:
                return found
        else:
            found = self._frames[i]
        data = bytearray(found)
        for _ in range(draw.randint(1, _MOST_EDITS)):
            draw.choice(self._edits)(data)
        return bytes(data)

    # --- bytes ------------------------------------------------------------------------------------

    def _place(self, data: bytearray) -> int:
        return self._draw.randrange(len(data) + 1)

    def _flip(self, data: bytearray) -> None:
        if data:
            data[self._draw.randrange(len(data))] ^= 1 << self._draw.randrange(8)

    def _mark(self, data: bytearray) -> None:
        if data:
            data[self._draw.randrange(len(data))] = self._draw.choice(_MARKS)

    def _anything(self, data: bytearray) -> None:
        if data:
            data[self._draw.randrange(len(data))] = self._draw.randrange(256)

    def _insert(self, data: bytearray) -> None:
        at = self._place(data)
        data[at:at] = self._draw.randbytes(self._draw.randint(1, 9))

    def _remove(self, data: bytearray) -> None:
        at = self._place(data)
        del data[at : at + self._draw.randint(1, 9)]

    def _repeat(self, data: bytearray) -> None:
        at = self._place(data)
        piece = data[at : at + self._draw.randint(1, 12)]
        data[at:at] = piece * self._draw.choice((1, 2, 30))

    def _cut(self, data: bytearray) -> None:
        del data[self._place(data) :]

    def _splice(self, data: bytearray) -> None:
        other = self._draw.choice(self._frames)
        data[self._place(data) :] = other[self._draw.randrange(len(other) + 1) :]

    def _length(self, data: bytearray) -> None:
        at, size = self._place(data), self._draw.choice((1, 2, 4, 8))
        value = self._draw.choice(_LENGTHS) & (1 << 8 * size) - 1
        data[at : at + size] = value.to_bytes(size, self._draw.choice(("big", "little")))

    def _zeros(self, data: bytearray) -> None:
        at = self._place(data)
        size = self._draw.randint(1, 16)
        data[at : at + size] = bytes(size)

    # --- what is inside ---------------------------------------------------------------------------

    def _spoilt_inside(self, fields: dict[Any, Any]) -> bytes:
        fields = copy.deepcopy(fields)
        for _ in range(self._draw.randint(1, 2)):
            self._spoil(fields)
        return self._pack(fields)

    def _spoil(self, fields: dict[Any, Any]) -> None:
        """Changes, takes away or adds one value, somewhere."""
        draw = self._draw
        node: Any = fields
        while True:
            keys = list(node) if isinstance(node, dict) else list(range(len(node)))
            if not keys or draw.random() < 0.05:
                _add(node, copy.deepcopy(draw.choice(_OTHERS)))
                return
            key = draw.choice(keys)
            if not isinstance(node[key], dict | list) or draw.random() < 0.3:
                break
            node = node[key]
        if draw.random() < 0.1:
            del node[key]
        else:
            node[key] = self._odd(node[key])

    def _odd(self, value: Any) -> Any:
        """Something else in a value's place, often of its own type."""
        draw = self._draw
        if isinstance(value, bytes) and draw.random() < 0.7:
            data = bytearray(value)
            draw.choice(self._edits)(data)
            return bytes(data)
        if type(value) in (int, float) and draw.random() < 0.7:
            return draw.choice(_NUMBERS)
        return copy.deepcopy(draw.choice(_OTHERS))


def _add(node: Any, value: Any) -> None:
    if isinstance(node, list):
        node.append(value)
    else:
        node[f"more{len(node)}"] = value
