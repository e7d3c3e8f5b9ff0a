"""The status of a run: who is here, who is missed, and what a tick waits for."""

from __future__ import annotations

import json
import socket
from pathlib import Path
from typing import Any

import pytest

from deploy.commands.options import target_of
from deploy.control.client import ANY_RUN
from deploy.errors import InputError
from deploy.scenes.files import load_scene
from deploy.workers import status
from deploy.workers.join import request_of
from deploy.workers.plan import RunOptions, plan
from deploy.workers.status import RunProgress, RunStatus
from tests.deploy.workers.test_external import Tokens

SCENE = load_scene("motors")
FLOW = {"state": "running", "speed": None, "real_time_factor": 1.0, "lag_s": 0.0}


def made() -> tuple[RunStatus, Tokens]:
    tokens: Any = Tokens()
    planned = plan(SCENE, RunOptions(3, external=True, join="tcp/127.0.0.1:0"), "one")
    found = RunStatus(planned, 2.0, tokens, lambda shard: request_of(shard, 3, "a", {}))
    return found, tokens


def test_a_run_that_waits_names_the_shards_that_are_missing_and_the_hosts_of_those_that_are_here() -> None:
    asked, tokens = made()
    tokens.alive, tokens.processes = {0, 2}, {(0, "a")}
    state = asked.state()
    assert (state["state"], state["shards"], state["here"], state["missing"]) == ("waiting", 3, 2, 1)
    assert [shard["name"] for shard in state["missing_shards"]] == ["cells 1"]
    assert [("host" in shard) for shard in state["processes"]] == [True, False]
    assert json.loads(asked.answer(None))["run"] == "one"  # type: ignore[arg-type]


def test_a_run_that_goes_on_misses_shards_with_lost_cells_and_not_those_that_died_by_its_schedule() -> None:
    asked, tokens = made()
    tokens.alive = {2}
    lattice = SCENE.lattice()
    asked.progress = lambda: RunProgress(5, 0.1, FLOW, [lattice.cells[0]], [1])
    state = asked.state()
    assert (state["tick"], state["lost"], state["missing"]) == (5, 1, 1)
    assert [shard["shard"] for shard in state["missing_shards"]] == [0]
    asked.progress = lambda: RunProgress(5, 0.1, FLOW, [], [1])
    assert asked.state()["missing"] == 0


def test_a_tick_that_does_not_end_names_what_it_waits_for_unless_the_run_is_paused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = [100.0]
    monkeypatch.setattr(status.time, "monotonic", lambda: now[0])
    asked, _ = made()
    asked.progress = lambda: RunProgress(5, 0.1, FLOW, [], [1])
    assert asked.state()["waits_for"] == []
    now[0] += 2.0
    late = asked.state()
    assert (late["waits_s"], late["waits_for"]) == (2.0, [1])
    asked.progress = lambda: RunProgress(5, 0.1, {**FLOW, "state": "paused"}, [], [1])
    assert asked.state()["waits_for"] == []


def test_without_a_run_below_the_folder_whoever_listens_by_hand_is_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with socket.create_server(("127.0.0.1", 0)) as server:
        monkeypatch.setattr("deploy.commands.options.DEFAULT_PORT", server.getsockname()[1])
        assert target_of(None, None) == (f"tcp/127.0.0.1:{server.getsockname()[1]}", ANY_RUN)
    with pytest.raises(InputError, match="no run is in progress below runs/"):
        target_of(None, None)
