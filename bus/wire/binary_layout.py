"""Payloads that are maps of binary fields, written with one copy of the fields and read with none.

One thread at a time writes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, cast, final

import msgpack  # pyright: ignore[reportMissingTypeStubs]

from bus.wire.msgpack_codec import TICK_LIMIT, VERSION

FEW: Final = 1 << 15
"""Bytes up to which copying costs less than taking a payload apart here."""
_INTEGER: Final = 9
"""Most bytes of an integer in MessagePack."""
_NOT_MESSAGEPACK: Final = (ValueError, TypeError, OverflowError, msgpack.UnpackException)
_unpackb = cast("Callable[[bytes], object]", cast("Any", msgpack).unpackb)

Part = bytes | memoryview
"""Contents of a field, or something else whose memory is in one piece."""


@final
class BinaryLayout:
    """Payload of one kind with binary fields of fixed sizes after ``v`` and ``tick``.

    The bytes are those that a MessagePack packer makes of the same map. The tick is the only field of variable length.

    Args:
        sizes: Bytes of each field, in order; None: the field is nil.
        open_map: Number of further fields, which the caller appends to what ``write`` returns.
    """

    def __init__(self, sizes: Mapping[str, int | None], open_map: int = 0) -> None:
        packer = cast("Any", msgpack).Packer()
        self._pack = cast("Callable[[object], bytes]", packer.pack)
        self._head = packer.pack_map_header(2 + len(sizes) + open_map) + packer.pack("v")
        self._head += packer.pack(VERSION) + packer.pack("tick")
        # the constant bytes before each field's contents, and after the last
        names = [b""]
        self._sizes = [size for size in sizes.values() if size is not None]
        for name, size in sizes.items():
            names[-1] += packer.pack(name)
            if size is None:
                names[-1] += packer.pack(None)
            else:
                names[-1] += packer.pack(bytes(size)).removesuffix(bytes(size))
                names.append(b"")
        self._names = names
        self._pieces: list[Part] = [self._head, b""]
        for name in names:
            self._pieces += (name, b"")
        self._pieces.pop()
        self._after_tick = sum(map(len, names)) + sum(self._sizes)

    def write(self, tick: int, parts: Sequence[Part]) -> bytes:
        """Return a payload with these contents of the fields that are not nil."""
        pieces = self._pieces
        pieces[1] = self._pack(tick)
        pieces[3::2] = parts
        payload = b"".join(pieces)
        pieces[3::2] = self._names[1:]  # keep no contents
        return payload

    def read(self, payload: bytes) -> tuple[int, list[memoryview]] | None:
        """Return the tick and the contents of the fields that are not nil.

        None where MessagePack's own unpacker should have the payload: it is in another layout, or small.
        """
        if len(payload) <= FEW:
            return None
        head, at = len(self._head), len(payload) - self._after_tick
        if not head < at <= head + _INTEGER or payload[:head] != self._head:
            return None
        try:
            tick = _unpackb(payload[head:at])
        except _NOT_MESSAGEPACK:
            return None
        if type(tick) is not int or not 0 <= tick < TICK_LIMIT:
            return None
        view, parts = memoryview(payload), list[memoryview]()
        for name, size in zip(self._names, [*self._sizes, 0], strict=True):
            begin = at + len(name)
            if payload[at:begin] != name:
                return None
            at = begin + size
            parts.append(view[begin:at])
        return tick, parts[:-1]
