"""The MessagePack envelope of every payload, and readers of what is inside: bounded, typed, versioned.

Every field of a payload is checked: a payload becomes values or a ``WireError``. These functions run for every
payload of every tick, hence the plain code and the few calls into NumPy.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, cast

import msgpack  # pyright: ignore[reportMissingTypeStubs]
import numpy as np
from numpy.typing import NDArray

from bus.errors import WireError
from bus.sensors import CameraFrame, Labels
from bus.wire.message_type import Leaf, bounded_lists, leaves, overlong

VERSION: Final = 2
"""Version of every payload; another is refused."""
TICK_LIMIT: Final = 2**62
NUMBERS: Final[frozenset[type]] = frozenset((int, float))
"""Types that a number in a payload may have."""
_BOOLEANS: Final[frozenset[type]] = frozenset((bool,))
_ENVELOPE: Final = 64
"""Bytes that the version, the tick and the names around the values may take."""
_F8: Final = np.dtype("<f8")
_U1: Final = np.dtype("u1")

_Packer = cast("Callable[[], Any]", cast("Any", msgpack).Packer)
# Says more than is known: the result is checked before it counts as such a map.
_unpackb = cast("Callable[[bytes], dict[str, Any]]", cast("Any", msgpack).unpackb)
_NOT_MESSAGEPACK: Final = (ValueError, TypeError, OverflowError, msgpack.UnpackException)

Values = NDArray[np.float64]
Mask = NDArray[np.bool_]
Message = NDArray[np.void]
Contents = bytes | memoryview
"""Contents of a binary field."""
_CONTENTS: Final[frozenset[type]] = frozenset((bytes, memoryview))
Pack = Callable[[dict[str, object]], bytes]
Read = Callable[[bytes], tuple[int, dict[str, Any]]]


def packer() -> Pack:
    """Return an encoder of payloads: maps that begin with ``v`` and ``tick``; for one thread at a time."""
    # A packer brings a buffer of 256 kB: one for all payloads, not one for each.
    return cast("Pack", _Packer().pack)


def layout(*names: str) -> frozenset[str]:
    """A payload's fields, for ``reader``: ``names`` and those that every payload has."""
    return frozenset(("v", "tick", *names))


def reader(kind: str, limit: int, *layouts: frozenset[str]) -> Read:
    """Return a decoder of payloads of one kind: from any bytes to the tick and the fields.

    The function raises WireError for bytes that are too many, not MessagePack, no such map, of another version,
    or without a sensible tick.

    Args:
        kind: Kind of the payload, for the error.
        limit: Bytes that the values may take; the envelope comes on top.
        layouts: The sets of fields allowed (``layout``): one of them, no more and no less.
    """
    longest = limit + _ENVELOPE

    def read(payload: bytes) -> tuple[int, dict[str, Any]]:
        if len(payload) > longest:
            raise WireError(kind, "length", f"{len(payload)} bytes: must be at most {longest}")
        try:
            fields = _unpackb(payload)
        except _NOT_MESSAGEPACK as error:
            raise WireError(kind, "encoding", f"not MessagePack: {type(error).__name__}") from None
        if type(fields) is dict and fields.get("v") == VERSION and fields.keys() in layouts:
            tick = fields["tick"]
            if type(tick) is int and type(fields["v"]) is int and 0 <= tick < TICK_LIMIT:
                return tick, fields
        raise _wrong(kind, fields, layouts)

    return read


def _wrong(kind: str, found: object, layouts: tuple[frozenset[str], ...]) -> WireError:
    """Return the error that describes an invalid MessagePack payload."""
    if type(found) is not dict:
        return WireError(kind, "type", f"a {type(found).__name__}: must be a map")
    fields = cast("dict[Any, Any]", found)
    version = fields.get("v")
    if type(version) is not int or version != VERSION:
        return WireError(kind, "version", f"must be {VERSION}")
    if fields.keys() not in layouts:
        allowed = " or ".join(", ".join(sorted(names)) for names in layouts)
        return WireError(kind, "fields", f"must be {allowed}")
    return WireError(kind, "tick", f"must be an integer in 0..{TICK_LIMIT - 1}")


