"""Message values: what fits a field's wire type, and the rounding to it, in both forms of firmware.

Plain firmware hands over one value at a time, and `Field.fits` checks it. On arrays NumPy casts what is written: 300
becomes 44 in an unsigned byte, NaN becomes 0. An array program is therefore stepped with a *draft* of its message type,
whose fields hold what is written, and `settled` rounds the draft to the wire type.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from bus.lattice import SIDES

if TYPE_CHECKING:
    from collections.abc import Generator

    from cell_firmware.firmware import Firmware

_DOUBLE: Final = np.dtype("<f8")
_WIDEST: Final = np.dtype(np.longdouble) if np.finfo(np.longdouble).nmant >= 63 else None
"""A float that holds every 64-bit integer; None where the machine has none."""
_PLAIN: Final = 1e20
"""Whole floats below it are shown without an exponent."""
_LONGEST: Final = 40
"""Most characters of a refused value in an error."""


def draft_of(message: np.dtype[Any]) -> np.dtype[Any]:
    """The message type with fields that hold what is written: floats of 64 bits, wider ones for 64-bit integers."""
    return np.dtype([(name, _draft(message[name])) for name in message.names or ()])


def _draft(field: np.dtype[Any]) -> np.dtype[Any]:
    if field.kind in "iu" and field.itemsize == _DOUBLE.itemsize:
        return _WIDEST or field
    return _DOUBLE


@contextmanager
def drafting(firmware: Firmware, draft: np.dtype[Any] | None) -> Generator[None]:
    """Let ``firmware.message`` be the draft while the program is stepped.

    Args:
        firmware: The program.
        draft: Draft of its message type; None: leave the program as it is.
    """
    if draft is None:
        yield
        return
    own: dict[str, Any] = vars(firmware)
    before = own.copy()
    own["message"] = draft
    try:
        yield
    finally:
        if "message" in before:
            own["message"] = before["message"]
        else:
            own.pop("message", None)


def can_settle(given: np.dtype[Any], message: np.dtype[Any]) -> bool:
    """Whether an array's type has the fields of a message type, in whatever numbers."""
    return given == message or (
        given.names == message.names and all(given[name].kind in "biuf" for name in message.names or ())
    )


def settled(
    drafts: NDArray[Any], sent: NDArray[np.bool_], message: np.dtype[Any]
) -> tuple[NDArray[Any], dict[int, str]]:
    """Round messages of array firmware to the wire type.

    Args:
        drafts: ``(n, 4)``, of the wire type or of another with the same fields, such as its draft.
        sent: ``(n, 4)``: which of them go out. What is in the others is of no account.
        message: The wire type.

    Returns:
        ``(n, 4)`` of the wire type; by cell that sends what doesn't fit, the problem.
    """
    if drafts.dtype == message:
        fixed = drafts
    else:
        fixed = np.empty(drafts.shape, dtype=message)
        with np.errstate(all="ignore"):
            for name in message.names or ():
                fixed[name] = drafts[name]
    found: dict[int, tuple[int, str]] = {}
    for name in message.names or ():
        field, given, rounded = message[name], drafts[name], fixed[name]
        if field.kind == "f":
            wrong = ~np.isfinite(rounded)
        elif given.dtype != field:
            wrong = given != rounded
        else:
            continue
        if not wrong.any():
            continue
        wrong &= sent
        for row in np.flatnonzero(wrong.any(axis=1)).tolist():
            side = int(wrong[row].argmax())
            if row not in found or side < found[row][0]:
                found[row] = side, misfit(name, SIDES[side], given[row, side], field)
    return fixed, {row: text for row, (_, text) in found.items()}


class MessageField(NamedTuple):
    """A field of a message type.

    Attributes:
        type: Its wire type.
        fits: Whether it can carry a value of plain firmware: a number or a truth value, in range and finite.
    """

    type: np.dtype[Any]
    fits: Callable[[Any], bool]


def fields_of(message: np.dtype[Any]) -> dict[str, MessageField]:
    """The fields of a message type by name."""
    return {name: MessageField(message[name], _fitting(message[name])) for name in message.names or ()}


def _fitting(field: np.dtype[Any]) -> Callable[[Any], bool]:
    if field.kind == "f":
        limits = np.finfo(field)
        # half a step beyond the greatest: from there on a number is rounded to infinity
        beyond = float(limits.max) + 2.0 ** (limits.maxexp - limits.nmant - 2)
        return lambda value: (number := _float(value)) is not None and -beyond < number < beyond
    if field.kind == "b":
        return lambda value: _number(value) in (0, 1)
    low, high = bounds(field)

    def whole(value: Any) -> bool:
        number = _number(value)
        return number is not None and low <= number <= high and (type(number) is int or number == number // 1)

    return whole


def _number(value: Any) -> Any:
    """The value as a number; None for anything else."""
    kind = cast("type[object]", type(value))
    if kind is float or kind is int or kind is bool:
        return value
    if isinstance(value, np.generic) or (isinstance(value, np.ndarray) and value.ndim == 0):
        scalar = cast("NDArray[Any]", value)
        return scalar.item() if scalar.dtype.kind in "biuf" else None
    return value if isinstance(value, int | float) else None


def _float(value: Any) -> float | None:
    number = _number(value)
    try:
        return None if number is None else float(number)
    except OverflowError:
        return None


def bounds(field: np.dtype[Any]) -> tuple[int, int]:
    """Least and greatest value of an integer type."""
    limits = np.iinfo(field)
    return int(limits.min), int(limits.max)


def misfit(name: str, side: str, value: Any, field: np.dtype[Any]) -> str:
    """The problem of a value that doesn't fit: field, value and rule.

    Args:
        name: The field.
        side: Where the message goes.
        value: What the program gave.
        field: The field's wire type.
    """
    if field.kind == "f":
        rule = f"a finite number ({field.name})"
    elif field.kind == "b":
        rule = "true or false (bool)"
    else:
        low, high = bounds(field)
        rule = f"a whole number from {low} to {high} ({field.name})"
    return f"message field {name} to the {side} is {_shown(value, field)}: must be {rule}"


def _shown(value: Any, field: np.dtype[Any]) -> str:
    """A value as both forms show it: as the draft of the field holds it, and 300 for 300.0 too."""
    number = _number(value)
    if isinstance(number, int) and abs(number) < _PLAIN and _draft(field) == _DOUBLE:
        number = float(number)
    if number is None:
        text = repr(value)
    elif isinstance(number, int):
        text = str(int(number)) if abs(number) < 10**_LONGEST else "a whole number too long to show"
    elif np.isfinite(number) and number == number // 1 and abs(number) < _PLAIN:
        text = str(int(number))
    else:
        text = repr(float(number))
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"
