"""Options that several commands share as one parameter, a dataclass; typer wants each by itself."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import MISSING, fields
from inspect import Parameter, Signature
from typing import Any, get_type_hints


def spread(command: Callable[..., None]) -> Callable[..., None]:
    """A command as typer reads it: its first parameter, a dataclass of options, as one parameter a field.

    Args:
        command: Takes an instance of a dataclass with typer's annotations, and options of its own by keyword.
    """
    hints = get_type_hints(command, include_extras=True)
    first, *own = inspect.signature(command).parameters.values()
    options: type[Any] = hints[first.name]
    shared = get_type_hints(options, include_extras=True)
    parameters = [
        Parameter(
            field.name,
            Parameter.KEYWORD_ONLY,
            default=Parameter.empty if field.default is MISSING else field.default,
            annotation=shared[field.name],
        )
        for field in fields(options)
    ] + [parameter.replace(annotation=hints[parameter.name]) for parameter in own]

    @functools.wraps(command)
    def called(**given: Any) -> None:
        chosen = {field.name: given.pop(field.name) for field in fields(options)}
        command(options(**chosen), **given)

    called.__signature__ = Signature(parameters)  # pyright: ignore[reportAttributeAccessIssue]
    called.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return called
