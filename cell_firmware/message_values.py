"""Numbers of a message, and the problem of one that its field can't carry, in the same words for all forms."""

from __future__ import annotations

from functools import cache
from typing import Any, Final, NamedTuple, cast

import numpy as np

from bus.wire.message_type import Leaf, Step, inside, leaves

_PLAIN: Final = 1e20
"""Whole floats below it are shown without an exponent."""
_WIDE: Final = 8
"""Bytes of the integers whose drafts are not float64."""
_LONGEST: Final = 40
"""Most characters of a refused value in an error."""


class FieldValue(NamedTuple):
    """A number of a message.

    Attributes:
        name: Of its field, with its place in a vector.
        leaf: The field.
        place: Index in a vector; empty for a single number.
        start: First byte in the packed message.
    """

    name: str
    leaf: Leaf
    place: tuple[int, ...]
    start: int

    @property
    def type(self) -> np.dtype[Any]:
        """Its wire type."""
        return self.leaf.type

    @property
    def path(self) -> tuple[Step, ...]:
        """Steps to it in a message."""
        return (*self.leaf.path, self.place) if self.place else self.leaf.path

    def of(self, messages: Any) -> Any:
        """Return the number of messages, of their shape."""
        return inside(messages, self.path)


@cache
def values_of(message: np.dtype[Any]) -> tuple[FieldValue, ...]:
    """Return the numbers of a message type, in the order of its bytes."""
    return tuple(
        FieldValue(
            leaf.name + "".join(f"[{i}]" for i in index),
            leaf,
            index,
            leaf.start + number * leaf.type.itemsize,
        )
        for leaf in leaves(message)
        for number, index in enumerate(np.ndindex(leaf.shape))
    )


def bounds(field: np.dtype[Any], most: int | None = None) -> tuple[int, int]:
    """Least and greatest value of an integer type; the greatest is ``most`` for the length of a list."""
    limits = np.iinfo(field)
    return int(limits.min), int(limits.max) if most is None else most


def overflow(field: np.dtype[Any]) -> float:
    """Least number that is rounded to infinity in a float type, half a step beyond the greatest; at most infinity."""
    limits = np.finfo(field)
    return float(limits.max) + 2.0 ** (limits.maxexp - limits.nmant - 2)


def misfit(value: FieldValue, side: str, number: Any) -> str:
    """The problem of a value that doesn't fit: field, value and rule.

    Args:
        value: The place in the message.
        side: Where the message goes.
        number: What the program gave.
    """
    field = value.type
    if field.kind == "f":
        rule = f"a finite number ({field.name})"
    elif field.kind == "b":
        rule = "true or false (bool)"
    else:
        low, high = bounds(field, value.leaf.most)
        rule = f"a whole number from {low} to {high} ({field.name})"
    return f"message field {value.name} to the {side} is {_shown(number, field)}: must be {rule}"


def _shown(value: Any, field: np.dtype[Any]) -> str:
    """A value as both forms show it: as the draft of the field holds it, and 300 for 300.0 too."""
    if (
        isinstance(value, int)
        and abs(value) < _PLAIN
        and not (field.kind in "iu" and field.itemsize == _WIDE)
    ):
        value = float(value)
    if isinstance(value, int):
        text = str(int(value)) if abs(value) < 10**_LONGEST else "a whole number too long to show"
    elif not isinstance(value, (float, np.integer, np.floating)):
        text = repr(value)
    else:
        number = cast("Any", value)
        whole = np.isfinite(number) and number == number // 1 and abs(number) < _PLAIN
        text = str(int(number)) if whole else repr(float(number))
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"
