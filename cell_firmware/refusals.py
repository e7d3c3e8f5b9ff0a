"""Refusal of messages that no cell of a program could have sent, at receivers whose links may be damaged by faults."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bus.wire.message_type import bounded_lists, overlong
from cell_firmware.firmware import Inbox, opaque_view
from cell_firmware.message_values import FieldValue, values_of
from cell_firmware.program import Program

REFUSALS: Final = "words"
"""Part of a controller's state that is there exactly if the cells refuse messages."""
REFUSED: Final = "refused"
"""In this part, ``(n,)`` int64: how many messages each cell has refused."""

_EXACT: Final = 2**53
"""Whole numbers below it are float64 without rounding."""


def refuse(program: Program, inbox: Inbox) -> tuple[Inbox, NDArray[np.int64]]:
    """Drop implausible messages.

    Args:
        program: Program of the cells.
        inbox: Whole messages, ``(n, 4)``.

    Returns:
        The other messages, and ``(n,)``, how many were refused by each cell.
    """
    broken = overlong(inbox.message, inbox.message.dtype)
    refused = inbox.received & (broken | ~program.accepts(inbox.message))
    if not refused.any():
        return inbox, np.zeros(len(refused), dtype=np.int64)
    message = np.array(inbox.message)
    whole = opaque_view(message)
    whole[refused] = np.zeros((), dtype=whole.dtype)
    return Inbox(inbox.received & ~refused, message), refused.sum(axis=1)


def plausibility_checks(program: Program) -> NDArray[Any] | None:
    """Return what ``refuse`` looks at, for kernels.

    Args:
        program: Program of the cells; has messages.

    Returns:
        ``(c,)`` of ``kernels.plausibility.CHECK``; None where kernels can't check as ``refuse`` does: ``accepts`` is
        the program's own, or numbers are compared in types that kernels don't have.
    """
    from cell_firmware.kernels.plausibility import CHECK

    if type(program).accepts is not Program.accepts or program.message is None:
        return None
    found = [*_checks(program, program.message)]
    if any(one is None for one in found):
        return None
    return np.array(found, dtype=CHECK)


def _checks(program: Program, message: np.dtype[Any]) -> Iterator[tuple[Any, ...] | None]:
    """Yield the checks of a program's messages; None for each that kernels don't have."""
    from cell_firmware.kernels.plausibility import BOOLEAN, FLOAT, SIGNED, UNSIGNED

    kinds, ranges = {"b": BOOLEAN, "u": UNSIGNED, "i": SIGNED, "f": FLOAT}, program.value_ranges()
    always = (0, 0, 0)
    for value in values_of(message):
        kind = (kinds[value.type.kind], value.start, value.type.itemsize)
        if value.leaf.most is not None:
            yield (*kind, 0.0, float(value.leaf.most), *always)
        if value.leaf.name in ranges:
            low, high = (_bound(value.type, number) for number in ranges[value.leaf.name])
            known = low is not None and high is not None
            yield (*kind, low, high, *_length_of(value, message)) if known else None
        elif value.type.kind == "f":
            largest = float(np.finfo(value.type).max)
            yield (*kind, -largest, largest, *always) if value.type.itemsize > 2 else None


def _bound(field: np.dtype[Any], number: Any) -> float | None:
    """Return a bound of a field as the float64 with which NumPy's comparison is that of float64; None without one."""
    if isinstance(number, np.generic) or not isinstance(number, int | float):
        return None
    if field.kind == "f":
        return float(field.type(number)) if field.itemsize > 2 else None
    return float(number) if isinstance(number, float) or abs(number) < _EXACT else None


def _length_of(value: FieldValue, message: np.dtype[Any]) -> tuple[int, int, int]:
    """Return first byte and size of the length of a number's list, and the number's place in it; zeros without one."""
    leaf = value.leaf
    if leaf.list_path is None:
        return 0, 0, 0
    (around,) = (one for one in bounded_lists(message) if one.path == leaf.list_path)
    record = leaf.path[len(leaf.list_path) + 1 :]
    place = record[0][0] if record else value.place[0]
    return around.start, around.items_start - around.start, int(place)
