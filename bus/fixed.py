"""Payloads that are the same bytes every tick but for the values: one call writes or reads the whole.

MessagePack lets the writer choose how wide a number is. Written always as wide as its type, whatever its value,
numbers stand always in the same places, and the struct module puts them there. What others write narrower is as
good, but for ``bus.codec.reader`` to read.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any, Final, cast, final

import msgpack  # pyright: ignore[reportMissingTypeStubs]

from bus.codec import TICK_LIMIT, VERSION

_MARKS: Final = {
    "d": b"\xcb", "f": b"\xca", "B": b"\xcc", "H": b"\xcd", "I": b"\xce", "Q": b"\xcf",
    "b": b"\xd0", "h": b"\xd1", "i": b"\xd2", "q": b"\xd3",
}  # fmt: skip
"""What MessagePack puts before a number, by its type in the struct module's words."""
_TO_WIRE: Final = bytes.maketrans(b"\x00\x01", b"\xc2\xc3")
_FROM_WIRE: Final = bytes({0xC2: 0, 0xC3: 1}.get(byte, 2) for byte in range(256))

Place = str | tuple[str, ...] | int | None
"""What stands under a name: a number, a list of numbers, a list of so many booleans, or nil; ``"?"``: a boolean."""


@final
class Fixed:
    """One kind of payload; writes for one thread at a time.

    Args:
        places: What stands under each name, after ``v`` and ``tick``.
    """

    def __init__(self, places: Mapping[str, Place]) -> None:
        between, values, booleans = _layout(places)
        words = [f"{len(text)}s{value}" for text, value in zip(between, [*values, ""], strict=True)]
        layout = struct.Struct(">" + "".join(words))
        self._between = tuple(between)
        self._booleans = booleans
        self._size = layout.size
        self._pack, self._unpack = layout.pack, layout.unpack
        self._parts: list[Any] = [b""] * (2 * len(values) + 1)
        self._parts[::2] = between

    def write(self, *values: Any) -> bytes:
        """The payload; ``values``: the tick, then all others in order, of booleans a byte each, 0 or 1."""
        parts = self._parts
        parts[1::2] = values
        for i in self._booleans:
            parts[2 * i + 1] = parts[2 * i + 1].translate(_TO_WIRE)
        return self._pack(*parts)

    def read(self, payload: bytes) -> Sequence[Any] | None:
        """The values, as ``write`` takes them; None where the payload is not laid out like this."""
        if len(payload) != self._size:
            return None
        parts = self._unpack(payload)
        if parts[::2] != self._between or parts[1] >= TICK_LIMIT:
            return None
        values = parts[1::2]
        if self._booleans:
            values = list(values)
            for i in self._booleans:
                values[i] = values[i].translate(_FROM_WIRE)
                if 2 in values[i]:
                    return None
        return values


def _layout(places: Mapping[str, Place]) -> tuple[list[bytes], list[str], list[int]]:
    """The bytes before, between and after the values; the values' types; which of them are booleans."""
    packer = cast("Any", msgpack).Packer()
    between, values, booleans = [b""], list[str](), list[int]()

    def text(more: bytes) -> None:
        between[-1] += more

    def value(letter: str) -> None:
        text(_MARKS.get(letter, b""))
        values.append(letter)
        between.append(b"")

    def flags(count: int) -> None:
        booleans.append(len(values))
        value(f"{count}s")

    text(
        packer.pack_map_header(2 + len(places))
        + packer.pack("v")
        + packer.pack(VERSION)
        + packer.pack("tick")
    )
    value("Q")
    for name, place in places.items():
        text(packer.pack(name))
        if place is None:
            text(packer.pack(None))
        elif place == "?":
            flags(1)
        elif isinstance(place, int):
            text(packer.pack_array_header(place))
            flags(place)
        elif isinstance(place, str):
            value(place)
        else:
            text(packer.pack_array_header(len(place)))
            for letter in place:
                value(letter)
    return between, values, booleans
