"""Frames, and the MessagePack envelope that carries them: bounded, typed, versioned.

What a key promises is checked field by field: every payload becomes values or a ``WireError``, whoever
wrote it. The layout of each payload belongs to the two wire forms (``bus.forms``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, cast, final

import msgpack  # pyright: ignore[reportMissingTypeStubs]
import numpy as np
from numpy.typing import NDArray

from bus.errors import WireError

VERSION: Final = 1
"""Version of every payload; another is refused."""
TICK_LIMIT: Final = 2**62
_ENVELOPE: Final = 64
"""Bytes that the version, the tick and the names around the values may take."""
TEXT_LIMIT: Final = 4096
"""Longest text in a control record or report, characters."""
_MESSAGE_LIMIT: Final = 4096
_MESSAGE_FIELDS: Final = 64

_packb = cast("Callable[[object], bytes]", cast("Any", msgpack).packb)
_unpackb = cast("Callable[[bytes], object]", cast("Any", msgpack).unpackb)

Values = NDArray[np.float64]
Mask = NDArray[np.bool_]
Message = NDArray[np.void]


@final
@dataclass(frozen=True, slots=True, eq=False)
class SenseFrame:
    """What the cells sense as a tick begins: presence ``(n, sensors)``, encoder travel ``(n, 2)`` m or None."""

    tick: int
    presence: Mask
    encoder_m: Values | None


@final
@dataclass(frozen=True, slots=True, eq=False)
class DriveFrame:
    """What the wheels are to do during a tick: ``(n, 2)`` float64, m/s or volts."""

    tick: int
    drive: Values


@final
@dataclass(frozen=True, slots=True, eq=False)
class LinkFrame:
    """What links carried in a tick: ``sent`` ``(m,)`` says which; ``message`` ``(m,)`` is zero elsewhere."""

    tick: int
    sent: Mask
    message: Message


@final
@dataclass(frozen=True, slots=True)
class Control:
    """The plant's word to all: ``cells`` are ``(row, column)``."""

    kind: Literal["start", "lost", "stop"]
    tick: int
    cells: tuple[tuple[int, int], ...] = ()
    detail: str = ""


@final
@dataclass(frozen=True, slots=True)
class Report:
    """A shard's word to the plant: cells that ``failed``, or its final ``counts``."""

    kind: Literal["failed", "counts"]
    tick: int
    cells: tuple[tuple[int, int], ...] = ()
    detail: str = ""
    counts: tuple[int, int, int, int] = (0, 0, 0, 0)
    """Payloads sent, delivered, lost, late."""


def check_message(dtype: np.dtype[Any]) -> np.dtype[np.void]:
    """A protocol's message type as it goes over the wire: packed, little-endian.

    Args:
        dtype: Structured, of plain booleans, integers and floats.

    Raises:
        WireError: Not structured, nested, an array or object field, too large, or a reserved field name.
    """
    if dtype.names is None or not dtype.names or len(dtype.names) > _MESSAGE_FIELDS:
        raise WireError("message", "type", f"{dtype}: must be structured, of 1 to {_MESSAGE_FIELDS} fields")
    fields: list[tuple[str, np.dtype[Any]]] = []
    for name in dtype.names:
        field = dtype[name]
        if name in ("v", "tick") or not name.isidentifier():
            raise WireError("message", "type", f"field {name!r}: must be an identifier other than v and tick")
        if field.kind not in "biuf" or field.shape or field.itemsize > 8:
            raise WireError(
                "message", "type", f"field {name!r} is {field}: must be bool, int or float up to 64 bits"
            )
        fields.append((name, field.newbyteorder("<")))
    packed = np.dtype(fields)
    if packed.itemsize > _MESSAGE_LIMIT:
        raise WireError("message", "type", f"{packed.itemsize} bytes: must be at most {_MESSAGE_LIMIT}")
    return packed


def pack(tick: int, fields: Mapping[str, object]) -> bytes:
    """One payload: a map of the version, the tick and ``fields``."""
    return _packb({"v": VERSION, "tick": tick, **fields})


def layout(*names: str) -> frozenset[str]:
    """A payload's fields, for ``unpack``: ``names`` and those that every payload has."""
    return frozenset(("v", "tick", *names))


