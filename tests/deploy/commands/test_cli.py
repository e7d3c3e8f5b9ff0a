"""The command ``mdms``: what it lists, what it refuses, how it ends."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from bus.errors import TransportError
from cell_firmware.errors import FirmwareError, FirmwareFailed
from deploy import cli
from deploy.commands import application as command_line
from deploy.errors import DeployError, InputError
from deploy.scenes.files import bundled_names
from plant.errors import PlantError


def test_help_lists_every_command_and_teaches_by_example(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--help"]) == 0
    out = capsys.readouterr().out
    for command in command_line.COMMANDS:
        assert f" {command} " in out
    assert "mdms run elliptic" in out
    assert "Exit status" in out


def test_no_arguments_show_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    cli.main([])
    shown = capsys.readouterr()
    assert "mdms run elliptic" in shown.out + shown.err


@pytest.mark.parametrize("command", command_line.COMMANDS)
def test_every_command_is_there_and_has_help(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([command, "--help"]) == 0
    assert f"mdms {command}" in capsys.readouterr().out


def test_an_unknown_command_is_refused_with_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["scene"]) == 2
    assert "scenes" in capsys.readouterr().err


def test_an_unknown_option_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["scenes", "--colour"]) == 2
    assert "--colour" in capsys.readouterr().err


def test_the_version_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--version"]) == 0
    assert re.match(r"mdms (\d+\.\d+|\(not installed\))", capsys.readouterr().out)


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (DeployError("worker 1 died"), 1),
        (InputError("scene x: seed = -1: must be >= 0"), 2),
        (PlantError("parcels[0] has no support"), 2),
        (FirmwareError("unknown firmware 'x'"), 2),
        (FirmwareFailed((1, 2), 3, "ZeroDivisionError"), 1),
        (TransportError("tcp/127.0.0.1:7447 is in use"), 1),
    ],
)
def test_errors_that_a_user_can_act_on_end_in_their_words_and_a_status(
    error: Exception, status: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def command() -> None:
        raise error

    monkeypatch.setattr(command_line, "_function", lambda name: command)
    assert cli.main(["scenes"]) == status
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.strip() == str(error)


def test_anything_else_is_called_a_bug_and_shows_where(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def command() -> None:
        raise ZeroDivisionError("surprise")

    monkeypatch.setattr(command_line, "_function", lambda name: command)
    assert cli.main(["scenes"]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert lines[0].startswith("Traceback")
    assert lines[-1].startswith(
        "mdms: this is a bug, please report it with the lines above: ZeroDivisionError"
    )


# --- scenes -----------------------------------------------------------------------------------------


def test_the_bundled_scenes_are_listed_with_their_titles(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["scenes"]) == 0
    out = capsys.readouterr().out
    for name in ("elliptic", "heat", "misaligned", "prototype", "squeeze"):
        assert name in out
    assert "Elliptic field" in out


def test_the_list_as_json_is_one_object_and_nothing_else(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["scenes", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)["scenes"]
    assert [row["name"] for row in listed] == list(bundled_names())
    (prototype,) = (row for row in listed if row["name"] == "prototype")
    assert (prototype["cells"], prototype["parcels"], prototype["firmware"]) == (18, 1, "presence_field")


def test_a_scene_printed_is_the_file_itself(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["scenes", "elliptic"]) == 0
    assert tomllib.loads(capsys.readouterr().out)["duration_s"] == 10.0


def test_a_scene_as_json_has_its_defaults(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["scenes", "elliptic", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["gravity_m_s2"] == 9.81


def test_an_unknown_scene_is_refused_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["scenes", "eliptic"]) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert len(shown.err.splitlines()) == 1


def test_the_errors_of_a_scene_file_are_printed_one_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "x.toml"
    path.write_text("duration_s = -1\nseed = -1\n")
    assert cli.main(["scenes", str(path), "--json"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == f"scene {path}: duration_s = -1: must be > 0"
    assert [line.split(": ", 2)[1].partition(" =")[0] for line in lines] == [
        "duration_s",
        "seed",
        "array",
        "friction",
        "cells.parameters.field",  # the default firmware's
    ]


def test_the_schema_is_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["schema"]) == 0
    assert json.loads(capsys.readouterr().out)["$schema"].startswith("https://json-schema.org/")


@pytest.mark.parametrize("given", [["scenes"], ["schema"], ["--help"]])
def test_a_full_disk_behind_stdout_is_one_line(given: list[str]) -> None:
    command = [sys.executable, "-m", "deploy.cli", *given]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            command, stdout=full, stderr=subprocess.PIPE, text=True, check=False, timeout=60
        )
    assert (done.returncode, done.stderr) == (1, "mdms: can't write to stdout: No space left on device\n")


@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"])
def test_closed_standard_streams_are_no_failure(closed: str) -> None:
    command = f"{shlex.quote(sys.executable)} -m deploy.cli scenes elliptic {closed}"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
