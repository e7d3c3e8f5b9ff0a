"""State as bytes: MessagePack, extended by types for values beyond lists and maps.

Only values are read back: no code runs, no name is resolved but those of records that the reader lists.
"""

from __future__ import annotations

from array import array
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from fractions import Fraction
from math import prod
from typing import Any, Final, NamedTuple, cast, final

import msgpack  # pyright: ignore[reportMissingTypeStubs]
import numpy as np
from numpy.typing import NDArray

from bus.errors import StateError

_ARRAY: Final = 1
_SCALAR: Final = 2
_OBJECTS: Final = 3
_TUPLE: Final = 4
_SET: Final = 5
_DEQUE: Final = 6
_COUNTER: Final = 7
_INTEGER: Final = 8
_FRACTION: Final = 9
_NUMBERS: Final = 10
_RECORD: Final = 11
_PART: Final = 12
_STREAM: Final = 13

_KINDS: Final = frozenset("biuf")
"""Of the numbers that arrays may hold."""
_DIMENSIONS: Final = 8
_COLUMNS: Final = 256
"""Most fields of a structured type."""
_DEPTH: Final = 32
"""Of values within values, each of a type that MessagePack has not."""
_DIGITS: Final = 100
"""Longest whole number beyond 64 bits."""

_Codec = Callable[..., Any]
_packb = cast("_Codec", cast("Any", msgpack).packb)
_unpackb = cast("_Codec", cast("Any", msgpack).unpackb)
_ExtType = cast("_Codec", cast("Any", msgpack).ExtType)
DECODE_ERRORS: Final = (
    ValueError, TypeError, LookupError, OverflowError, RecursionError, ArithmeticError, msgpack.UnpackException,
)  # fmt: skip
"""Errors that malformed values cause on decoding or use."""


class ObjectState(NamedTuple):
    """Saved state of one object: values by declared name."""

    values: dict[str, Any]


class RngState(NamedTuple):
    """State of a random generator."""

    state: dict[str, Any]


Records = Mapping[str, type]
"""Frozen dataclasses and named tuples that saved state may hold, by name."""


def encode(value: Any, records: Records) -> bytes:
    """A value as bytes.

    Raises:
        StateError: The value holds an object that can't be encoded; names the type.
    """
    try:
        return _Encoder(records).pack(value)
    except (ValueError, OverflowError, RecursionError) as error:
        raise StateError(f"state can't be saved: {error}") from None


def decode(data: bytes, records: Records) -> Any:
    """The value that ``encode`` was given; arrays are new and may be written.

    Raises:
        StateError: The data is no result of ``encode``.
    """
    try:
        return _Decoder(records).unpack(data)
    except DECODE_ERRORS as error:
        raise StateError(f"not a saved state: {type(error).__name__}: {error}") from None


@final
class _Encoder:
    def __init__(self, records: Records) -> None:
        self._records = records
        self._depth = 0

    def pack(self, value: Any) -> bytes:
        self._depth += 1
        if self._depth > _DEPTH:
            raise StateError("state is nested too deeply, or contains itself")
        packed = _packb(value, default=self._other, strict_types=True)
        self._depth -= 1
        return packed

    def _other(self, value: Any) -> Any:
        """Encode a value of a type that MessagePack doesn't have."""
        kind = cast("Any", type(value))
        if kind is ObjectState:
            return self._ext(_PART, value.values)
        if kind is np.ndarray:
            return self._array(value)
        if issubclass(kind, np.generic):
            return self._ext(_SCALAR, [value.dtype.str, value.tobytes()])
        if kind is RngState:
            return self._ext(_STREAM, value.state)
        if kind is int:
            return _ExtType(_INTEGER, str(value).encode())
        if kind is Fraction:
            return self._ext(_FRACTION, [value.numerator, value.denominator])
        if kind is array:
            return self._ext(_NUMBERS, [value.typecode, value.tobytes()])
        for code, (plain, taken) in _CONTAINERS.items():
            if kind is plain:
                return self._ext(code, taken(value))
        return self._record(value)

    def _ext(self, code: int, content: Any) -> Any:
        return _ExtType(code, self.pack(content))

    def _array(self, value: NDArray[Any]) -> Any:
        if value.dtype.hasobject:
            return self._ext(_OBJECTS, [list(value.shape), value.ravel().tolist()])
        return self._ext(_ARRAY, [_encoded_dtype(value.dtype), list(value.shape), value.tobytes()])

    def _record(self, value: Any) -> Any:
        kind = cast("Any", type(value))
        if self._records.get(kind.__qualname__) is not kind:
            raise StateError(f"state holds a {kind.__module__}.{kind.__qualname__}, which can't be saved")
        items = list(value) if issubclass(kind, tuple) else [getattr(value, f.name) for f in fields(value)]
        return self._ext(_RECORD, [kind.__qualname__, items])


