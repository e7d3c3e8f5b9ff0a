"""Errors in a scene in terms of its file: path, value, rule. All errors are reported at once."""

from __future__ import annotations

import difflib
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, TypeVar, cast, final

from pydantic import BaseModel, TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from cell_firmware.errors import dotted
from deploy.errors import InputError
from deploy.util.formatting import plural

KeyPath = tuple[str | int, ...]
"""Keys, and numbers of list items, from the top of the scene."""

ABSENT: Final = object()
"""The value of a key that is not there, or whose value is no help in the message."""

CROSS: Final = "scene"
"""Pydantic's error type of what does not agree between sections; its location is the path."""

_Model = TypeVar("_Model", bound=BaseModel)
_Any = TypeVar("_Any")
_LONGEST_VALUE = 60


@final
@dataclass(frozen=True, slots=True)
class Problem:
    """Validation finding in a scene.

    Attributes:
        path: Where; empty for the whole scene.
        rule: What is allowed there.
        value: What is there, or ``ABSENT``.
        option: The command line option that put it there, if one did.
    """

    path: KeyPath
    rule: str
    value: Any = ABSENT
    option: str | None = None

    def __str__(self) -> str:
        where = dotted(self.path)
        if self.value is not ABSENT:
            where += f" = {shown(self.value)}"
        first, *more = self.rule.split("\n")  # a firmware that can't be loaded shows its traceback below
        source = f" (from {self.option})" if self.option else ""
        line = f"{where}: {first}{source}" if where else f"{first}{source}"
        return "\n".join([line, *more])


@final
class SceneError(InputError):
    """Error that lists the problems of a refused scene.

    Attributes:
        scene: Its name.
        problems: All that is wrong with it.
    """

    def __init__(self, scene: str, problems: Sequence[Problem]) -> None:
        super().__init__(scene, tuple(problems))
        self.scene = scene
        self.problems = tuple(problems)

    def __str__(self) -> str:
        return "\n".join(f"scene {self.scene}: {problem}" for problem in self.problems)


def shown(value: Any) -> str:
    """A value as TOML writes it, cut where it gets long."""
    text = _toml(value)
    return text if len(text) <= _LONGEST_VALUE else text[: _LONGEST_VALUE - 3] + "..."


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(_toml(item) for item in cast('Sequence[Any]', value))}]"
    if isinstance(value, dict):
        pairs = cast("dict[str, Any]", value)
        return "{" + ", ".join(f"{key} = {_toml(item)}" for key, item in pairs.items()) + "}"
    return str(value)


def nearest(name: str, known: Iterable[str]) -> str:
    """Advice for an unknown name: the nearest known one, or all of them."""
    names = sorted(known)
    if close := difflib.get_close_matches(name, names, n=1):
        return f"nearest: {close[0]}"
    return f"known: {', '.join(names)}" if names else "none are known here"


def strictly(model: type[_Model], data: Any) -> _Model:
    """Validate what TOML gave: a list may be a tuple, a whole number a float; nothing else is guessed.

    Raises:
        ValidationError: See ``problems_of``.
    """
    return strictly_any(TypeAdapter(model), data)


def strictly_any(adapter: TypeAdapter[_Any], data: Any) -> _Any:
    """``strictly`` for whatever pydantic validates, unions of models for one."""
    return adapter.validate_json(json.dumps(data, default=str), strict=True)


def problems_of(
    error: ValidationError, data: Any, model: type[BaseModel], prefix: KeyPath = ()
) -> list[Problem]:
    """A pydantic error in the words of a scene file.

    Args:
        error: What validating ``data`` raised.
        data: What was validated, as TOML gives it.
        model: What it was validated against.
        prefix: KeyPath of ``data`` in the scene.
    """
    schema: dict[str, Any] | None = None
    problems: list[Problem] = []
    for detail in error.errors(include_url=False):
        problem = _problem(detail, data)
        if detail["type"] == "extra_forbidden":
            schema = schema or model.model_json_schema()
            known = _known_keys(schema, problem.path[:-1], data)
            problem = replace(problem, rule=f"unknown key; {nearest(str(problem.path[-1]), known)}")
        problem = replace(problem, path=(*prefix, *problem.path))
        if _short_list(detail) and problems and problems[-1].path == problem.path:
            problems.pop()  # pydantic lists every item that isn't there: the last says how many there must be
        problems.append(problem)
    return problems


def _short_list(detail: ErrorDetails) -> bool:
    return detail["type"] == "missing" and isinstance(detail["loc"][-1], int)


