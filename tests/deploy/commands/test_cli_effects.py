"""``mdms effects``, for people and for programs."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path
from typing import Any

import pytest

from deploy.cli import main
from deploy.studies.effects.ablation import effect_types
from plant.effects.contact_width import ContactWidthSpec
from plant.effects.load_transfer import LoadTransferSpec
from plant.effects.roller_drag import RollerDragSpec
from plant.effects.uneven_friction import UnevenFrictionSpec
from plant.effects.uneven_supports import UnevenSupportsSpec
from plant.plant import Plant


def effects(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    assert main(["effects", *arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_without_a_scene_all_effects_are_listed_with_what_they_add(
    capsys: pytest.CaptureFixture[str],
) -> None:
    rows = {row["name"]: row for row in effects(capsys)["rows"]}
    assert rows.keys() == effect_types().keys()
    assert rows["feeders"]["events"] == ["fed", "held_back", "left"]
    assert rows["wheel_load"]["needs"] == ["motors"]
    assert rows["wheel_load"]["parameters"] == ["inertia_kg"]
    assert main(["effects"]) == 0
    shown = capsys.readouterr()
    assert shown.err == ""
    assert all(len(line) <= 80 for line in shown.out.splitlines())
    assert all(f"{name} " in shown.out for name in rows)
    assert "what its load took from every wheel's speed" in " ".join(shown.out.split())


def test_only_the_effects_asked_for_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert [row["name"] for row in effects(capsys, "--only", "pwm,cop")["rows"]] == ["pwm", "cop"]


@pytest.mark.slow
def test_the_json_has_a_row_an_effect(capsys: pytest.CaptureFixture[str]) -> None:
    found = effects(capsys, "elliptic", "--duration", "0.05", "--repeats", "1", "--advise", "--quiet")
    rows = {row["name"]: row for row in found["rows"]}
    assert rows.keys() == effect_types().keys()
    assert not any(row["on"] for row in rows.values())
    assert rows["parcel_contact"]["influence_m"] == rows["parcel_contact"]["influence_rad"] == 0.0
    assert rows["motors"]["influence_m"] > 0.0
    assert rows["motors"]["cost_ratio"] > 0.0
    assert rows["motors"]["influence_m"] >= rows["motors"]["end_m"]
    assert rows["motors"]["cost_low_s"] is None  # a single round doesn't show its noise
    assert rows["motors"]["events"].keys() == {"matched", "moved_s", "moved", "only_with", "only_without"}
    assert rows["wheel_load"]["beside"] == ["motors"]
    assert rows["uneven_supports"]["solver"] == "implicit"
    assert rows["feeders"]["influence_m"] is rows["feeders"]["cost_ratio"] is None
    assert "no typical settings" in rows["feeders"]["reason"]
    assert found["advice"]["can_go"] == []
    assert "parcel_contact" not in found["advice"]["missing"]


@pytest.mark.slow
def test_the_table_fits_a_terminal_and_says_what_was_tried(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    command = [
        "effects",
        "motors",
        "--duration",
        "0.1",
        "--repeats",
        "1",
        "--advise",
        "--tolerance-mm",
        "1e3",
        "--only",
        "motors, wheel_load,feeders,parcel_contact",
    ]
    assert main(command) == 0
    shown = capsys.readouterr()
    assert "mdms: motors (1 of 4) ..." in shown.err
    lines = shown.out.splitlines()
    start = next(number for number, line in enumerate(lines) if line.startswith("effect "))
    assert all(len(line) <= 80 for line in lines[start:])
    by_name = {line.split()[0]: line.split() for line in lines[start + 1 : start + 5]}
    assert by_name["motors"][1] == "yes"
    assert by_name["feeders"][1:3] == ["no", "–"]
    assert by_name["parcel_contact"][2] == "0"
    assert "feeders: not toggled: no typical settings" in shown.out
    assert "wheel_load: tried with inertia_kg = 0.05" in shown.out
    assert "can be left out, within 1000 mm at any time:\n  motors: " in shown.out


@pytest.mark.slow
def test_the_ladder_is_printed_and_drawn(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    # each combination of effects on loads and traction is compiled by itself: fewer rungs, fewer kernels
    monkeypatch.setattr(ContactWidthSpec, "fidelity_rank", None)
    monkeypatch.setattr(UnevenSupportsSpec, "fidelity_rank", None)
    monkeypatch.setattr(RollerDragSpec, "fidelity_rank", None)
    monkeypatch.setattr(LoadTransferSpec, "fidelity_rank", None)
    monkeypatch.setattr(UnevenFrictionSpec, "fidelity_rank", None)
    folder = tmp_path / "made"
    arguments = ("ladder", "--duration", "0.05", "--repeats", "1", "--quiet", "--output", str(folder))
    found = effects(capsys, *arguments)
    assert [one["name"] for one in found["ladder"]][:4] == ["quasi_static", "viscous", "stick_slip", "motors"]
    ended = [one for one in found["ladder"] if not one["reason"]]
    assert ended[-1]["distance_m"] == 0.0
    assert ended[0]["distance_m"] > 0.0
    assert Path(found["picture"]) == folder / "ladder.png"
    assert (folder / "ladder.png").exists()
    assert main(["effects", *arguments[:-2], "--ladder"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert all(len(line) <= 80 for line in lines)
    assert any(line.startswith("quasi_static") for line in lines)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["elliptic", "--set", "parcels.0.position_m=[3.0,0.0]"], "scene elliptic: parcels[0]"),
        (["elliptic", "--tolerance-mm", "0"], "--tolerance-mm 0: must be greater than 0"),
        (["eliptic"], "neither a bundled scene nor a file; nearest: elliptic"),
        (["elliptic", "--set", "effects.fog={}"], "unknown key"),
        (["elliptic", "--only", "motor"], "--only motor: unknown effect motor; nearest: motors"),
        (["elliptic", "--only", ","], "--only: must be names of effects, separated by commas"),
        (["elliptic", "--only", "pwm", "--ladder"], "--only pwm: not with the ladder"),
        (["elliptic", "--advise", "--ladder"], "--advise: not with the ladder"),
        (["--advise"], "--advise: which SCENE?"),
    ],
)
def test_bad_input_is_refused(capsys: pytest.CaptureFixture[str], arguments: list[str], words: str) -> None:
    assert main(["effects", *arguments]) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert words in shown.err


def test_a_signal_in_the_middle_of_a_run_ends_it(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    advance, calls = Plant.advance, [0]

    def interrupted(plant: Plant, drives: Any, until_ns: int, **how: Any) -> Any:
        calls[0] += 1
        if calls[0] == 5:
            os.kill(os.getpid(), signal.SIGINT)
        return advance(plant, drives, until_ns, **how)

    monkeypatch.setattr(Plant, "advance", interrupted)
    assert main(["effects", "motors", "--only", "motors", "--quiet"]) == 130
    assert tuple(capsys.readouterr()) == ("", "mdms: interrupted\n")
    assert calls[0] == 5


def test_an_output_that_is_a_file_is_refused_before_anything_runs(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("")
    assert main(["effects", "ladder", "--output", str(tmp_path / "file")]) == 2
    assert "is a file, must be a folder" in capsys.readouterr().err
