"""TOML text of plain tables: what the standard library reads, but does not write."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any, Final, cast

_BARE: Final = re.compile(r"[A-Za-z0-9_-]+")


def toml_value(value: Any) -> str:
    """Return a value in one line: text, number, boolean, list or inline table.

    Raises:
        ValueError: A number is not finite, or a value is of no such type.
    """
    if isinstance(value, Mapping):
        items = cast("Mapping[str, Any]", value).items()
        return "{ " + ", ".join(f"{_key(name)} = {toml_value(one)}" for name, one in items) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml_value(one) for one in cast("list[Any]", value)) + "]"
    if not isinstance(value, str | bool | int | float):
        raise ValueError(f"{value!r}: TOML has no such value")
    # JSON's form of them is TOML too, but for one character
    return json.dumps(value, ensure_ascii=False, allow_nan=False).replace("\x7f", "\\u007f")


def toml_text(table: Mapping[str, Any]) -> str:
    """Return a file: values first, then tables, and lists of tables as ``[[name]]``."""
    return "\n".join(_lines(table, ())).strip() + "\n"


def _lines(table: Mapping[str, Any], path: tuple[str, ...]) -> Iterator[str]:
    inner: list[tuple[str, list[Mapping[str, Any]], bool]] = []
    for name, value in table.items():
        if isinstance(value, Mapping):
            inner.append((name, [cast("Mapping[str, Any]", value)], False))
        elif _is_tables(value) and not path:
            inner.append((name, value, True))
        else:
            yield f"{_key(name)} = {toml_value(value)}"
    for name, tables, many in inner:
        here = ".".join(map(_key, (*path, name)))
        for one in tables:
            yield from ("", f"[[{here}]]" if many else f"[{here}]")
            yield from _lines(one, (*path, name))


def _is_tables(value: Any) -> bool:
    """Whether a value is a list of tables, not empty."""
    if not isinstance(value, list):
        return False
    items = cast("list[Any]", value)
    return bool(items) and all(isinstance(one, Mapping) for one in items)


def _key(name: str) -> str:
    return name if _BARE.fullmatch(name) else toml_value(name)
