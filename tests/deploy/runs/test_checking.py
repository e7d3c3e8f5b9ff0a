"""Invariants of programs, checked in runs and campaigns."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from bus.spec import BusSpec
from cell_firmware.invariants import InvariantMonitor
from cell_firmware.message_tracer import MessageTracer
from cell_firmware.random_draws import CellStreams
from deploy import cli
from deploy.runs.run import run
from deploy.scenes.scene import Scene
from deploy.studies.campaign.result import run_case
from deploy.workers.plan import RunOptions
from mdms import InputError, Lab
from tests.deploy.lab.programs import Counting, Gossip


def _scene(columns: int, rows: int = 1, ticks: int = 20, firmware: type = Counting, **more: Any) -> Scene:
    lab = Lab(firmware, (rows, columns), check=None, **more)
    return lab.scene.model_copy(update={"duration_s": ticks * lab.scene.tick_ns / 10**9})


def _summary(scene: Scene, folder: Path, **options: Any) -> dict[str, Any]:
    outcome = run(scene, RunOptions(0, "memory", output=folder, picture=False, **options), quiet=True)
    return json.loads(outcome.summary.to_json())


def test_a_run_stops_at_the_first_violation_with_tick_cells_and_values(tmp_path: Path) -> None:
    scene = _scene(4, rows=2, faults=[{"kind": "crash", "at_tick": 0, "until_tick": 7, "cell": [1, 3]}])
    found = _summary(scene, tmp_path, check="stop")
    assert found["refused"] == []
    assert (found["status"], found["ticks"]) == ("failed", 8)
    assert found["reason"] == "tick 7: 'the number never exceeds 12' is broken at 1,3 most=13.0"
    (first,) = found["check"]["first"]
    assert first == {
        "kind": "always", "rule": "the number never exceeds 12", "tick": 7, "cells": [[1, 3]],
        "values": {"most": [13.0]},
    }  # fmt: skip


def counted(name: str, init: Callable[..., None], made: list[str]) -> Callable[..., None]:
    """A constructor that notes what it makes."""

    def noted(*given: Any) -> None:
        made.append(name)
        init(*given)

    return noted


def test_a_run_for_which_nothing_is_asked_has_no_monitor_tracer_or_generator(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = list[str]()
    for kind in (InvariantMonitor, MessageTracer, CellStreams):
        monkeypatch.setattr(kind, "__init__", counted(kind.__name__, kind.__init__, made))
    for firmware in (Counting, Gossip):
        _summary(_scene(4, firmware=firmware), tmp_path / f"plain {firmware.__name__}")
    assert made == []
    _summary(_scene(4), tmp_path / "checked", check="count")
    _summary(_scene(4, firmware=Gossip), tmp_path / "traced", trace_messages="all")
    assert made == ["InvariantMonitor", "MessageTracer"]


def test_counted_violations_fail_the_run_at_its_end(tmp_path: Path) -> None:
    found = _summary(_scene(4, rows=2), tmp_path, check="count")
    assert (found["status"], found["ticks"]) == ("failed", 20)
    assert found["check"]["by_rule"] == {"the number never exceeds 12": 20}
    assert found["reason"].endswith("; 20 violations in all")


def test_a_run_has_the_violations_of_a_lab(tmp_path: Path) -> None:
    faults = [
        {"kind": "link_down", "at_tick": 2, "until_tick": 12, "cell": [0, 3], "direction": "in"},
        {"kind": "crash", "at_tick": 5, "cell": [0, 7]},
        {"kind": "crash", "at_tick": 0, "cell": [0, 5]},
        {"kind": "reboot", "at_s": 0.06, "delay_s": 0.005, "cell": [0, 0]},
    ]
    scene = _scene(9, ticks=40, faults=faults, initial_registers={"most": {"0,4": 20}})
    lab = Lab.of(scene, check="count").step(40)
    found = _summary(scene, tmp_path, check="count")
    assert {one.kind for one in lab.violations} == {"always", "eventually"}
    assert found["check"]["first"] == [one.as_json() for one in lab.violations]


def test_a_condition_is_due_later_where_messages_take_several_ticks(tmp_path: Path) -> None:
    lab = Lab("hop_gradient", (1, 6), parameters={"goals": [{"cell": [0, 0]}], "limit": 6}, check=None)
    late = {"bus": BusSpec(link_ticks=8), "duration_s": 250 * lab.scene.tick_ns / 10**9}
    assert _summary(lab.scene.model_copy(update=late), tmp_path, check="stop")["status"] == "ok"


def test_a_run_without_violations_is_ok_and_has_the_digest_of_one_that_is_not_checked(tmp_path: Path) -> None:
    scene = _scene(3)
    checked = _summary(scene, tmp_path / "a", check="stop")
    plain = _summary(scene, tmp_path / "b")
    assert checked["status"] == plain["status"] == "ok"
    assert checked["check"] == {"violations": 0, "by_rule": {}, "first": []}
    assert plain["check"] is None
    assert checked["digest"] == plain["digest"]
    assert plain["messages"]["sent"] < checked["messages"]["sent"]  # registers, which nobody sends unasked


def test_a_program_without_conditions_can_not_be_checked(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match=r"--check: the program .*Gossip has no conditions: it defines neither"
    ):
        _summary(_scene(3, firmware=Gossip), tmp_path, check="stop")


def test_the_command_exits_with_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "scene.toml"
    Lab(Counting, (2, 4), check=None).step(5).save_scene(path)
    options = ["run", str(path), "--processes", "0", "--transport", "memory", "--no-picture", "-q"]
    assert cli.main([*options, "--output", str(tmp_path / "out"), "--check"]) == 1
    assert "mdms: failed: tick 0: 'the number never exceeds 12' is broken at 1,3" in capsys.readouterr().err


def test_a_case_of_a_campaign_fails_with_the_violation() -> None:
    assert run_case(_scene(4, rows=2)).status == "ok"
    case = run_case(_scene(4, rows=2), check=True)
    assert (case.status, case.reason.partition(" is ")[0]) == (
        "failed",
        "tick 0: 'the number never exceeds 12'",
    )
