"""Codec of payloads with a fixed layout: one call encodes or decodes a whole payload.

MessagePack lets the writer choose the width of a number. With the full width of its type, whatever the value, every
number has a fixed position, and the struct module reads and writes it there. Payloads with narrower numbers are valid
too, and are decoded by ``bus.wire.msgpack_codec.reader``.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import accumulate
from typing import Any, Final, cast, final

import msgpack  # pyright: ignore[reportMissingTypeStubs]

from bus.wire.msgpack_codec import TICK_LIMIT, VERSION

_MARKS: Final = {
    "d": b"\xcb", "f": b"\xca", "B": b"\xcc", "H": b"\xcd", "I": b"\xce", "Q": b"\xcf",
    "b": b"\xd0", "h": b"\xd1", "i": b"\xd2", "q": b"\xd3",
}  # fmt: skip
"""MessagePack's prefix of a number, by the struct module's letter for its type."""
_TO_WIRE: Final = bytes.maketrans(b"\x00\x01", b"\xc2\xc3")
_FROM_WIRE: Final = bytes({0xC2: 0, 0xC3: 1}.get(byte, 2) for byte in range(256))


@final
@dataclass(frozen=True, slots=True)
class Binary:
    """Layout of a field of ``size`` bytes."""

    size: int


FieldLayout = str | tuple[str, ...] | int | Binary | None
"""Layout of a field: a number, a list of numbers, a list of so many booleans, bytes, or nil; ``"?"``: a boolean."""


@final
@dataclass(frozen=True, slots=True)
class PayloadLayout:
    """Positions of the values in one kind of payload.

    Attributes:
        constant: The payload with zeros in the place of values.
        places: For ``tick`` and each field, in order, its first byte and number of bytes. The tick's highest byte is
            the first.
        bits: Number of booleans of each field that has eight in a byte, the first in the lowest bit.
        end_tick: First tick whose payloads have another layout.
    """

    constant: bytes
    places: Mapping[str, tuple[int, int]]
    bits: Mapping[str, int] = field(default_factory=dict[str, int])
    end_tick: int = TICK_LIMIT


Layouts = Callable[[int], tuple[PayloadLayout, PayloadLayout] | None]
"""From a tick to the layouts of a side's only incoming payload and of its only outgoing one; None: there are others."""

Decode = Callable[[int, bytes], tuple[int, Any]]
"""From the part of a frame and any payload to its tick and value, or WireError."""


def decode_booleans(marks: bytes) -> bytes | None:
    """Booleans, a byte each, 0 or 1, from what MessagePack has for them; None where it is something else."""
    found = marks.translate(_FROM_WIRE)
    return None if 2 in found else found


@final
class FixedLayoutCodec:
    """One kind of payload; writes for one thread at a time.

    Args:
        places: Layout of each field, after ``v`` and ``tick``.
    """

    def __init__(self, places: Mapping[str, FieldLayout]) -> None:
        between, values, self._booleans = _layout(places)
        self._values = values
        words = [f"{len(text)}s{value}" for text, value in zip(between, [*values, ""], strict=True)]
        self._layout = struct.Struct(">" + "".join(words))
        self._sizes = [struct.calcsize(">" + value) for value in values]
        self._between = tuple(between)
        self._names = ["tick", *(name for name, place in places.items() if place is not None)]
        self._parts: list[Any] = [b""] * (2 * len(values) + 1)
        self._parts[::2] = between

    def blank(self) -> bytes:
        """Return a payload of tick 0 whose fields are zero; all of them must be binary."""
        sizes = [at.stop - at.start for at in self.spans()[1:]]
        return self.write(0, [[bytes(size) for size in sizes]])[0]

    def spans(self) -> list[slice]:
        """Return the place of each value in a payload: the tick's, and those of the fields, which must be binary."""
        ends = accumulate(map(len, self._between[:-1]))
        spans, values = list[slice](), 0
        for end, size in zip(ends, self._sizes, strict=True):
            spans.append(slice(end + values, end + values + size))
            values += size
        return spans

    def write(self, tick: int, rows: Iterable[Iterable[Any]]) -> list[bytes]:
        """A payload a row of values, in their places' order; booleans are bytes, one each, 0 or 1."""
        parts, pack = self._parts, self._layout.pack
        parts[1] = tick
        payloads: list[bytes] = []
        for row in rows:
            parts[3::2] = row
            for i in self._booleans:
                parts[i] = parts[i].translate(_TO_WIRE)
            payloads.append(pack(*parts))
        return payloads

    def layout(self) -> PayloadLayout:
        """Positions of the values; of payloads all of whose fields are ``Binary`` or nil."""
        at, constant, places = 0, b"", dict[str, tuple[int, int]]()
        sizes = [struct.calcsize(f">{value}") for value in self._values]
        for text, name, size in zip(self._between, [*self._names, ""], [*sizes, 0], strict=True):
            constant += text + bytes(size)
            at += len(text)
            if name:
                places[name] = (at, size)
            at += size
        return PayloadLayout(constant, places)

    def decoder(self, make: Callable[..., Any], other: Decode) -> Decode:
        """Return a decoder of payloads in this layout.

        Args:
            make: Converts the values to the decoded object, or None for invalid values; booleans are decoded by
                ``decode_booleans``.
            other: Decodes all other payloads, and raises errors.
        """
        size, between, unpack = self._layout.size, self._between, self._layout.unpack

        def decode(part: int, payload: bytes) -> tuple[int, Any]:
            if len(payload) == size:
                parts = unpack(payload)
                if parts[::2] == between and parts[1] < TICK_LIMIT:
                    value = make(*parts[3::2])
                    if value is not None:
                        return parts[1], value
            return other(part, payload)

        return decode


def _layout(places: Mapping[str, FieldLayout]) -> tuple[list[bytes], list[str], list[int]]:
    """Return the constant bytes around the values, the values' types, and the positions of booleans among both."""
    packer = cast("Any", msgpack).Packer()
    between, values, booleans = [b""], list[str](), list[int]()

    def text(more: bytes) -> None:
        between[-1] += more

    def value(letter: str) -> None:
        text(_MARKS.get(letter, b""))
        values.append(letter)
        between.append(b"")

    def booleans_of(count: int) -> None:
        booleans.append(2 * len(values) + 1)
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
            booleans_of(1)
        elif isinstance(place, Binary):
            text(packer.pack(bytes(place.size)).removesuffix(bytes(place.size)))
            value(f"{place.size}s")
        elif isinstance(place, int):
            text(packer.pack_array_header(place))
            booleans_of(place)
        elif isinstance(place, str):
            value(place)
        else:
            text(packer.pack_array_header(len(place)))
            for letter in place:
                value(letter)
    return between, values, booleans