def _problem(detail: ErrorDetails, data: Any) -> Problem:
    kind = detail["type"]
    context = detail.get("ctx", {})
    if kind == CROSS:
        value = detail["input"]  # TOML has no null: None stands for a key that is not there
        return Problem(detail["loc"], context["rule"], ABSENT if value is None else value)
    path = _path_in(data, detail["loc"], missing=kind == "missing")
    value: Any = detail["input"]
    if kind == "missing":
        if isinstance(path[-1], int):
            return Problem(path[:-1], f"must have {plural(path[-1] + 1, 'item')}, not {len(value)}", value)
        return Problem(path, "required")
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        key = context["discriminator"].strip("'")
        if kind == "union_tag_not_found":
            return Problem((*path, key), "required")
        known = [tag.strip().strip("'") for tag in context["expected_tags"].split(",")]
        return Problem((*path, key), f"unknown {key}; {nearest(str(context['tag']), known)}", context["tag"])
    rule = _RULES[kind](context) if kind in _RULES else detail["msg"]
    if kind in ("tuple_type", "list_type") and isinstance(value, dict) and len(path) == 1:
        rule = f"must be a list: in a file [[{path[0]}]], in double brackets, begins each of its tables"
    if kind in ("value_error", "assertion_error"):
        rule = str(context["error"])
    # A whole table does not fit a line, and the rule names what matters in it.
    return Problem(path, rule, ABSENT if isinstance(value, dict) else value)


_RULES: dict[str, Callable[[dict[str, Any]], str]] = {
    "greater_than": lambda c: f"must be > {c['gt']:g}",
    "greater_than_equal": lambda c: f"must be >= {c['ge']:g}",
    "less_than": lambda c: f"must be < {c['lt']:g}",
    "less_than_equal": lambda c: f"must be <= {c['le']:g}",
    "finite_number": lambda _: "must be finite",
    "float_type": lambda _: "must be a number",
    "int_type": lambda _: "must be an integer",
    "int_from_float": lambda _: "must be an integer",
    "bool_type": lambda _: "must be true or false",
    "string_type": lambda _: "must be text in quotes",
    "tuple_type": lambda _: "must be a list",
    "list_type": lambda _: "must be a list",
    "dict_type": lambda _: "must be a table",
    "model_type": lambda _: "must be a table",
    "model_attributes_type": lambda _: "must be a table",
    "too_short": lambda c: f"must have at least {plural(c['min_length'], 'item')}, not {c['actual_length']}",
    "too_long": lambda c: f"must have at most {plural(c['max_length'], 'item')}, not {c['actual_length']}",
    "string_too_short": lambda _: "must not be empty",
    "literal_error": lambda c: f"must be {c['expected']}",
}
"""Rules in our words, by pydantic's error type; what is not here keeps pydantic's."""


def _path_in(data: Any, location: Sequence[str | int], *, missing: bool) -> KeyPath:
    """A pydantic location without the parts that are no keys: the tags of unions."""
    path: list[str | int] = []
    here = data
    for depth, part in enumerate(location):
        there = _inside(here, part)
        if there is not ABSENT:
            here = there
        elif not (missing and depth == len(location) - 1):
            continue
        path.append(part)
    return tuple(path)


def _inside(container: Any, part: str | int) -> Any:
    if isinstance(container, dict) and part in container:
        return cast("dict[str | int, Any]", container)[part]
    if isinstance(container, list) and isinstance(part, int) and part < len(cast("list[Any]", container)):
        return cast("list[Any]", container)[part]
    return ABSENT


def _known_keys(schema: dict[str, Any], path: KeyPath, data: Any) -> set[str]:
    """The keys that a JSON Schema knows at ``path``, in the branch that the data's tags choose."""
    definitions = schema.get("$defs", {})
    nodes = _branches(schema, definitions, data)
    here = data
    for part in path:
        here = _inside(here, part)
        nodes = [
            branch
            for node in nodes
            for child in _children(node, part)
            for branch in _branches(child, definitions, here)
        ]
    return {key for node in nodes for key in node.get("properties", {})}


def _children(node: dict[str, Any], part: str | int) -> list[dict[str, Any]]:
    if isinstance(part, str):
        return [node["properties"][part]] if part in node.get("properties", {}) else []
    prefix = node.get("prefixItems", [])
    if part < len(prefix):
        return [prefix[part]]
    return [node["items"]] if isinstance(node.get("items"), dict) else []


def _branches(node: dict[str, Any], definitions: dict[str, Any], data: Any) -> list[dict[str, Any]]:
    """A node without references and unions: the one branch its tag chooses, or all of them."""
    if "$ref" in node:
        return _branches(definitions[node["$ref"].rpartition("/")[2]], definitions, data)
    tag = node.get("discriminator")
    if tag and isinstance(data, dict):
        chosen = tag["mapping"].get(cast("dict[str, Any]", data).get(tag["propertyName"]))
        if chosen:
            return _branches({"$ref": chosen}, definitions, data)
        # without its tag a table is read as the member whose tag has a default, where there is one
        members = [
            branch
            for ref in tag["mapping"].values()
            for branch in _branches({"$ref": ref}, definitions, data)
        ]
        untagged = [member for member in members if tag["propertyName"] not in member.get("required", ())]
        if tag["propertyName"] not in data and len(untagged) == 1:
            return untagged
    union = node.get("anyOf") or node.get("oneOf")
    if union:
        return [branch for member in union for branch in _branches(member, definitions, data)]
    return [node]