@final
class _Decoder:
    def __init__(self, records: Records) -> None:
        self._records = records
        self._depth = 0
        self._readers: dict[int, Callable[[Any], Any]] = {
            _PART: ObjectState,
            _STREAM: RngState,
            _ARRAY: lambda content: _array(*content),
            _SCALAR: lambda content: _array(content[0], [1], content[1])[0],
            _OBJECTS: lambda content: _objects(*content),
            _FRACTION: lambda content: Fraction(*content),
            _NUMBERS: lambda content: _numbers(*content),
            _RECORD: lambda content: self._record(*content),
            **{code: plain for code, (plain, _) in _CONTAINERS.items()},
        }

    def unpack(self, data: bytes) -> Any:
        self._depth += 1
        if self._depth > _DEPTH:
            raise ValueError("values are nested too deeply")
        unpacked = _unpackb(data, ext_hook=self._ext, strict_map_key=False)
        self._depth -= 1
        return unpacked

    def _ext(self, code: int, data: bytes) -> Any:
        if code == _INTEGER:
            return int(data[:_DIGITS])
        return self._readers[code](self.unpack(data))

    def _record(self, name: str, items: list[Any]) -> Any:
        return self._records[name](*items)


_CONTAINERS: Final[dict[int, tuple[type, Callable[[Any], Any]]]] = {
    _TUPLE: (tuple, list),
    _SET: (set, sorted),
    _DEQUE: (deque, list),
    _COUNTER: (Counter, dict),
}
"""Types that are made from a list or a map, and how they are made into one; in an order that is always the same."""


def is_record(kind: Any) -> bool:
    """Whether a class is a frozen dataclass or a named tuple: a value with names for its parts."""
    if is_dataclass(kind):
        return isinstance(kind, type) and all(field.init for field in fields(kind))
    return isinstance(kind, type) and hasattr(kind, "_fields") and tuple in kind.__mro__


def _encoded_dtype(dtype: np.dtype[Any]) -> Any:
    """An array's type in MessagePack's: its code, or name, code and shape of every field."""
    if dtype.names is None:
        if dtype.kind not in _KINDS and dtype.kind != "V":
            raise StateError(f"state holds an array of {dtype}, which can't be saved: not a number")
        return dtype.str
    return [[name, _encoded_dtype(dtype[name].base), list(dtype[name].shape)] for name in dtype.names]


def _type(encoded: Any) -> np.dtype[Any]:
    if isinstance(encoded, str):
        found = np.dtype(encoded)
        if not (found.kind in _KINDS and found.itemsize <= 8) and not (
            found.kind == "V" and encoded[:2] == "|V"
        ):
            raise ValueError(f"an array of {encoded!r}")
        return found
    if len(encoded) > _COLUMNS:
        raise ValueError(f"an array of {len(encoded)} fields")
    return np.dtype([(name, _type(code), tuple(shape)) for name, code, shape in encoded])


def _array(encoded: Any, shape: list[int], data: bytes) -> NDArray[Any]:
    dtype, count = _type(encoded), _count(shape)
    if len(data) != count * dtype.itemsize:
        raise ValueError(f"{len(data)} bytes for an array of {count} times {dtype.itemsize}")
    if dtype.kind == "b" and data.strip(b"\x00\x01"):
        raise ValueError("a boolean that is neither 0 nor 1")
    return np.frombuffer(bytearray(data), dtype).reshape(shape)


def _objects(shape: list[int], items: list[Any]) -> NDArray[Any]:
    found = np.empty(_count(shape), dtype=object)
    if len(items) != len(found):
        raise ValueError(f"{len(items)} objects for an array of {len(found)}")
    for i, item in enumerate(items):
        found[i] = item
    return found.reshape(shape)


def _numbers(code: str, data: bytes) -> array[Any]:
    if code not in ("q", "d"):
        raise ValueError(f"numbers of kind {code!r}")
    return array(code, data)


def _count(shape: list[int]) -> int:
    if len(shape) > _DIMENSIONS or any(type(size) is not int or size < 0 for size in shape):
        raise ValueError(f"an array of shape {shape}")
    return prod(shape)
