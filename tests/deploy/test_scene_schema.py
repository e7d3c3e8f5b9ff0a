"""The JSON Schema accepts what ``mdms`` accepts and refuses the same slips."""

from __future__ import annotations

import tomllib
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from deploy.scene_files import bundled_names, scene_text
from deploy.scene_schema import scene_schema


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