def unpack(kind: str, payload: bytes, limit: int, *names: frozenset[str]) -> tuple[int, dict[str, Any]]:
    """The tick and fields of a payload.

    Args:
        kind: What it is, for the error.
        payload: Any bytes at all.
        limit: Bytes that the values may take; the envelope comes on top.
        names: The sets of fields allowed (``layout``); one of them must be there, no more and no less.

    Raises:
        WireError: Too long, not MessagePack, not such a map, another version, or no sensible tick.
    """
    if len(payload) > limit + _ENVELOPE:
        raise WireError(kind, "length", f"{len(payload)} bytes: must be at most {limit + _ENVELOPE}")
    try:
        found = _unpackb(payload)
    except (ValueError, TypeError, OverflowError, msgpack.UnpackException) as error:
        raise WireError(kind, "encoding", f"not MessagePack: {type(error).__name__}") from None
    if type(found) is not dict:
        raise WireError(kind, "type", f"a {type(found).__name__}: must be a map")
    fields = cast("dict[Any, Any]", found)
    if fields.get("v") != VERSION:
        raise WireError(kind, "version", f"must be {VERSION}")
    if fields.keys() not in names:
        allowed = " or ".join(", ".join(sorted(chosen)) for chosen in names)
        raise WireError(kind, "fields", f"must be {allowed}")
    tick = fields["tick"]
    if type(tick) is not int or not 0 <= tick < TICK_LIMIT:
        raise WireError(kind, "tick", f"must be an integer in 0..{TICK_LIMIT - 1}")
    return tick, fields


