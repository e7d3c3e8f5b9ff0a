"""The strings under a model's fields, as descriptions in its JSON Schema.

Pydantic can read them while a class is being made (``use_attribute_docstrings``), which costs every start of
the program; only the schema needs them.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Iterator
from typing import Any, get_args

from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from cell_firmware.loader import BUNDLED, find
from cell_firmware.specs import CellsSpec
from deploy.scenes.scene import Scene


def describe(definitions: dict[str, Any], *roots: type[BaseModel]) -> None:
    """Add descriptions to the properties of schemas, in place.

    Args:
        definitions: Object schemas by name of the model's class.
        roots: Models that, with all that they are made of, may be among them.
    """
    for model in _models(*roots):
        schema = definitions.get(model.__name__)
        if schema is None:
            continue
        for field, words in _field_docs(model).items():
            if field in schema["properties"]:
                schema["properties"][field]["description"] = words


def _models(*roots: type[BaseModel]) -> Iterator[type[BaseModel]]:
    waiting: list[Any] = list(roots)
    seen: set[Any] = set()
    while waiting:
        annotation = waiting.pop()
        waiting += get_args(annotation)
        if isinstance(annotation, type) and issubclass(annotation, BaseModel) and annotation not in seen:
            seen.add(annotation)
            yield annotation
            waiting += [field.annotation for field in annotation.model_fields.values()]


def _field_docs(model: type[BaseModel]) -> dict[str, str]:
    """Return each field's docstring on one line, including inherited fields."""
    bases = (
        base for base in reversed(model.__mro__) if issubclass(base, BaseModel) and base is not BaseModel
    )
    return {field: words for base in bases for field, words in _own_field_docs(base).items()}


def _own_field_docs(model: type[BaseModel]) -> dict[str, str]:
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(model))).body
    assert isinstance(definition, ast.ClassDef)
    found: dict[str, str] = {}
    for field, after in zip(definition.body, definition.body[1:], strict=False):
        match field, after:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(words))):
                found[name] = " ".join(words.split())
            case _:
                pass
    return found


_DIALECT = "https://json-schema.org/draft/2020-12/schema"


def scene_schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12). Agreement between sections is beyond it; ``mdms`` checks that."""
    parameters = {name: find(name).Parameters for name in sorted(BUNDLED)}
    references, document = models_json_schema(
        [(model, "validation") for model in (Scene, *parameters.values())],
        ref_template="#/$defs/{model}",
    )
    definitions: dict[str, Any] = document["$defs"]
    describe(definitions, Scene, *parameters.values())
    scene = definitions.pop("Scene")
    definitions["CellsSpec"]["allOf"] = [
        _parameters_of(name, references[model, "validation"]) for name, model in parameters.items()
    ]
    return {"$schema": _DIALECT, **scene, "title": "Scene", "$defs": definitions}


def _parameters_of(firmware: str, reference: dict[str, Any]) -> dict[str, Any]:
    """If the cells run this firmware, the parameters are its own."""
    chosen: dict[str, Any] = {"properties": {"firmware": {"const": firmware}}}
    if firmware != CellsSpec.model_fields["firmware"].default:
        chosen["required"] = ["firmware"]
    return {"if": chosen, "then": {"properties": {"parameters": reference}}}
