import json
from typing import Any

import pytest

from cell_firmware.board_presets import BOARDS, BoardSpec, expand_preset
from cell_firmware.effects.registry import CellEffects
from deploy.scenes.errors import SceneError
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene


def scene(*changes: str) -> Scene:
    return load_scene("motors", [Override.parse(change) for change in changes])


def enabled(found: Scene) -> dict[str, Any]:
    return {name: effect for name, effect in found.effects.enabled() if name != "motors"}


@pytest.mark.parametrize("name", BOARDS)
def test_a_board_is_effects_of_the_cells_that_are_valid(name: str) -> None:
    tables = BOARDS[name]  # pyright: ignore[reportArgumentType]
    assert set(CellEffects.model_validate(tables).model_dump(exclude_none=True)) == set(tables)


def test_a_board_asks_for_all_its_effects() -> None:
    assert set(enabled(scene('cells.board="hc11"'))) == set(BOARDS["hc11"])
    assert scene('cells.board="hc11"').effects.clock == CellEffects.model_validate(BOARDS["hc11"]).clock


def test_effects_that_a_board_lacks_are_not_enabled() -> None:
    found = enabled(scene('cells.board={ name = "hc11", without = ["clock", "serial"] }'))
    assert set(found) == set(BOARDS["hc11"]) - {"clock", "serial"}


def test_an_effect_s_table_in_the_scene_stands_instead_of_the_board_s() -> None:
    found = scene(
        'cells.board="hc11"', "effects.clock={ error_ppm = 7.0 }", "effects.link_loss={ probability = 0.5 }"
    )
    assert found.effects.clock is not None
    assert found.effects.clock.error_ppm == 7.0
    assert found.effects.link_loss is not None
    assert set(enabled(found)) == {*BOARDS["hc11"], "link_loss"}


def test_a_scene_with_a_board_is_the_scene_that_names_its_effects() -> None:
    by_hand = [f"effects.{name}={_toml(table)}" for name, table in BOARDS["hc11"].items()]
    assert scene('cells.board="hc11"').canonical() == scene(*by_hand).canonical()
    assert scene('cells.board="hc11"').canonical() != scene().canonical()


def _toml(table: Any) -> str:
    return "{" + ", ".join(f"{key} = {json.dumps(value)}" for key, value in table.items()) + "}"


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        (('cells.board="hc12"',), 'cells.board = "hc12": must be \'hc11\' (from --set cells.board="hc12")'),
        (
            ('cells.board={ name = "hc11", without = ["motors"] }',),
            'cells.board.without = ["motors"]: no board has an effect',
        ),
        (
            ('cells.board={ name = "hc11", whithout = [] }',),
            "cells.board.whithout = []: unknown key; nearest: without",
        ),
        (("cells.board=3",), "cells.board = 3: must be"),
    ],
)
def test_a_board_that_is_none_is_refused(changes: tuple[str, ...], line: str) -> None:
    with pytest.raises(SceneError) as refused:
        scene(*changes)
    assert line in str(refused.value)


def test_requirements_of_a_board_s_effects_are_reported_by_name() -> None:
    with pytest.raises(SceneError, match=r"effects\.motors: must be set too: effects\.encoder needs it"):
        load_scene("elliptic", [Override.parse('cells.board="hc11"')])


def test_data_without_a_board_is_left_as_it_is() -> None:
    for data in ({}, {"cells": {}}, {"cells": 3}, [], {"cells": {"board": "hc11"}, "effects": 4}):
        assert expand_preset(data) is data


def test_a_board_s_spec_reads_its_own_words() -> None:
    assert BoardSpec.model_validate({"name": "hc11", "without": ["cop"]}).without == ("cop",)
