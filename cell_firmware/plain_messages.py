"""Messages of firmware in plain Python: numbers, tuples and dictionaries, to and from records of the wire type."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final, cast, final

import numpy as np
from numpy.typing import NDArray

from bus.lattice import SIDES
from bus.wire.message_type import ITEMS, Leaf, list_bound
from cell_firmware.errors import MessageValueError
from cell_firmware.firmware import Inbox, Outbox
from cell_firmware.message_values import FieldValue, bounds, misfit, overflow, values_of

Message = Mapping[str, Any]
"""One message: values by field name, as the firmware's message type declares them."""

_Encode = Callable[[Any, str], Any]
"""From a plain value, and the side to which it is sent, to what NumPy makes a field of."""
_Decode = Callable[[Any], Any]
"""From a field as NumPy's ``tolist`` has it to a plain value."""
_SIDE_NUMBERS: Final = {side: number for number, side in enumerate(SIDES)}


@final
class PlainMessages:
    """Conversion of a type of messages: vectors and lists are tuples, and nested records dictionaries.

    Args:
        message: The type.

    Attributes:
        type: The type.
    """

    def __init__(self, message: np.dtype[Any]) -> None:
        self.type = message
        values = iter(values_of(message))
        names = message.names or ()
        self._encoders = {name: _encoder(message[name], name, values) for name in names}
        self._decoders = {name: _decoder(message[name]) for name in names if not _is_number(message[name])}

    def encode(self, message: Message, side: str) -> tuple[Any, ...]:
        """Return a message as NumPy makes a record of it.

        Raises:
            MessageValueError: A value doesn't fit its field.
            TypeError, ValueError: The message is no mapping of the type's fields, or a field has another structure.
        """
        encoders = self._encoders
        try:
            as_declared = message.keys() == encoders.keys()
        except AttributeError:
            raise TypeError(
                f"message to the {side} must be a dict of {', '.join(encoders)}, not {message!r}"
            ) from None
        if not as_declared:
            raise ValueError(
                f"message to the {side} has fields {sorted(message)}; its type has {sorted(encoders)}"
            )
        return tuple([encode(message[name], side) for name, encode in encoders.items()])

    def decode(self, values: tuple[Any, ...]) -> dict[str, Any]:
        """Return a message from what ``tolist`` makes of a record."""
        found = dict(zip(self._encoders, values, strict=True))
        for name, decode in self._decoders.items():
            found[name] = decode(found[name])
        return found

    def inboxes(self, inbox: Inbox) -> Iterator[dict[str, Message | None]]:
        """Yield the inbox of each cell by side."""
        names, decode = tuple(self._encoders), self.decode
        north, east, south, west = SIDES
        rows = zip(inbox.received.tolist(), inbox.message.tolist(), strict=True)
        if len(names) == 1 and not self._decoders:
            (name,) = names
            for (n, e, s, w), ((to_n,), (to_e,), (to_s,), (to_w,)) in rows:
                yield {
                    north: {name: to_n} if n else None,
                    east: {name: to_e} if e else None,
                    south: {name: to_s} if s else None,
                    west: {name: to_w} if w else None,
                }
            return
        for (n, e, s, w), (to_n, to_e, to_s, to_w) in rows:
            yield {
                north: decode(to_n) if n else None,
                east: decode(to_e) if e else None,
                south: decode(to_s) if s else None,
                west: decode(to_w) if w else None,
            }


@final
class Sent:
    """Messages of all cells in a tick, put into an outbox at once.

    Args:
        messages: Their type; None: the program has none.
    """

    def __init__(self, messages: PlainMessages | None) -> None:
        self._messages = messages
        self._slots: list[int] = []
        self._values: list[tuple[Any, ...]] = []

    def add(self, cell: int, messages: Mapping[str, Message | None]) -> None:
        """Add the messages of a cell.

        Raises:
            MessageValueError: A value doesn't fit its field.
            TypeError, ValueError: A message is not of the type.
        """
        try:
            known = messages.keys() <= _SIDE_NUMBERS.keys()
        except AttributeError:
            raise TypeError(f"outbox must be a dict of messages by side, not {messages!r}") from None
        if not known:
            side = next(one for one in messages if one not in _SIDE_NUMBERS)
            raise ValueError(f"outbox has a side {side!r}; sides are {', '.join(SIDES)}")
        last: Message | None = None
        values: tuple[Any, ...] = ()
        slots: list[int] = []
        sent: list[tuple[Any, ...]] = []
        for side, number in _SIDE_NUMBERS.items():
            message = messages.get(side)
            if message is None:
                continue
            if self._messages is None:
                raise ValueError("outbox holds a message, but the firmware declares no message type")
            if message is not last:  # most programs send the same to all sides
                values, last = self._messages.encode(message, side), message
            slots.append(4 * cell + number)
            sent.append(values)
        self._slots += slots
        self._values += sent

    def outbox(self, n: int) -> Outbox | None:
        """Return the outbox of n cells; None for programs without messages."""
        if self._messages is None:
            return None
        outbox = Outbox.empty(n, self._messages.type)
        if self._slots:
            outbox.sent.reshape(-1)[self._slots] = True
            outbox.message.reshape(-1)[self._slots] = np.array(self._values, dtype=self._messages.type)
        return outbox


# --- sending --------------------------------------------------------------------------------------


def _is_number(kind: np.dtype[Any]) -> bool:
    return kind.subdtype is None and kind.names is None


def _encoder(kind: np.dtype[Any], name: str, values: Iterator[FieldValue]) -> _Encode:
    """Return an encoder of a field.

    Args:
        kind: Its type.
        name: Its name, with those of the records around it.
        values: The numbers of the message, from the field's first on; the field's are consumed.
    """
    if kind.subdtype is not None:
        return _vector_encoder(kind.base, kind.shape, name, values)
    if kind.names is None:
        return _number_encoder(next(values))
    if list_bound(kind) is not None:
        return _list_encoder(kind[ITEMS], name, next(values), values)
    return _record_encoder(kind, name, values)


