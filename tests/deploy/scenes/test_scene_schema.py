"""The JSON Schema accepts what ``mdms`` accepts and refuses the same slips."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from deploy.scenes.files import bundled_names, scene_text
from deploy.scenes.schema import scene_schema

REFERENCE = Path(__file__).parents[3] / "docs" / "scenes.md"


@pytest.fixture(scope="module")
def validator() -> Draft202012Validator:
    schema = scene_schema()
    Draft202012Validator.check_schema(schema)
    return Draft202012Validator(schema)


def paths_of_errors(validator: Draft202012Validator, data: dict[str, Any]) -> set[str]:
    return {error.json_path for error in validator.iter_errors(data)}


@pytest.mark.parametrize("name", bundled_names())
def test_every_bundled_scene_fits_the_schema(validator: Draft202012Validator, name: str) -> None:
    assert paths_of_errors(validator, tomllib.loads(scene_text(name))) == set()


def test_unknown_keys_and_wrong_values_do_not_fit(validator: Draft202012Validator) -> None:
    data = tomllib.loads(scene_text("elliptic"))
    data["sed"] = 1
    data["parcels"][0]["mass_kg"] = -1
    assert paths_of_errors(validator, data) == {"$", "$.parcels[0].mass_kg"}


def test_the_parameters_are_those_of_the_firmware_that_the_scene_names(
    validator: Draft202012Validator,
) -> None:
    data = tomllib.loads(scene_text("elliptic"))
    data["cells"]["parameters"]["field"]["kx_per_s"] = "fast"
    assert paths_of_errors(validator, data) == {"$.cells.parameters.field"}
    del data["cells"]["firmware"]  # velocity_field is the default
    assert paths_of_errors(validator, data) == {"$.cells.parameters.field"}
    data["cells"]["firmware"] = "mine.py:Mine"
    assert paths_of_errors(validator, data) == set()

    heat = tomllib.loads(scene_text("heat"))
    heat["cells"]["parameters"]["field"] = {}
    assert paths_of_errors(validator, heat) == {"$.cells.parameters"}


def test_the_words_under_a_field_describe_it() -> None:
    schema = scene_schema()
    properties = schema["$defs"]["ExactSpec"]["properties"]
    assert properties["tolerance"]["description"] == "Error of the footprint over the run, metres."
    field = schema["$defs"]["Radial"]["properties"]["rotation_rad_s"]
    assert field["description"] == "Added rigid rotation, counter-clockwise."
    fed = schema["$defs"]["FeedSpec"]["properties"]
    assert fed["inertia_kg_m2"]["description"].startswith(
        "Moment of inertia about the centre of mass"
    )  # inherited
    assert "duration_s" in schema["properties"]
    assert "simulated time" in schema["properties"]["duration_s"]["description"].lower()


def test_the_reference_and_the_protocols_pages_name_every_key_and_choice_of_the_schema() -> None:
    whole = scene_schema()
    pages = (REFERENCE, *sorted((REFERENCE.parent / "protocols").glob("*.md")))
    words = {word for page in pages for word in re.findall(r"\w+", page.read_text(encoding="utf-8"))}
    schemas = [whole, *whole["$defs"].values()]
    keys = {key for schema in schemas for key in schema.get("properties", {})}
    choices = {
        str(choice)
        for schema in schemas
        for value in schema.get("properties", {}).values()
        for choice in (*value.get("enum", ()), *((value["const"],) if "const" in value else ()))
    }
    assert len(keys) > 40
    assert (keys | choices) - words == set()
