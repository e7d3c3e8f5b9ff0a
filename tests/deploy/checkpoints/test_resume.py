"""What ``--resume`` refuses, in words."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from deploy import cli
from deploy.checkpoints.store import CheckpointStore, check, find_checkpoint, options_of, scene_of
from deploy.errors import InputError
from deploy.scenes.files import load_scene
from deploy.workers.plan import RunOptions, plan
from tests.deploy.checkpoints.test_store import CHECKPOINT

THEN = {
    "processes": 2,
    "live": False,
    "transport": "zenoh",
    "wire": "packed",
    "registers": None,
    "messages": None,
    "trace_messages": None,
    "protocol_report": None,
    "respawn": 0,
    "checkpoint_s": 5.0,
}


def test_a_folder_that_is_not_there() -> None:
    with pytest.raises(InputError, match="there is no such folder"):
        find_checkpoint(Path("nowhere"))


def test_a_run_that_was_killed_before_its_first_checkpoint(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"there is no checkpoint in .* start the run again"):
        find_checkpoint(tmp_path)


@pytest.mark.parametrize(("status", "refused"), [("ok", True), ("unstable", True), ("interrupted", False)])
def test_a_run_that_is_over(status: str, refused: bool, tmp_path: Path) -> None:
    CheckpointStore(tmp_path).write(CHECKPOINT.to_bytes())
    (tmp_path / "summary.json").write_text(f'{{"status": "{status}"}}')
    if not refused:
        assert find_checkpoint(tmp_path) == CHECKPOINT
        return
    with pytest.raises(InputError, match=f"the run is over, with status {status}"):
        find_checkpoint(tmp_path)


def test_it_goes_on_as_it_was_run() -> None:
    checkpoint = replace(CHECKPOINT, options=THEN)
    options = options_of(checkpoint, RunOptions(realtime=2.0))
    assert (options.processes, options.checkpoint_s, options.realtime) == (2, 5.0, 2.0)
    assert options_of(checkpoint, RunOptions(checkpoint_s=1.0)).checkpoint_s == 1.0
    assert options_of(checkpoint, RunOptions(processes=2)).processes == 2


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        ({"processes": 0}, "the run has --processes 2, which can't be --processes 0 now"),
        ({"wire": "per_cell"}, "the run has --wire packed"),
        ({"protocol_report": 1}, "the run has --protocol-report None, which can't be --protocol-report 1"),
        ({"transport": "memory"}, "the run has --transport zenoh"),
        ({"respawn": 3}, "the run has --respawn 0"),
        ({"replay": Path("other")}, "can't be --replay other"),
    ],
)
def test_options_that_are_other_than_the_run_s(given: dict[str, Any], problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        options_of(replace(CHECKPOINT, options=THEN), RunOptions(**given))


def test_options_that_no_run_has_are_refused() -> None:
    with pytest.raises(InputError, match=r"the checkpoint's options are processes$"):
        options_of(CHECKPOINT, RunOptions())
    with pytest.raises(InputError, match="the checkpoint's options are"):
        options_of(replace(CHECKPOINT, options={**THEN, "realtime": 1.0}), RunOptions())


def test_versions_that_are_other_are_named_with_both() -> None:
    check(CHECKPOINT, {"numpy": "2"})
    with pytest.raises(InputError, match=r"numpy \(then 2, now 3\); python \(then unknown, now 4\)"):
        check(CHECKPOINT, {"numpy": "3", "python": "4"})


def test_the_scene_is_the_one_that_was_run() -> None:
    scene = load_scene("noisy")
    checkpoint = replace(CHECKPOINT, scene=scene.model_dump(mode="json"), scene_name=scene.name)
    assert scene_of(checkpoint).canonical() == scene.canonical()
    with pytest.raises(InputError, match="the checkpoint's scene is refused"):
        scene_of(CHECKPOINT)


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["run"], "name a SCENE, or a run to resume"),
        (["run", "elliptic", "--seed", "3", "--resume", "DIR"], "leave out SCENE, --seed"),
        (["run", "elliptic", "--checkpoint", "0", "--plan"], "--checkpoint 0: must be greater than 0"),
    ],
)
def test_a_command_that_makes_no_sense_is_bad_input(
    arguments: list[str], problem: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(arguments) == 2
    assert problem in capsys.readouterr().err


def test_a_run_that_repeats_another_has_no_checkpoints() -> None:
    with pytest.raises(InputError, match="a replayed run can't be saved"):
        plan(load_scene("elliptic"), RunOptions(checkpoint_s=1.0, replay=Path("other")), "RUN")
