"""What a recording says was done to its run, when that is to be repeated."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from deploy.control.replay import commands_of
from deploy.errors import InputError
from deploy.scenes.files import load_scene

SCENE = load_scene("prototype")
FAULT = {"number": 1, "fault": {"kind": "crash", "cell": [1, 1]}, "first": 5, "end": None}


def _script(*control: dict[str, Any], faults: tuple[dict[str, Any], ...] = (), **changes: Any) -> Any:
    scene = {**SCENE.model_dump(mode="json"), **changes}
    recording = SimpleNamespace(header={"scene": scene}, control=control, faults=faults)
    return commands_of(cast("Any", recording), SCENE)


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
    with pytest.raises(InputError, match=r"--replay: the recording's command .* can't be replayed"):
        _script(record)


def test_cells_that_were_lost_crash_from_that_tick_until_they_came_back() -> None:
    def lost(kind: str, tick: int, *cell: int) -> dict[str, Any]:
        return {"kind": kind, "tick": tick, "cell": list(cell)}

    script = _script(
        faults=(
            lost("disconnected", 5, 0, 0),
            lost("timed_out", 5, 0, 1),
            lost("disconnected", 5, 1, 0),
            {"kind": "hang", "phase": "begins", "tick": 6, "cells": [[1, 1]]},
            lost("failed", 6, 1, 1),
            {"kind": "respawn", "phase": "happens", "tick": 9, "cells": [[0, 0], [0, 1]]},
            lost("disconnected", 9, 0, 0),
        )
    )
    assert [(record["kind"], record["tick"], record["detail"]["number"]) for record in script] == [
        ("loss", 5, 1_000_000),
        ("loss", 5, 1_000_001),
        ("loss", 9, 1_000_002),
    ]
    assert [
        (record["detail"]["fault"]["cells"], record["detail"]["first"], record["detail"]["end"])
        for record in script
    ] == [([[0, 0], [0, 1]], 5, 9), ([[1, 0]], 5, None), ([[0, 0]], 9, None)]


def test_a_recording_of_another_scene_is_refused_by_what_differs() -> None:
    stall = {**SCENE.model_dump(mode="json")["stall"]}
    assert _script(title="other words", stall={**stall, "deadline_s": 9.0}) == ()
    with pytest.raises(InputError, match="another scene than prototype: seed differ"):
        _script(title="other words", seed=99)
    with pytest.raises(InputError, match="another scene than prototype: stall differ"):
        _script(stall={**stall, "policy": "hold" if stall["policy"] != "hold" else "brake"})
