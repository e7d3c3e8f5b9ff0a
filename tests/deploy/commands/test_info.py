"""``mdms info`` prints the contents of a recording, or says in one line why not."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from deploy.cli import main

Make = Callable[..., Any]


def test_info_names_scene_time_status_topics_and_faults(
    tmp_path: Path, made_up_run: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    made_up_run(
        events=[{"time_s": 0.0, "kind": "tipped", "parcel": 0}] * 3,
        faults=[{"time_s": 0.0, "kind": "timed_out", "cell": [1, 2]}],
    ).record(tmp_path)
    assert main(["info", str(tmp_path)]) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["status", "ok"] in lines
    assert ["events", "3", "tipped"] in lines
    assert ["array", "12", "cells,", "1", "parcel"] in lines
    assert ["faults", "1,2", "timed", "out", "at", "0", "s"] in lines
    assert [row[1] for row in lines if row[:1] == ["/tick"]] == ["13"]
    assert [row[-2:] for row in lines if row[:1] == ["/tick"]] == [["mdms.tick", "(jsonschema)"]]


def test_json_has_every_field_and_the_same_of_a_cut_recording(
    tmp_path: Path, made_up_run: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    path = made_up_run(ticks=20, wheels_change=True).record(tmp_path)
    assert main(["info", str(path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["status"], found["complete"], found["ticks"], found["instants"]) == ("ok", True, 20, 21)
    assert found["digest"] == "ab" * 32
    assert found["size_bytes"] == path.stat().st_size
    assert {topic["name"]: topic["messages"] for topic in found["topics"]} == {
        **dict.fromkeys(("/registers", "/trace", "/messages", "/events", "/faults", "/control"), 0),
        "/tick": 21,
        "/parcels": 21,
        "/end": 1,
    }
    assert all(topic["schema_encoding"] == "jsonschema" for topic in found["topics"])
    path.write_bytes(path.read_bytes()[:2500])
    assert main(["info", str(path), "--json"]) == 0
    cut = json.loads(capsys.readouterr().out)
    assert (cut["status"], cut["complete"], cut["digest"], cut["instants"]) == (None, False, None, 0)
    assert cut["scene"] == found["scene"]


def test_a_missing_recording_is_bad_input_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["info", str(tmp_path / "none.mcap")]) == 2
    assert "can't read the recording" in capsys.readouterr().err
