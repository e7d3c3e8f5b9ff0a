"""What a recording says was done to its run, when that is to be repeated."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from deploy.errors import InputError
from deploy.live.script import script_of
from deploy.scene_files import load_scene

SCENE = load_scene("prototype")
FAULT = {"number": 1, "fault": {"kind": "crash", "cell": [1, 1]}, "first": 5, "end": None}


def _script(*control: dict[str, Any]) -> Any:
    recording = SimpleNamespace(header={"scene": SCENE.model_dump(mode="json")}, control=control, faults=())
    return script_of(cast("Any", recording), SCENE)


def test_commands_that_can_be_repeated_are_the_script() -> None:
    records = (
        {"kind": "fault", "tick": 5, "time_s": 0.02, "detail": FAULT},
        {"kind": "repair", "tick": 9, "time_s": 0.04, "detail": {"number": 1, "end": 9}},
    )
    assert _script(*records) == records


@pytest.mark.parametrize(
    "record",
    [
        {"kind": "fault", "time_s": 0.0, "detail": FAULT},
        {"kind": "fault", "tick": 5, "time_s": 0.0},
        {
            "kind": "fault",
            "tick": 5,
            "time_s": 0.0,
            "detail": {**FAULT, "fault": {"kind": "crash", "cell": [99, 1]}},
        },
        {"kind": "fault", "tick": 5, "time_s": 0.0, "detail": {**FAULT, "first": -1}},
        {"kind": "repair", "tick": 5, "time_s": 0.0, "detail": {"number": "all"}},
        {"kind": "repair", "tick": None, "time_s": 0.0, "detail": {"number": 1}},
    ],
)
def test_commands_that_can_not_are_bad_input(record: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=r"--replay: the recording's command .* can't be repeated"):
        _script(record)
