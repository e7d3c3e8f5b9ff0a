"""Completion of arguments in the shell: scenes, kinds of faults, keys of a scene."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import typer


def scenes(incomplete: str) -> list[tuple[str, str]]:
    """Return bundled scenes that begin so, each with its title."""
    import tomllib

    from deploy.scenes.files import bundled_names, scene_text

    names = [name for name in bundled_names() if name.startswith(incomplete)]
    return [(name, str(tomllib.loads(scene_text(name)).get("title", ""))) for name in names]


def fault_kinds(incomplete: str) -> list[tuple[str, str]]:
    """Return kinds of faults that begin so, each with a line on it."""
    from deploy.faults.registry import KINDS, gist

    return [(name, gist(name)) for name in KINDS if name.startswith(incomplete)]


def effect_names(incomplete: str) -> list[tuple[str, str]]:
    """Return lists of effects whose last name begins so, each with a line on the last."""
    from deploy.studies.effects.ablation import effect_types, summary

    before, comma, last = incomplete.rpartition(",")
    return [(f"{before}{comma}{name}", summary(name)) for name in effect_types() if name.startswith(last)]


def scene_keys(context: typer.Context, incomplete: str) -> list[str]:
    """Return ``KEY=`` of every key of the named scene that begins so; of tables only the next part."""
    from deploy.errors import DeployError
    from deploy.scenes.files import load_scene

    # an option that still lacks its value leaves the words before it unread
    words = [context.params.get("scene"), *context.args]
    scene = next((word for word in words if word and not word.startswith("-")), "elliptic")
    try:
        table: Any = load_scene(scene).model_dump(mode="json")
    except DeployError:
        return []
    before, dot, _ = incomplete.rpartition(".")
    for part in before.split(".") if dot else ():
        table = _inside(table, part)
    return [
        f"{before}{dot}{key}{'.' if any(_items(value)) else '='}"
        for key, value in _items(table)
        if f"{before}{dot}{key}".startswith(incomplete)
    ]


def _inside(table: Any, part: str) -> Any:
    return next((value for key, value in _items(table) if key == part), None)


def _items(table: Any) -> Iterator[tuple[str, Any]]:
    """Yield keys and values of a table, places and items of a list; nothing of anything else."""
    if isinstance(table, dict):
        yield from table.items()  # pyright: ignore[reportUnknownVariableType, reportUnknownMemberType]
    elif isinstance(table, list) and all(isinstance(item, dict) for item in table):  # pyright: ignore[reportUnknownVariableType]
        yield from ((str(place), item) for place, item in enumerate(table))  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
