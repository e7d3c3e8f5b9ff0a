"""Cautions about values that are allowed and hardly meant."""

from __future__ import annotations

from pathlib import Path

import pytest

from deploy.cli import main
from deploy.errors import InputError
from deploy.runs.setup import warnings_of
from deploy.scenes.files import bundled_names, load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.warnings import scene_warnings
from deploy.studies.campaign.runner import Campaign


def _of(*changes: str, scene: str = "elliptic") -> list[str]:
    return list(scene_warnings(load_scene(scene, [Override.parse(text) for text in changes])))


def test_no_bundled_scene_has_warnings() -> None:
    assert {
        name: found for name in bundled_names() if (found := list(scene_warnings(load_scene(name))))
    } == {}


@pytest.mark.parametrize(
    ("scene", "change", "warning"),
    [
        ("elliptic", "parcels.0.angle_rad=90", "parcels[0].angle_rad = 90: more than a turn, and angles are in "),
        ("align", "cells.parameters.angle_rad=-45", "cells.parameters.angle_rad = -45: more than a turn, "),
        ("elliptic", "parcels.0.size_m=[0.5, 2.5]", "parcels[0]: 0.5 × 2.5 m, larger than the array, which is 2 × 2 m"),
        ("elliptic", "parcels.0={ vertices_m = [[-3, 0], [3, 0], [0, 1]], mass_kg = 1.0, position_m = [0, 0] }",
         "parcels[0]: 6 × 1 m, larger than the array, which is 2 × 2 m"),
        ("stream", "effects.feeders.feed.0.size_m=[9.0, 0.1]", "effects.feeders.feed[0]: 9 × 0.1 m, larger than"),
        ("elliptic", "faults=[{ at_s = 1, cell = [0, 0] }, { at_s = 10, cell = [1, 1] }, { at_s = 12, cell = [2, 2] }]",
         "faults[1].at_s = 10, faults[2].at_s = 12: after the end of the run (duration_s = 10): never active"),
        ("elliptic", "cells.period_s=4.096", "cells.period_s = 4.096: a control period of seconds; an "),
        ("elliptic", "duration_s=0.004", "duration_s = 0.004: the run is over after one tick, which takes 0.004096 s"),
    ],
)  # fmt: skip
def test_a_suspicious_setting_is_named_with_its_value_and_the_reason(
    scene: str, change: str, warning: str
) -> None:
    (found,) = _of(change, scene=scene)
    assert found.startswith(warning)


@pytest.mark.parametrize(
    "change", ["parcels.0.angle_rad=-3.2", "parcels.0.size_m=[2.0, 2.0]", "duration_s=0.005"]
)
def test_what_may_well_be_meant_is_not(change: str) -> None:
    assert _of(change) == []


def test_a_simulation_reports_warnings_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    short = ("--duration", "0.001", "--no-picture", "--output", str(tmp_path))
    assert main(["simulate", "elliptic", *short]) == 0
    captured = capsys.readouterr()
    assert "mdms: warning: duration_s = 0.001: the run is over after one tick" in captured.err
    assert "warning    duration_s = 0.001" in captured.out


def test_a_run_reports_warnings_of_the_scene_and_of_its_firmware() -> None:
    assert warnings_of(load_scene("elliptic", [Override.parse("cells.period_s=2")]))[0].startswith(
        "cells.period_s = 2"
    )


def test_a_campaign_reports_each_warning_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def enough(*_: object) -> None:
        raise InputError("enough")

    monkeypatch.setattr(Campaign, "run", enough)
    arguments = ("elliptic", "--fault", "crash", "--share", "0,0.1", "--set", "parcels.0.angle_rad=90")
    assert main(["campaign", *arguments, "--output", str(tmp_path)]) == 2
    assert capsys.readouterr().err.count("mdms: warning: parcels[0].angle_rad = 90: ") == 1


def _nothing(*_: object, **__: object) -> None:
    raise InputError("nothing is measured here")


@pytest.mark.parametrize(
    "command",
    [
        ["run", "--processes", "0", "--transport", "memory", "--no-picture", "--output", "out"],
        ["simulate", "--no-picture", "--output", "out"],
        ["accuracy", "--quick", "--no-sampling"],
        ["effects", "--repeats", "1"],
        ["orientations"],
        ["constants"],
    ],
    ids=lambda command: command[0],
)
def test_every_command_that_takes_a_scene_prints_its_warnings_once(
    command: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("deploy.studies.effects.study.effect_types", dict)  # it has nothing to toggle
    monkeypatch.setattr("deploy.studies.accuracy.study.study", _nothing)
    name, *more = command
    settings = ["--set", "parcels.0.angle_rad=90", "--set", "duration_s=0.02"]
    assert main([name, "elliptic", *settings, *more]) == (2 if name == "accuracy" else 0)
    line = "mdms: warning: parcels[0].angle_rad = 90: more than a turn"
    assert capsys.readouterr().err.count(line) == 1


def test_dead_time_in_the_speed_loops_is_told_from_half_of_their_delay_margin() -> None:
    # the default loop bears 78.5 ms
    assert _of("bus.sense_to_drive_ticks=9", scene="motors") == []
    (line,) = _of("bus.sense_to_drive_ticks=10", scene="motors")
    assert "43 ms of dead time" in line
    assert "delay margin is 79 ms: the wheels' speeds overshoot" in line
    (line,) = _of("bus.sense_to_drive_ticks=19", scene="motors")
    assert "the loops are unstable" in line
    assert _of("bus.sense_to_drive_ticks=64") == []