def bits(kind: str, value: object, count: int) -> Mask:
    """``count`` booleans from the bytes that ``bits_bytes`` made.

    Raises:
        WireError: Not that many bytes, or a bit set beyond the last.
    """
    data = contents(kind, value, (count + 7) // 8)
    if count % 8 and data[-1] >> count % 8:
        raise WireError(kind, "bits", f"bits are set beyond the last of {count}")
    return np.unpackbits(np.frombuffer(data, _U1), count=count, bitorder="little").view(np.bool_)


def bits_bytes(mask: Mask) -> bytes:
    """Booleans, eight a byte, the first in the lowest bit."""
    return np.packbits(mask, axis=None, bitorder="little").tobytes()


def floats(kind: str, value: object, rows: int) -> Values:
    """``(rows, 2)`` finite little-endian float64, which may be written.

    Raises:
        WireError: Another length, or a value that is not finite.
    """
    found: Values = np.ndarray((rows, 2), _F8, bytearray(contents(kind, value, rows * 16)))
    if not all_finite(found):
        raise WireError(kind, "finite", "every value must be finite")
    return found


def fractions(kind: str, value: object, rows: int, columns: int) -> Values:
    """``(rows, columns)`` little-endian float64 in [0, 1], which may be written.

    Raises:
        WireError: Another length, or a value outside.
    """
    found: Values = np.ndarray((rows, columns), _F8, bytearray(contents(kind, value, rows * columns * 8)))
    if not ((found >= 0.0) & (found <= 1.0)).all():  # which no NaN is
        raise WireError(kind, "range", "every value must be in [0, 1]")
    return found


def fraction_list(kind: str, value: object, count: int) -> list[float]:
    """``count`` numbers in [0, 1] from a list of them.

    Raises:
        WireError: Something else.
    """
    if type(value) is list:
        items = cast("list[Any]", value)
        if len(items) == count and NUMBERS.issuperset(map(type, items)):
            if all(0.0 <= item <= 1.0 for item in items):
                return [float(item) for item in items]
            raise WireError(kind, "range", "every value must be in [0, 1]")
    raise WireError(kind, "type", f"must be a list of {count} numbers")


def all_finite(values: Values) -> bool:
    """Whether no value is infinite or NaN."""
    # Looking for a zero byte costs a third of NumPy's reduction, which matters every tick.
    return 0 not in np.isfinite(values).tobytes()


def expect_nil(kind: str, name: str, value: object) -> None:
    """Check that there is no value.

    Raises:
        WireError: There is one.
    """
    if value is not None:
        raise WireError(kind, "type", f"{name} must be nil: this run has none")


def finite_pair(kind: str, value: object) -> tuple[float, float]:
    """Two finite numbers from a list of two.

    Raises:
        WireError: Not a list of two finite numbers.
    """
    if type(value) is list:
        items = cast("list[Any]", value)
        if len(items) == 2 and NUMBERS.issuperset(map(type, items)):
            first, second = float(items[0]), float(items[1])
            # Only a finite number minus itself is zero.
            if first - first != 0.0 or second - second != 0.0:
                raise WireError(kind, "finite", "every value must be finite")
            return first, second
    raise WireError(kind, "type", "must be a list of two numbers")


def booleans(kind: str, value: object, count: int) -> list[bool]:
    """A list of ``count`` booleans.

    Raises:
        WireError: Something else.
    """
    if type(value) is list:
        items = cast("list[object]", value)
        if len(items) == count and _BOOLEANS.issuperset(map(type, items)):
            return cast("list[bool]", items)
    raise WireError(kind, "type", f"must be a list of {count} booleans")


def contents(kind: str, value: object, length: int) -> Contents:
    """Return ``value``, which must be ``length`` bytes or a view of as many.

    Raises:
        WireError: Something else.
    """
    if type(value) in _CONTENTS and len(cast("Contents", value)) == length:
        return cast("Contents", value)
    raise WireError(kind, "size", f"must be {length} bytes")


def binary(kind: str, value: object, length: int) -> bytes:
    """``length`` bytes.

    Raises:
        WireError: Something else.
    """
    if type(value) is not bytes or len(value) != length:
        raise WireError(kind, "size", f"must be {length} bytes")
    return value


def messages(kind: str, value: object, count: int, dtype: np.dtype[np.void]) -> Message:
    """``(count,)`` messages of a protocol from their packed bytes, which may be written.

    Raises:
        WireError: Another length, a boolean field that is neither 0 nor 1, or a list longer than its bound.
    """
    found = np.frombuffer(bytearray(contents(kind, value, count * dtype.itemsize)), dtype)
    for leaf in leaves(dtype):
        if leaf.type.kind == "b" and (leaf.of(found).view(_U1) > 1).any():
            raise WireError(kind, "type", f"{leaf.name} must be a boolean")
    check_lists(kind, found, dtype)
    return found


def check_lists(kind: str, found: Message, dtype: np.dtype[Any]) -> None:
    """Check that no message has a list longer than its bound.

    Raises:
        WireError: One has.
    """
    if bounded_lists(dtype) and overlong(found, dtype).any():
        raise WireError(kind, "range", "a list must not be longer than its bound")


def leaf_reader(kind: str, leaf: Leaf) -> Callable[[object], list[Any]]:
    """Return a decoder of one message field: from any value to the Python values of its type, one for a single number.

    The function raises WireError for a value of another type, out of range, or that is no list of the vector's length.
    """
    read = scalar_reader(kind, leaf.name, leaf.type, leaf.most)
    if not leaf.shape:
        return lambda value: [read(value)]

    def read_vector(value: object) -> list[Any]:
        if type(value) is not list or len(cast("list[object]", value)) != leaf.size:
            raise WireError(kind, "type", f"{leaf.name} must be a list of {leaf.size}")
        return [read(one) for one in cast("list[object]", value)]

    return read_vector


def scalar_reader(
    kind: str, name: str, dtype: np.dtype[Any], most: int | None = None
) -> Callable[[object], Any]:
    """Return a decoder of one number: from any value to the Python value of its type, at most ``most``.

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
    lowest, highest = int(np.iinfo(dtype).min), int(np.iinfo(dtype).max) if most is None else most
    return read_int


PICTURED_BYTES: Final = 40
"""The most bytes that a parcel takes in a picture."""
_PICTURED: Final = 4
"""Numbers that a picture has of a parcel."""
_U2: Final = np.dtype("<u2")


def label_bytes(label: Labels) -> bytes:
    """Labels, two bytes each."""
    return label.astype(_U2).tobytes()


def labels(kind: str, value: object, rows: int, largest: int) -> Labels:
    """``(rows,)`` labels from the bytes that ``label_bytes`` made, which may be written.

    Raises:
        WireError: Another length, or a label above the largest.
    """
    found = np.frombuffer(contents(kind, value, 2 * rows), _U2).astype(np.int64)
    if (found > largest).any():
        raise WireError(kind, "range", f"label must be in 0..{largest}")
    return found


def label(kind: str, value: object, largest: int) -> int:
    """A label.

    Raises:
        WireError: Something else.
    """
    if type(value) is not int:
        raise WireError(kind, "type", "label must be an integer")
    if not 0 <= value <= largest:
        raise WireError(kind, "range", f"label must be in 0..{largest}")
    return value


def picture_rows(shown: CameraFrame | None) -> list[list[float]] | None:
    """A picture as rows of parcel, x, y and angle; nil for none."""
    if shown is None:
        return None
    return [[parcel, *pose] for parcel, pose in zip(shown.parcel.tolist(), shown.pose.tolist(), strict=True)]


def picture(kind: str, value: object, most: int) -> CameraFrame | None:
    """Decode the camera frame that ``picture_rows`` encoded: parcels in 0..``most`` - 1, ascending, each once.

    Raises:
        WireError: Something else.
    """
    if value is None:
        return None
    if type(value) is not list or len(cast("list[object]", value)) > most:
        raise WireError(kind, "type", f"picture must be nil or a list of at most {most} parcels")
    parcels, poses, last = list[int](), list[list[float]](), -1
    for row in cast("list[Any]", value):
        if type(row) is not list or len(cast("list[Any]", row)) != _PICTURED:
            raise WireError(kind, "type", "a parcel in a picture must be its number, x, y and angle")
        parcel, *pose = cast("list[Any]", row)
        if type(parcel) is not int or not NUMBERS.issuperset(map(type, pose)):
            raise WireError(kind, "type", "a parcel in a picture must be its number, x, y and angle")
        if not last < parcel < most:
            raise WireError(kind, "range", f"parcels in a picture must ascend in 0..{most - 1}")
        parcels.append(parcel)
        poses.append([float(number) for number in pose])
        last = parcel
    found: Values = np.array(poses, dtype=np.float64).reshape(-1, 3)
    if not all_finite(found):
        raise WireError(kind, "finite", "every value must be finite")
    return CameraFrame(np.array(parcels, dtype=np.int64), found)
