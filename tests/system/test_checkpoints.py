"""Runs that are taken up again from a checkpoint come to what they would have come to."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from deploy.checkpoints.store import (
    FILE_NAME,
    PREVIOUS,
    CheckpointStore,
    find_checkpoint,
    options_of,
    scene_of,
)
from deploy.runs.run import run
from deploy.runs.summary import Outcome
from deploy.scenes.files import load_scene
from deploy.workers.plan import Processes, RunOptions
from tests.system.killed import assert_whole, ended, kill_after, reached, start
from tests.system.running import name_of

Small = Callable[..., Path]

OWN = {"wall_s", "startup_s", "ticks_per_s", "realtime_factor", "resumed", "output"}
"""What a summary says of the process that ran it, and not of the run."""

DEATHS = """
[[faults]]
at_s = 0.05
cell = [0, 0]
[[faults]]
at_s = 0.02
until_s = 0.15
cell = [2, 3]
"""


def _left(folder: Path, scene: Path, monkeypatch: pytest.MonkeyPatch, **options: Any) -> Outcome:
    """A run whose checkpoints stay, as though it had been killed at its end."""
    monkeypatch.setattr(CheckpointStore, "clear", lambda _: None)
    how = RunOptions(output=folder, picture=False, checkpoint_s=1e-3, **options)
    outcome = run(load_scene(str(scene)), how, quiet=True)
    assert outcome.summary.status == "ok"
    (folder / "summary.json").unlink()
    return outcome


def _gone_on(folder: Path) -> Outcome:
    checkpoint = find_checkpoint(folder)
    options = options_of(checkpoint, RunOptions(output=folder, picture=False))
    return run(scene_of(checkpoint), options, quiet=True, resumed=checkpoint)


def _told(outcome: Outcome) -> dict[str, Any]:
    told = json.loads(outcome.summary.to_json())
    return {name: value for name, value in told.items() if name not in OWN}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("processes", "transport"),
    [(0, "memory"), (2, "zenoh"), ("each", "zenoh")],
    ids=["one", "shards", "each"],
)
def test_it_tells_of_itself_as_the_whole_run_does(
    processes: Processes, transport: str, small: Small, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "out"
    whole = _left(
        folder,
        small(DEATHS),
        monkeypatch,
        processes=processes,
        transport=transport,
        registers=3,
        protocol_report=1,
    )
    table = (folder / "protocol.csv").read_bytes()
    outcome = _gone_on(folder)
    assert 0 < outcome.summary.resumed[0] < outcome.summary.ticks
    assert _told(outcome) == _told(whole)
    assert (folder / "protocol.csv").read_bytes() == table
    assert whole.summary.digest is not None
    assert_whole(folder, whole.summary.ticks, whole.summary.digest)


def test_a_torn_checkpoint_makes_it_go_on_from_the_one_before(
    small: Small, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = _left(tmp_path / "out", small(), monkeypatch, transport="memory", realtime=0.5)
    path = tmp_path / "out" / FILE_NAME
    last = find_checkpoint(tmp_path / "out").tick
    path.write_bytes(path.read_bytes()[:-100])
    outcome = _gone_on(tmp_path / "out")
    assert outcome.summary.resumed[0] < last
    assert outcome.summary.digest == whole.summary.digest


def test_one_that_is_over_leaves_no_checkpoint(small: Small, tmp_path: Path) -> None:
    options = RunOptions(transport="memory", output=tmp_path, picture=False, checkpoint_s=1e-3)
    assert run(load_scene(str(small())), options, quiet=True).summary.status == "ok"
    assert not {FILE_NAME, PREVIOUS} & {path.name for path in tmp_path.iterdir()}


@pytest.mark.slow
def test_a_killed_plant_is_taken_up_again_and_killed_again(tmp_path: Path) -> None:
    """Once between checkpoints, once as soon as one is written, the second time in a run that goes on already."""
    folder = tmp_path / "out"
    scene = ("elliptic", "--duration", 1.6)
    whole = run(
        load_scene("elliptic").model_copy(update={"duration_s": 1.6}),
        RunOptions(transport="memory", output=tmp_path / "whole", picture=False),
        quiet=True,
    )
    first = kill_after(
        start(folder, *scene, "--realtime", 1, "--checkpoint", 0.1, "--output", folder), 0, 0.13
    )
    assert first is not None
    second = kill_after(start(folder, "--resume", folder, "--realtime", 1), first.tick, 0.0)
    assert second is not None
    summary = ended(start(folder, "--resume", folder))
    assert summary["digest"] == whole.summary.digest
    assert len(summary["resumed"]) == 2
    assert summary["resumed"][0] >= first.tick
    assert_whole(folder, summary["ticks"], summary["digest"])


@pytest.mark.slow
def test_a_worker_that_is_killed_in_a_resumed_run_starts_again(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    kept = ("--processes", 2, "--respawn", 1, "--realtime", 1, "--checkpoint", 0.1, "--output", folder)
    first = kill_after(start(folder, "heat", "--duration", 3, *kept), 0, 0.0)
    assert first is not None
    again = start(folder, "--resume", folder, "--realtime", 1)
    again.wait_for(lambda: reached(folder) > first.tick, "a checkpoint was written")
    workers = [pid for pid in again.children() if name_of(pid).startswith("cell")]
    assert len(workers) == 2
    os.kill(workers[0], signal.SIGKILL)
    summary = ended(again)
    assert [fault["kind"] for fault in summary["faults"]] == ["disconnected"] * 100 + ["respawn"]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"bound": {"numpy": "0"}}, r"changed since the run began: .*numpy \(then 0, now "),
        ({"recorded": {"/tick": 10_000}}, "ends before the checkpoint: .* messages of /tick"),
    ],
)
def test_what_it_can_not_go_on_from_is_refused_before_anything_is_lost(
    change: dict[str, Any], told: str, small: Small, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from deploy.errors import InputError

    _left(tmp_path, small(), monkeypatch, transport="memory")
    recording = (tmp_path / "recording.mcap").read_bytes()
    checkpoint = find_checkpoint(tmp_path)
    options = options_of(checkpoint, RunOptions(output=tmp_path, picture=False))
    with pytest.raises(InputError, match=told):
        run(scene_of(checkpoint), options, quiet=True, resumed=replace(checkpoint, **change))
    assert (tmp_path / "recording.mcap").read_bytes() == recording
    assert find_checkpoint(tmp_path) == checkpoint
