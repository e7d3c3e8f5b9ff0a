"""The problem of a value that a message's field can't carry, in the same words for both forms of firmware."""

from __future__ import annotations

from typing import Any, Final, cast

import numpy as np

_PLAIN: Final = 1e20
"""Whole floats below it are shown without an exponent."""
_WIDE: Final = 8
"""Bytes of the integers whose drafts are not float64."""
_LONGEST: Final = 40
"""Most characters of a refused value in an error."""


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
