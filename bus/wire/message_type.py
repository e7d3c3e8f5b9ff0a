"""Types of messages: records of numbers, fixed-length vectors, nested records, and lists with a bound."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from math import prod
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from bus.errors import WireError

LENGTH: Final = "length"
"""Field of a bounded list: how many of its items there are."""
ITEMS: Final = "items"
"""Field of a bounded list: its items, and zeros behind the last."""
_MOST_BYTES: Final = 4096
_MOST_FIELDS: Final = 64
_RESERVED: Final = ("v", "tick")
_LENGTH_BYTES: Final = 4

Step = str | tuple[int, ...]
"""Step into a message: a field by its name, or an item of a vector of records by its index."""


def bounded_list(item: DTypeLike, most: int) -> np.dtype[np.void]:
    """Return the type of a message field that is a list: a record of ``length`` and ``items``, zero beyond the length.

    Args:
        item: Type of an item.
        most: Most items, 1 to 65535.

    Raises:
        ValueError: No such number of items.
    """
    if not 0 < most < 2**16:
        raise ValueError(f"most is {most}: must be 1 to {2**16 - 1}")
    return np.dtype([(LENGTH, "u1" if most < 2**8 else "<u2"), (ITEMS, item, (most,))])


class Leaf(NamedTuple):
    """Numbers of a message under one name: a plain field, or a vector of numbers.

    Attributes:
        name: Names of the records around it and its own, joined by dots; items of a vector of records by their index.
        path: The same, step by step.
        type: Type of a number.
        shape: Of the vector; empty for a single number.
        start: First byte in the packed message.
        most: Greatest value; None: as its type has it.
        list_path: Steps to the list of whose items these are numbers; None: of none.
    """

    name: str
    path: tuple[Step, ...]
    type: np.dtype[Any]
    shape: tuple[int, ...]
    start: int
    most: int | None = None
    list_path: tuple[Step, ...] | None = None

    @property
    def size(self) -> int:
        """How many numbers there are."""
        return prod(self.shape)

    def of(self, messages: NDArray[Any]) -> NDArray[Any]:
        """Return the numbers of messages, ``(..., *shape)``, as a view."""
        return inside(messages, self.path)

    def used(self, messages: NDArray[Any]) -> NDArray[np.bool_]:
        """Return which numbers of messages are used, ``(..., *shape)``: not those beyond the length of their list."""
        shape = (*messages.shape, *self.shape)
        if self.list_path is None:
            return np.ones(shape, dtype=np.bool_)
        length = inside(messages, self.list_path)[LENGTH]
        record = self.path[len(self.list_path) + 1 :]
        if record:
            return np.broadcast_to((record[0][0] < length)[(..., *(None,) * len(self.shape))], shape)
        return np.arange(self.shape[0]) < length[..., None]


class BoundedList(NamedTuple):
    """A list in a message.

    Attributes:
        path: Steps to its record.
        most: Most items.
        start: First byte of its record in the packed message.
        items_start: First byte of its items.
        item_bytes: Bytes of an item.
    """

    path: tuple[Step, ...]
    most: int
    start: int
    items_start: int
    item_bytes: int


def inside(messages: NDArray[Any], path: tuple[Step, ...]) -> NDArray[Any]:
    """Return what is at a path in messages, as a view."""
    for step in path:
        messages = messages[step] if isinstance(step, str) else messages[(..., *step)]
    return messages


def each_all(found: NDArray[np.bool_], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return for which messages all numbers of a leaf are found.

    Args:
        found: Of the numbers, ``(*shape, *leaf.shape)``.
        shape: Of the messages.
    """
    return np.logical_and.reduce(found, axis=tuple(range(len(shape), found.ndim)))


def list_bound(kind: np.dtype[Any]) -> int | None:
    """Return the most items of a bounded list's type; None for any other type."""
    if kind.names != (LENGTH, ITEMS) or kind[LENGTH].kind != "u" or kind[LENGTH].itemsize > _LENGTH_BYTES:
        return None
    return kind[ITEMS].shape[0] if len(kind[ITEMS].shape) == 1 else None


@cache
def leaves(message: np.dtype[Any]) -> tuple[Leaf, ...]:
    """Return the leaves of a message type, in the order of its bytes."""
    return tuple(part for part in _parts(message, (), 0) if isinstance(part, Leaf))


@cache
def bounded_lists(message: np.dtype[Any]) -> tuple[BoundedList, ...]:
    """Return the lists of a message type, outer lists first."""
    return tuple(part for part in _parts(message, (), 0) if isinstance(part, BoundedList))