def _number_encoder(value: FieldValue) -> _Encode:
    fits = _fitting(value.leaf)

    def encode(given: Any, side: str) -> Any:
        if not fits(given):
            number = _number_of(given)
            raise MessageValueError(misfit(value, side, given if number is None else number))
        return given

    if not value.place:
        return encode
    # NumPy makes an array of a vector first, in which a float among them would round 64-bit integers
    convert = {"f": float, "b": bool}.get(value.type.kind, int)
    return lambda given, side: convert(encode(given, side))


def _vector_encoder(
    base: np.dtype[Any], shape: tuple[int, ...], name: str, values: Iterator[FieldValue]
) -> _Encode:
    def item(i: int) -> _Encode:
        own = f"{name}.{i}" if base.names else f"{name}[{i}]"
        return (
            _vector_encoder(base, shape[1:], own, values) if len(shape) > 1 else _encoder(base, own, values)
        )

    encoders = [item(i) for i in range(shape[0])]

    def encode(given: Any, side: str) -> list[Any]:
        items = _items(given, name, side)
        if len(items) != len(encoders):
            raise ValueError(
                f"message field {name} to the {side} has {len(items)} values: must have {len(encoders)}"
            )
        return [encode(one, side) for encode, one in zip(encoders, items, strict=True)]

    return encode


def _list_encoder(
    items: np.dtype[Any], name: str, length: FieldValue, values: Iterator[FieldValue]
) -> _Encode:
    most = items.shape[0]
    encoders = [
        _encoder(items.base, f"{name}.items.{i}" if items.base.names else f"{name}.items[{i}]", values)
        for i in range(most)
    ]
    blank: Any = np.zeros((), dtype=items.base).tolist()

    def encode(given: Any, side: str) -> tuple[int, list[Any]]:
        found = _items(given, name, side)
        if len(found) > most:
            raise MessageValueError(misfit(length, side, len(found)))
        packed = [encode(one, side) for encode, one in zip(encoders, found, strict=False)]
        return len(found), packed + [blank] * (most - len(found))

    return encode


def _record_encoder(kind: np.dtype[Any], name: str, values: Iterator[FieldValue]) -> _Encode:
    encoders = {own: _encoder(kind[own], f"{name}.{own}", values) for own in kind.names or ()}

    def encode(given: Any, side: str) -> tuple[Any, ...]:
        if not isinstance(given, Mapping):
            raise TypeError(
                f"message field {name} to the {side} must be a mapping of {', '.join(encoders)}, "
                f"not {type(given).__name__}"
            )
        record = cast("Mapping[str, Any]", given)
        if record.keys() != encoders.keys():
            raise ValueError(
                f"message field {name} to the {side} has fields {sorted(record)}; its type has {sorted(encoders)}"
            )
        return tuple([encode(record[own], side) for own, encode in encoders.items()])

    return encode


def _items(given: Any, name: str, side: str) -> Sequence[Any]:
    """Return the items of a vector or list: of a list, a tuple or an array."""
    kind = cast("type[object]", type(given))
    if issubclass(kind, np.ndarray) and given.ndim:
        return given.tolist()
    if issubclass(kind, list | tuple):
        return given
    raise TypeError(
        f"message field {name} to the {side} must be a list, a tuple or an array, not {kind.__name__}"
    )


# --- receiving ------------------------------------------------------------------------------------


def _decoder(kind: np.dtype[Any]) -> _Decode:
    """Return a decoder of a field."""
    if kind.subdtype is not None:
        vector = _vector_decoder(kind.base, len(kind.shape))
        return lambda value: vector(value.tolist())
    if kind.names is None:
        return lambda value: value
    decoders = {name: _decoder(kind[name]) for name in kind.names}
    if list_bound(kind) is not None:
        items = decoders[ITEMS]
        return lambda value: items(value[1])[: value[0]]
    return lambda value: {
        name: decode(one) for (name, decode), one in zip(decoders.items(), value, strict=True)
    }


def _vector_decoder(base: np.dtype[Any], dimensions: int) -> _Decode:
    decode = _decoder(base) if dimensions == 1 else _vector_decoder(base, dimensions - 1)
    return lambda value: tuple([decode(one) for one in value])


# --- values ---------------------------------------------------------------------------------------


def _fitting(leaf: Leaf) -> Callable[[Any], bool]:
    """Return whether a field can carry a value of plain firmware: a number or a truth value, in range and finite."""
    if leaf.type.kind == "f":
        beyond = overflow(leaf.type)
        return lambda value: (number := _float(value)) is not None and -beyond < number < beyond
    if leaf.type.kind == "b":
        return lambda value: _number_of(value) in (0, 1)
    low, high = bounds(leaf.type, leaf.most)

    def whole(value: Any) -> bool:
        number = _number_of(value)
        return number is not None and low <= number <= high and (type(number) is int or number == number // 1)

    return whole


def _number_of(value: Any) -> Any:
    """The value as a number; None for anything else."""
    kind = cast("type[object]", type(value))
    if kind is float or kind is int or kind is bool:
        return value
    if isinstance(value, np.generic) or (isinstance(value, np.ndarray) and value.ndim == 0):
        scalar = cast("NDArray[Any]", value)
        return scalar.item() if scalar.dtype.kind in "biuf" else None
    return value if isinstance(value, int | float) else None


def _float(value: Any) -> float | None:
    number = _number_of(value)
    try:
        return None if number is None else float(number)
    except OverflowError:
        return None
