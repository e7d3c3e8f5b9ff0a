"""Overrides ``--set KEY=VALUE``: changes of single values before validation."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, cast, final

from cell_firmware.errors import dotted
from deploy.errors import InputError
from deploy.scenes.errors import KeyPath, shown
from deploy.util.formatting import plural

_BARE_WORD = re.compile(r"[A-Za-z_./~][\w./:~+-]*")
_KEY = re.compile(r"[\w-]+")
_ITEM = re.compile(r"\[(\d+)\]")
"""Number of a list item as errors write it: ``parcels[0]``."""


@final
@dataclass(frozen=True, slots=True)
class Override:
    """Override of one value of a scene.

    Attributes:
        path: Keys, and numbers of list items, from the top of the scene.
        value: Value as TOML would have it.
        option: Option as typed by the user, named in errors.
    """

    path: KeyPath
    value: Any
    option: str

    @classmethod
    def parse(cls, text: str, option: str | None = None) -> Override:
        """Read the ``KEY=VALUE`` of a ``--set``.

        The value is TOML. What is not TOML but looks like a bare word (``heat_diffusion``, ``brake``,
        ``my.module:Class``, ``./cell.py``) is that string, so that names need no quotes inside quotes.
        The number of a list item may stand in brackets: ``parcels[0].mass_kg``.

        Args:
            text: The key and the value.
            option: What the user typed, where it was another option.

        Raises:
            InputError: No ``=``, an empty key, or a value that is neither.
        """
        option = option or f"--set {text}"
        key, equals, value = text.partition("=")
        if not equals:
            raise InputError(f"{option}: must be KEY=VALUE")
        parts = [part.strip() for part in _ITEM.sub(r".\1", key).split(".")]
        if not all(_KEY.fullmatch(part) for part in parts):
            raise InputError(
                f"{option}: the key must be names and numbers with dots between them, as parcels.0.mass_kg"
            )
        path = tuple(int(part) if part.isascii() and part.isdigit() else part for part in parts)
        return cls(path, _parse_value(value.strip(), option), option)


def _parse_value(text: str, option: str) -> Any:
    try:
        table = tomllib.loads(f"value = {text}")
    except tomllib.TOMLDecodeError as error:
        if _BARE_WORD.fullmatch(text):
            return text
        reason = str(error).partition(" (at line")[0]
        raise InputError(f"{option}: the value must be TOML (text in quotes): {reason}") from None
    if len(table) != 1:  # a line break in the value began another key
        raise InputError(f"{option}: one value, not {len(table)}")
    return table["value"]


def apply(data: dict[str, Any], overrides: Iterable[Override]) -> None:
    """Change ``data`` in place; tables and lists that are not there are made.

    Args:
        data: A scene as TOML gives it.
        overrides: Applied in order, so that the last one wins.

    Raises:
        InputError: A path leads through something that is neither table nor list, or past a list's end.
    """
    for override in overrides:
        _apply(data, override)


def _apply(data: dict[str, Any], override: Override) -> None:
    here: Any = data
    value = deepcopy(override.value)  # a later override may reach into it, and this one be applied again
    for depth, part in enumerate(override.path):
        last = depth == len(override.path) - 1
        # The type of a missing container follows from the next part: a number makes a list.
        default: Any = None if last else ([] if isinstance(override.path[depth + 1], int) else {})
        if isinstance(here, dict):
            table = cast("dict[str, Any]", here)
            key = str(part)
            if last:
                table[key] = value
            else:
                here = table.setdefault(key, default)
        elif isinstance(here, list):
            items = cast("list[Any]", here)
            _check_item(items, override, depth)
            index = cast(int, part)
            if index == len(items):
                items.append(value if last else default)
            elif last:
                items[index] = value
            here = items[index]
        else:
            at = dotted(override.path[:depth])
            raise InputError(f"{override.option}: {at} = {shown(here)}: has nothing inside it to set")


def _check_item(items: list[Any], override: Override, depth: int) -> None:
    """The part at ``depth`` must number an item, or the place just after the last one."""
    part = override.path[depth]
    at = dotted(override.path[:depth])
    if not isinstance(part, int):
        raise InputError(f"{override.option}: {at} is a list: its items are numbered 0..{len(items) - 1}")
    if part > len(items):
        raise InputError(
            f"{override.option}: {at} has {plural(len(items), 'item')}: the number must be 0..{len(items)} "
            f"({len(items)} adds one)"
        )