def _parts(
    kind: np.dtype[Any],
    path: tuple[Step, ...],
    start: int,
    most: int | None = None,
    list_path: tuple[Step, ...] | None = None,
) -> Iterator[Leaf | BoundedList]:
    if kind.fields is None:
        name = ".".join(step if isinstance(step, str) else ".".join(map(str, step)) for step in path)
        if kind.base.fields is None:
            yield Leaf(name, path, kind.base, kind.shape, start, most, list_path)
            return
        for number, index in enumerate(np.ndindex(kind.shape)):
            yield from _parts(
                kind.base, (*path, index), start + number * kind.base.itemsize, list_path=list_path
            )
        return
    bound = list_bound(kind)
    if bound is not None:
        items = kind.fields[ITEMS]
        yield BoundedList(path, bound, start, start + items[1], items[0].base.itemsize)
    for name, field in kind.fields.items():
        yield from _parts(
            field[0],
            (*path, name),
            start + field[1],
            bound if name == LENGTH else None,
            path if bound is not None and name == ITEMS else list_path,
        )


def clear_tails(messages: NDArray[Any], message: np.dtype[Any]) -> None:
    """Make the items beyond the length of every list zero, in place.

    Args:
        messages: Of any shape, with the fields of ``message`` in whatever numbers.
        message: Type of the messages.
    """
    for one in bounded_lists(message):
        record = inside(messages, one.path)
        beyond = np.arange(one.most) >= record[LENGTH][..., None]
        if beyond.any():
            items = record[ITEMS]
            items[beyond] = np.zeros((), dtype=items.dtype)


def overlong(messages: NDArray[Any], message: np.dtype[Any]) -> NDArray[np.bool_]:
    """Return the messages, of any shape, with a list longer than its bound: a mask."""
    wrong = np.zeros(messages.shape, dtype=np.bool_)
    for one in bounded_lists(message):
        wrong |= inside(messages, one.path)[LENGTH] > one.most
    return wrong


def with_numbers(
    message: np.dtype[Any], number: Callable[[np.dtype[Any]], np.dtype[Any]], *, align: bool = False
) -> np.dtype[Any]:
    """Return a message type with other numbers.

    Args:
        message: The type.
        number: From the type of a number to the other one.
        align: Whether every number has an address that is a multiple of its size.
    """
    if message.subdtype is not None:
        return np.dtype((with_numbers(message.base, number, align=align), message.shape))
    if message.names is None:
        return number(message)
    return np.dtype(
        [(name, with_numbers(message[name], number, align=align)) for name in message.names], align=align
    )


def boolean_places(message: np.dtype[Any]) -> dict[str, range]:
    """Return the bytes of the boolean fields of a packed message."""
    return {
        leaf.name: range(leaf.start, leaf.start + leaf.size)
        for leaf in leaves(message)
        if leaf.type.kind == "b"
    }


def check_message(dtype: np.dtype[Any]) -> np.dtype[np.void]:
    """Return a protocol's message type as encoded on the wire: packed, little-endian.

    Args:
        dtype: Structured, of booleans, integers and floats, vectors of them, and records of these.

    Raises:
        WireError: Not structured, other fields, too large, or a reserved field name.
    """
    if dtype.names is None or not dtype.names:
        raise WireError("message", "type", f"{dtype}: must be structured, of 1 to {_MOST_FIELDS} fields")
    for name in _RESERVED:
        if name in dtype.names:
            raise WireError(
                "message",
                "type",
                f"field {name!r}: must be an identifier other than {' and '.join(_RESERVED)}",
            )
    packed = _packed(dtype, "")
    if packed.itemsize > _MOST_BYTES:
        raise WireError("message", "type", f"{packed.itemsize} bytes: must be at most {_MOST_BYTES}")
    if len(leaves(packed)) > _MOST_FIELDS:
        raise WireError(
            "message",
            "type",
            f"{len(leaves(packed))} fields, nested ones counted: must be 1 to {_MOST_FIELDS}",
        )
    return packed


def _packed(record: np.dtype[Any], around: str) -> np.dtype[np.void]:
    fields: list[tuple[str, np.dtype[Any], tuple[int, ...]]] = []
    for name in record.names or ():
        field, full = record[name], f"{around}{name}"
        if not name.isidentifier():
            raise WireError("message", "type", f"field {full!r}: must be an identifier other than v and tick")
        if 0 in field.shape:
            raise WireError(
                "message", "type", f"field {full!r} is {field}: a vector must have at least 1 item"
            )
        if field.base.names:
            fields.append((name, _packed(field.base, f"{full}."), field.shape))
        elif field.base.kind not in "biuf" or field.base.itemsize > 8:
            raise WireError(
                "message",
                "type",
                f"field {full!r} is {field}: must be bool, int or float up to 64 bits, a vector of them, or a record",
            )
        else:
            fields.append((name, field.base.newbyteorder("<"), field.shape))
    return np.dtype(fields)
