"""``mdms accuracy``: a table, one line, JSON, files; and how it ends."""

from __future__ import annotations

import csv
import json
import os
import signal
from pathlib import Path

import pytest

from deploy.cli import main
from deploy.recordings.run_log import RunLog
from deploy.studies.accuracy import sampling_cost as sampling
from deploy.studies.accuracy import trace
from deploy.studies.accuracy.plots import CSV_NAME, JSON_NAME, SAMPLING, TOLERANCE, WORK_PRECISION
from plant.tick import TickRecord

QUICK = ("accuracy", "elliptic", "--quick", "--repeats", "1", "--duration", "0.15", "--quiet")
ALONE = (*QUICK, "--no-sampling")


def test_the_json_has_the_reference_and_a_row_a_setting(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*ALONE, "--json"]) == 0
    shown = capsys.readouterr()
    assert shown.err == ""
    found = json.loads(shown.out)
    assert found["scene"] == "elliptic"
    assert [one["target_m"] for one in found["cheapest"]] == [1e-3, 1e-6, 1e-9, 1e-12]
    assert min(row["relative"] for row in found["rows"] if row["status"] == "ok") == 1.0
    assert found["reference"]["method"]
    agreement = found["reference"]["agreement"]
    assert {one["method"].split(",")[0] for one in agreement} >= {"closed form", "exact"}
    assert all(one["apart_m"] < 1e-12 for one in agreement)
    names = {
        "solver", "setting", "error_max", "error_end", "events_missed", "events_invented", "wall_s", "status",
    }  # fmt: skip
    assert all(names <= set(row) for row in found["rows"])
    assert {row["setting"] for row in found["rows"]} >= {
        "tolerance 1e-08",
        "rk4 step_s 0.001",
        "step_s 0.004",
    }


def test_the_table_has_every_row_and_says_what_judged_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*ALONE, "--set", "solver.tolerance=1e-8"]) == 0
    out = capsys.readouterr().out
    assert "\nreference: " in out
    assert "closed form: " in out
    for text in (
        "exact         tolerance 1e-12",
        "fixed_step    rk4 step_s 0.001",
        "cheapest by error:",
        "quasi_static leaves out inertia",
    ):
        assert text in out
    assert "scipy LSODA: omitted: " in out
    assert "…" not in out


def test_a_target_is_answered_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*ALONE, "--target", "1e-6"]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith("1e-06 m over 0.15 s of elliptic: ")


def test_a_target_that_nothing_reaches_is_answered_too_with_status_1(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main([*ALONE, "--target", "1e-30", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["target"] is None
    assert main([*ALONE, "--target", "1e-30"]) == 1
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith("no setting reaches 1e-30 m on elliptic; the nearest is ")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["heat"], 'scene heat: cells.firmware = "heat_diffusion": must be velocity_field'),
        (["elliptic", "--target", "0"], "--target 0.0: must be > 0"),
        (["elliptic", "--set", "parcels.0.position_m=[9,9]"], "scene elliptic: parcels[0]"),
    ],
)
def test_what_can_t_be_studied_is_refused_in_one_line(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["accuracy", *arguments, "--quiet"]) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith(message)
    assert len(shown.err.splitlines()) == 1


def test_a_folder_gets_tables_and_pictures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sampling, "FEW_HALVINGS", 1)
    assert main([*QUICK, "--output", str(tmp_path / "new")]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == str(tmp_path / "new")
    names = {path.name for path in (tmp_path / "new").iterdir()}
    assert names == {JSON_NAME, CSV_NAME, WORK_PRECISION, TOLERANCE, SAMPLING}
    found = json.loads((tmp_path / "new" / JSON_NAME).read_text())
    with (tmp_path / "new" / CSV_NAME).open(newline="") as table:
        assert [row["setting"] for row in csv.DictReader(table)] == [row["setting"] for row in found["rows"]]
    assert [len(one["rows"]) for one in found["sampling"]] == [2]
    for name in (WORK_PRECISION, TOLERANCE, SAMPLING):
        assert (tmp_path / "new" / name).read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_in_the_middle_leaves_nothing(
    number: signal.Signals,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    inner = trace.iterate_field_motion

    def interrupted(*arguments: object, **options: object) -> object:
        os.kill(os.getpid(), number)
        return inner(*arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(trace, "iterate_field_motion", interrupted)
    assert main([*ALONE, "--output", str(tmp_path / "new")]) == 130
    shown = capsys.readouterr()
    assert (shown.out, shown.err) == ("", "mdms: interrupted\n")
    assert not (tmp_path / "new").exists()


def test_a_signal_that_a_run_of_the_whole_system_takes_ends_the_study_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    inner = RunLog.tick

    def interrupted(self: RunLog, record: TickRecord) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        inner(self, record)

    monkeypatch.setattr(RunLog, "tick", interrupted)
    assert main([*QUICK, "--output", str(tmp_path / "new")]) == 130
    assert tuple(capsys.readouterr()) == ("", "mdms: interrupted\n")
    assert not (tmp_path / "new").exists()
