"""The JSON Schema of a scene file, the parameters of bundled firmware included."""

from __future__ import annotations

from typing import Any

from pydantic.json_schema import models_json_schema

from cell_firmware.loader import BUNDLED, find
from cell_firmware.specs import CellsSpec
from deploy.field_docs import describe
from deploy.scene import Scene

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
