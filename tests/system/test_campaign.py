"""``mdms campaign``: what it leaves, and that an interrupted one goes on to the same table."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from deploy.cli import main
from tests.system.running import Mdms
from tests.system.small import small_scene

ASKED = ("--fault", "crash", "--share", "0,0.5", "--seeds", "3", "--duration", "0.3", "--within", "1")
LEFT = ("campaign.csv", "campaign.json")


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "small.toml"
    path.write_text(small_scene())
    return path


@pytest.fixture(scope="module")
def whole(scene: Path) -> Path:
    """Folder of a campaign that nobody disturbed, one run at a time."""
    folder = scene.parent / "whole"
    assert main(["campaign", str(scene), *ASKED, "--jobs", "1", "--output", str(folder), "--quiet"]) == 0
    return folder


@pytest.mark.slow
def test_an_interrupted_campaign_leaves_nothing_running_and_goes_on_to_the_same_table(
    scene: Path, whole: Path, tmp_path: Path, mdms: Callable[..., Mdms]
) -> None:
    folder = tmp_path / "cut"
    running = mdms("campaign", scene, *ASKED, "--jobs", "1", "--output", folder, "--json")
    journal = folder / "runs.jsonl"
    running.wait_for(
        lambda: journal.exists() and journal.read_bytes().count(b"\n") > 4, "five runs were over"
    )
    running.children()
    running.process.send_signal(signal.SIGINT)
    status, stdout, stderr = running.end()
    assert status == 130
    assert json.loads(stdout)["status"] == "interrupted"
    assert stderr.splitlines()[-1].endswith(f"`mdms campaign --resume {folder}` resumes")
    before = journal.read_bytes()
    assert before.count(b"\n") < 9
    assert not any((folder / name).exists() for name in LEFT)

    assert main(["campaign", "--resume", str(folder), "--jobs", "2", "--quiet"]) == 0
    assert journal.read_bytes().startswith(before)
    assert journal.read_bytes().count(b"\n") == 9
    for name in LEFT:
        assert (folder / name).read_bytes() == (whole / name).read_bytes()


def test_going_on_with_a_campaign_that_is_over_runs_nothing_and_says_the_same(
    whole: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = (whole / "runs.jsonl").read_bytes()
    assert main(["campaign", "--resume", str(whole), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads((whole / "campaign.json").read_text())
    assert (whole / "runs.jsonl").read_bytes() == before
    assert main(["campaign", "--resume", str(whole)]) == 0
    out = capsys.readouterr().out
    assert (
        "fault crash from 0 s, 3 seeds, 6 runs and 3 baseline runs; in brackets 95 % confidence intervals"
        in out
    )
    assert out.splitlines()[4].split()[:5] == ["0", "3", "0", "100", "(44–100)"]


def test_a_row_has_what_was_varied_and_what_it_came_to(whole: Path) -> None:
    report = json.loads((whole / "campaign.json").read_text())
    first, last = report["rows"]
    assert [row["values"] for row in report["rows"]] == [{"fault.share": share} for share in (0.0, 0.5)]
    assert first["error_m"] == {"mean": 0.0, "low": 0.0, "high": 0.0, "runs": 3}
    assert (first["runs"], first["failed"], first["succeeded"]) == (3, 0, 3)
    assert last["error_m"]["mean"] > 0.0
    assert last["error_m"]["low"] <= last["error_m"]["mean"] < last["error_m"]["high"]
    assert (report["status"], report["runs"], report["failed"]) == ("ok", 6, [])
    assert report["criterion"] == "error at most 1 m from where the baseline run ends (--within)"


def test_seeds_are_other_chances_and_cases_the_same_ones(whole: Path) -> None:
    lines = [json.loads(line) for line in (whole / "runs.jsonl").read_text().splitlines()]
    runs = {(line["values"]["fault.share"], line["seed"]): line for line in lines if "values" in line}
    assert len({runs[0.5, seed]["error_m"] for seed in (0, 1, 2)}) > 1
    assert sum("baseline" in line for line in lines) == 3


def test_other_arguments_and_a_folder_in_use_are_bad_input(
    scene: Path, whole: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["campaign", "--resume", str(whole), "--seeds", "4"]) == 2
    assert "--seeds 4: the campaign has 3" in capsys.readouterr().err
    assert main(["campaign", str(scene), "--output", str(whole)]) == 2
    assert f"--resume {whole} resumes it" in capsys.readouterr().err
    assert main(["campaign"]) == 2
    assert main(["campaign", "--resume", str(whole), "--output", "elsewhere"]) == 2
