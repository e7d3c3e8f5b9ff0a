"""Faults of programs, sensors and links do alike however a scene is cut, and cost nothing where a scene has none."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from deploy.faults.registry import KINDS
from deploy.runs.run import run
from deploy.runs.summary import Summary
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene
from deploy.workers.plan import RunOptions
from tests.system.test_same_digest import EACH, TALKERS, WAYS, Way

ROOT = Path(__file__).parents[2]
FAULTS: list[dict[str, Any]] = [
    {"kind": "hang", "cell": [0, 1], "at_s": 0.01, "until_s": 0.06},
    {"kind": "reboot", "cell": [1, 2], "at_s": 0.04, "delay_s": 0.02},
    {"kind": "slow_clock", "cell": [2, 0], "factor": 0.3},
    {"kind": "sensor_stuck", "cell": [2, 2], "value": 1},
    {"kind": "sensor_flip", "share": 0.5, "rate": 0.2},
    {"kind": "sensor_delay", "share": 1.0, "ticks": 2, "at_s": 0.02},
    {"kind": "link_down", "cell": [1, 1], "side": "north", "until_s": 0.1},
    {"kind": "link_loss", "share": 0.4, "probability": 0.2},
    {"kind": "link_loss", "share": 0.4, "probability": 0.2, "burst_ticks": 3.0},
    {"kind": "link_delay", "share": 0.4, "between_ticks": [0, 3], "ordered": False},
    {"kind": "link_duplicate", "share": 0.5, "probability": 0.5},
    {"kind": "link_reorder", "share": 0.4, "probability": 0.2, "ticks": 2},
    {"kind": "link_corrupt", "share": 1.0, "probability": 0.2, "bits": 2},
    {"kind": "link_bandwidth", "cell": [0, 2], "messages_per_s": 100.0, "queue": 2},
    {"kind": "babble", "cell": [2, 1], "at_s": 0.05, "until_s": 0.09},
    {"kind": "lie", "cell": [0, 0], "mode": "random"},
    {"kind": "partition", "column": 1, "at_s": 0.1, "until_s": 0.13},
]


def ran(scene: Scene, way: Way, output: Path) -> Summary:
    processes, transport, wire = way
    options = RunOptions(processes, transport, wire, output=output, picture=False)
    return run(scene, options, quiet=True).summary


def talkers(small: Callable[..., Path], folder: Path, **changes: Any) -> Scene:
    # a program that believes any number comes to none: what it hears is kept to what its wheels can do
    text = TALKERS.replace(
        "        heat +=", "        heard = [max(-9.0, min(9.0, one)) for one in heard]\n        heat +="
    )
    (folder / "talkers.py").write_text(text)
    firmware = Override(("cells",), {"firmware": str(folder / "talkers.py")}, "")
    return load_scene(
        str(small()), [firmware, *(Override((key,), value, "") for key, value in changes.items())]
    )


def test_these_are_all_faults_that_cells_carry_out_alone() -> None:
    of_parts = {kind for kind in KINDS if kind.startswith("wheel_") or kind in ("crash", "remove", "add")}
    assert {fault["kind"] for fault in FAULTS} == KINDS.keys() - of_parts


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effects", "ways"),
    [
        ({}, [WAYS[0], WAYS[4], EACH[0]]),
        ({"clock": {"error_ppm": 20_000.0, "exchanges_per_period": 2}}, [WAYS[0], WAYS[7]]),
        (
            {"clock": {}, "serial": {"baud": 41_667}, "cop": {"timeout_s": 0.016384, "reboot_s": 0.01}},
            [WAYS[0], WAYS[7]],
        ),
    ],
    ids=["whole", "own clocks", "board"],
)
def test_all_at_once_do_alike_however_the_scene_is_cut(
    effects: dict[str, Any], ways: list[Way], small: Callable[..., Path], tmp_path: Path
) -> None:
    scene = talkers(small, tmp_path, faults=FAULTS, effects=effects)
    summaries = [ran(scene, way, tmp_path) for way in ways]
    assert {one.status for one in summaries} == {"ok"}
    assert len({one.digest for one in summaries}) == 1
    counted = [
        {name: number for name, number in one.effects.items() if name.startswith("faults.")}
        for one in summaries
    ]
    assert all(one == counted[0] for one in counted)
    kinds = {name.split(".")[1] for name, number in counted[0].items() if number}
    assert kinds - {"words", "restarts"} == {fault["kind"] for fault in FAULTS}


COME_AND_GO: list[dict[str, Any]] = [
    {"kind": "lie", "cell": [0, 1], "mode": "factor", "by": 1.5, "at_s": 0.05, "until_s": 0.12},
    {"kind": "babble", "cell": [2, 2], "at_s": 0.08, "until_s": 0.14},
    {"kind": "hang", "cell": [1, 1], "at_s": 0.09, "until_s": 0.15},
]


@pytest.mark.slow
@pytest.mark.parametrize("effects", [{}, {"clock": {}, "serial": {"baud": 41_667}}], ids=["whole", "board"])
@pytest.mark.parametrize("link_ticks", [1, 2])
def test_cells_that_are_compiled_but_while_faults_act_do_alike_however_the_scene_is_cut(
    effects: dict[str, Any], link_ticks: int, tmp_path: Path
) -> None:
    """With relayed links and a process each, ticks without faults go from payload to payload."""
    changes = {
        "duration_s": 0.25,
        "array.rows": 3,
        "array.columns": 3,
        "cells.parameters.held": [{"columns": [0, 0], "speed_m_s": [0.3, 0.0]}],
        "parcels": [{"size_m": [0.3, 0.25], "mass_kg": 2.0, "position_m": [0.0, 0.03]}],
        "faults": COME_AND_GO,
        "effects": effects,
        "bus.link_ticks": link_ticks,
    }
    scene = load_scene("heat", [Override(tuple(key.split(".")), value, "") for key, value in changes.items()])
    summaries = [ran(scene, way, tmp_path) for way in (WAYS[0], EACH[2], EACH[0])]
    assert {one.status for one in summaries} == {"ok"}
    assert len({one.digest for one in summaries}) == 1
    assert summaries[0].effects["faults.words.refused"] > 0
    assert all(one.effects == summaries[0].effects for one in summaries)


NOTHING = """
import json, sys, tempfile
from pathlib import Path
from deploy.workers.plan import RunOptions
from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
scene = load_scene("heat", [Override(("duration_s",), 0.02, "")])
with tempfile.TemporaryDirectory() as folder:
    assert run(scene, RunOptions(output=Path(folder), picture=False), quiet=True).summary.status == "ok"
print(json.dumps([name for name in sys.modules if name.startswith("cell_firmware.faults.")]))
"""
MACHINERY = {"attach", "execution", "messages", "payload_bytes"}


def test_a_scene_without_faults_loads_nothing_that_carries_them_out() -> None:
    assert all(find_spec(f"cell_firmware.faults.{name}") for name in MACHINERY)
    done = subprocess.run(
        [sys.executable, "-c", NOTHING], cwd=ROOT, capture_output=True, text=True, check=True, timeout=60
    )
    loaded = {name.rpartition(".")[2] for name in json.loads(done.stdout.splitlines()[-1])}
    assert loaded & MACHINERY == set()
