"""Tables of a scene that are one of several kinds, told apart by a tag."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast


def tagged(key: str, default: str) -> Callable[[object], object]:
    """What a validator does to a table of a tagged union whose tag may be left out: fills in the default."""

    def fill(value: object) -> object:
        return {key: default, **cast("dict[str, object]", value)} if isinstance(value, dict) else value

    return fill
