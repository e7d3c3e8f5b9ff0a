"""Tables of a scene that are one of several kinds, distinguished by a tag."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast


def tagged(key: str, default: str) -> Callable[[object], object]:
    """Return a validator that fills in the default tag of a tagged union's table."""

    def fill(value: object) -> object:
        if not isinstance(value, dict):
            return value
        table = cast("dict[str, object]", value)
        return {key: default, **{name: _as_tuples(item) for name, item in table.items()}}

    return fill


def _as_tuples(value: object) -> object:
    """Lists as tuples: behind a validator in Python a strict one takes the one for the other no longer."""
    return (
        tuple(_as_tuples(item) for item in cast("list[object]", value)) if isinstance(value, list) else value
    )