def bits(kind: str, value: object, count: int) -> Mask:
    """``count`` booleans from the bytes that ``bits_bytes`` made.

    Raises:
        WireError: Not that many bytes, or a bit set beyond the last.
    """
    data = binary(kind, value, (count + 7) // 8)
    out = np.unpackbits(np.frombuffer(data, dtype=np.uint8), bitorder="little")
    if out[count:].any():
        raise WireError(kind, "bits", f"bits are set beyond the last of {count}")
    return out[:count].view(np.bool_)


def bits_bytes(mask: Mask) -> bytes:
    """Booleans, eight a byte, the first in the lowest bit."""
    return np.packbits(mask, axis=None, bitorder="little").tobytes()


def floats(kind: str, value: object, rows: int) -> Values:
    """``(rows, 2)`` finite little-endian float64.

    Raises:
        WireError: Another length, or a value that is not finite.
    """
    out = np.frombuffer(binary(kind, value, rows * 16), dtype="<f8").reshape(rows, 2)
    if not np.isfinite(out).all():
        raise WireError(kind, "finite", "every value must be finite")
    return out


def nothing(kind: str, name: str, value: object) -> None:
    """Checks that there is no value.

    Raises:
        WireError: There is one.
    """
    if value is not None:
        raise WireError(kind, "type", f"{name} must be nil: this run has none")


def pair(kind: str, value: object) -> tuple[float, float]:
    """Two finite numbers from a list of two.

    Raises:
        WireError: Not a list of two finite numbers.
    """
    if type(value) is not list or len(cast("list[object]", value)) != 2:
        raise WireError(kind, "type", "must be a list of two numbers")
    first, second = cast("list[Any]", value)
    if type(first) not in (float, int) or type(second) not in (float, int):
        raise WireError(kind, "type", "must be a list of two numbers")
    a, b = float(first), float(second)
    # Only a finite number minus itself is zero.
    if a - a != 0.0 or b - b != 0.0:
        raise WireError(kind, "finite", "every value must be finite")
    return a, b


def booleans(kind: str, value: object, count: int) -> list[bool]:
    """A list of ``count`` booleans.

    Raises:
        WireError: Something else.
    """
    if type(value) is list:
        items = cast("list[object]", value)
        if len(items) == count and all(type(item) is bool for item in items):
            return cast("list[bool]", items)
    raise WireError(kind, "type", f"must be a list of {count} booleans")


def binary(kind: str, value: object, length: int) -> bytes:
    """``length`` bytes.

    Raises:
        WireError: Something else.
    """
    if type(value) is not bytes or len(value) != length:
        raise WireError(kind, "size", f"must be {length} bytes")
    return value


def messages(kind: str, value: object, count: int, dtype: np.dtype[np.void]) -> Message:
    """``(count,)`` messages of a protocol from their packed bytes; a copy, which may be written.

    Raises:
        WireError: Another length.
    """
    return np.frombuffer(binary(kind, value, count * dtype.itemsize), dtype=dtype).copy()


def scalar_reader(kind: str, name: str, dtype: np.dtype[Any]) -> Callable[[object], Any]:
    """What reads one field of a message: a function from any value to the Python value that its type holds.

    The function raises WireError for a value of another type or out of range.
    """

    def read_bool(value: object) -> bool:
        if type(value) is not bool:
            raise WireError(kind, "type", f"{name} must be a boolean")
        return value

    def read_int(value: object) -> int:
        if type(value) is not int:
            raise WireError(kind, "type", f"{name} must be an integer")
        if not lowest <= value <= highest:
            raise WireError(kind, "range", f"{name} must be in {lowest}..{highest}")
        return value

    def read_float(value: object) -> float:
        if type(value) is not float and type(value) is not int:
            raise WireError(kind, "type", f"{name} must be a number")
        number = float(cast("float", value))
        # Infinities and NaN are a protocol's own affair; a finite value must not become one by rounding.
        if highest < abs(number) < np.inf:
            raise WireError(kind, "range", f"{name} does not fit {dtype}")
        return number

    if dtype.kind == "b":
        return read_bool
    if dtype.kind == "f":
        highest = float(np.finfo(dtype).max)
        return read_float
    lowest, highest = int(np.iinfo(dtype).min), int(np.iinfo(dtype).max)
    return read_int


def encode_control(control: Control) -> bytes:
    """The payload of a control record."""
    return pack(
        control.tick, {"kind": control.kind, "cells": control.cells, "detail": control.detail[:TEXT_LIMIT]}
    )


_CONTROL: Final = layout("kind", "cells", "detail")
_REPORT: Final = layout("kind", "cells", "detail", "counts")


def decode_control(payload: bytes, cells: int) -> Control:
    """A control record that names at most ``cells`` cells.

    Raises:
        WireError: Anything else.
    """
    tick, fields = unpack("control", payload, _text_limit(cells), _CONTROL)
    kind = fields["kind"]
    if kind not in ("start", "lost", "stop"):
        raise WireError("control", "kind", "must be start, lost or stop")
    return Control(kind, tick, _places("control", fields["cells"], cells), _text("control", fields["detail"]))


def encode_report(report: Report) -> bytes:
    """The payload of a report."""
    return pack(
        report.tick,
        {
            "kind": report.kind,
            "cells": report.cells,
            "detail": report.detail[:TEXT_LIMIT],
            "counts": report.counts,
        },
    )


def decode_report(payload: bytes, cells: int) -> Report:
    """A report that names at most ``cells`` cells.

    Raises:
        WireError: Anything else.
    """
    tick, fields = unpack("report", payload, _text_limit(cells), _REPORT)
    kind = fields["kind"]
    if kind not in ("failed", "counts"):
        raise WireError("report", "kind", "must be failed or counts")
    counts = fields["counts"]
    if (
        type(counts) is not list
        or len(cast("list[object]", counts)) != 4
        or not all(type(c) is int and 0 <= c < TICK_LIMIT for c in cast("list[object]", counts))
    ):
        raise WireError("report", "type", "counts must be four integers")
    a, b, c, d = cast("list[int]", counts)
    places = _places("report", fields["cells"], cells)
    return Report(kind, tick, places, _text("report", fields["detail"]), (a, b, c, d))


def _text_limit(cells: int) -> int:
    return 4 * TEXT_LIMIT + 11 * cells + 128


def _text(kind: str, value: object) -> str:
    if type(value) is not str or len(value) > TEXT_LIMIT:
        raise WireError(kind, "type", f"detail must be text of at most {TEXT_LIMIT} characters")
    return value


def _places(kind: str, value: object, most: int) -> tuple[tuple[int, int], ...]:
    if type(value) is not list or len(cast("list[object]", value)) > most:
        raise WireError(kind, "type", f"cells must be a list of at most {most} pairs")
    return tuple(_place(kind, item) for item in cast("Iterable[object]", value))


def _place(kind: str, value: object) -> tuple[int, int]:
    if type(value) is list and len(cast("list[object]", value)) == 2:
        row, column = cast("list[object]", value)
        if type(row) is int and type(column) is int:
            return row, column
    raise WireError(kind, "type", "a cell must be a list of its row and column")
