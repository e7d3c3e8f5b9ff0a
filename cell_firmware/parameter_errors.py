"""Pydantic's complaints about parameters, as problems that a scene's author understands."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from cell_firmware.errors import Problem


def problems(error: ValidationError, model: type[BaseModel], given: Any) -> tuple[Problem, ...]:
    """Every complaint, with paths as written in the scene.

    Args:
        error: What pydantic raised.
        model: What it validated against.
        given: What it validated.
    """
    return tuple(_problem(detail, model, given) for detail in error.errors(include_url=False))


def _problem(detail: Any, model: type[BaseModel], given: Any) -> Problem:
    location: tuple[str | int, ...] = detail["loc"]
    path = _without_tags(location, given)
    if detail["type"] == "extra_forbidden":
        known = sorted({name for found in _models_at(location[:-1], model) for name in found.model_fields})
        nearest = difflib.get_close_matches(str(location[-1]), known, n=1)
        hint = f"; did you mean {nearest[0]}? Known: " if nearest else "; known: "
        return Problem(path, f"unknown key{hint}{', '.join(known) or 'none'}", detail["input"])
    message = detail["msg"].removeprefix("Value error, ").replace("Input should be", "must be")
    if detail["type"] == "missing":
        return Problem(path, "is required")
    value = detail["input"]
    if detail["type"] != "value_error" and not isinstance(value, Mapping | list | tuple):
        message += f", not {value!r}"
    return Problem(path, message, value)


def _without_tags(location: Sequence[str | int], given: Any) -> tuple[str | int, ...]:
    """The location without the tags of discriminated unions, which nobody wrote."""
    path: list[str | int] = []
    here = given
    for i, part in enumerate(location):
        try:
            here = here[part]
        except (LookupError, TypeError):
            if i < len(location) - 1:
                continue
        path.append(part)
    return tuple(path)


def _models_at(location: Sequence[str | int], model: type[BaseModel]) -> list[type[BaseModel]]:
    """The models that may stand at a location: one, or the members of a union."""
    models = [model]
    for part in location:
        if isinstance(part, int):
            continue
        fields = [found.model_fields[part] for found in models if part in found.model_fields]
        if fields:
            models = [inner for field in fields for inner in _models_in(field.annotation)]
        else:  # the tag of a union
            models = [found for found in models if part in _tags(found)]
    return models


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from _models_in(inner)


def _tags(model: type[BaseModel]) -> tuple[Any, ...]:
    return tuple(tag for field in model.model_fields.values() for tag in get_args(field.annotation))
