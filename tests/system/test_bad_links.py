"""The plant in one network namespace, the cells in another, a bad link between them."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from deploy.recordings.reader import load
from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.workers.plan import RunOptions
from tests.system.joining import command, plant_command
from tests.system.relay import CELLS, PLANT, Relay

Small = Callable[..., Path]
PATIENT = "[stall]\nlease_s = 10.0\ndeadline_s = 20.0\n"


def _run_apart(scene: Path, folder: Path, relay: Relay, *, cut_s: float) -> tuple[dict[str, Any], float]:
    """Run a scene over the relay, with one cut in the middle; returns its summary and its wall time."""
    endpoint = f"tcp/{PLANT}:7447"
    with relay:
        plant = relay.start(PLANT, CELLS, plant_command(scene, endpoint, "each", folder / "out"))
        relay.start(CELLS, PLANT, command(scene, endpoint, "each", "small"))
        relay.go()
        recording = folder / "out" / "recording.mcap"
        begun = time.monotonic()
        while not (recording.exists() and recording.stat().st_size > 12_000):
            assert plant.poll() is None, plant.communicate()
            assert time.monotonic() < begun + 60.0
            time.sleep(0.02)
        relay.cut_for(cut_s)
        cut = time.monotonic()
        stdout, stderr = plant.communicate(timeout=60.0)
        assert plant.returncode == 0, stderr
        return json.loads(stdout), time.monotonic() - cut


@pytest.mark.slow
def test_delay_loss_and_a_cut_of_three_seconds_cost_time_and_nothing_else(
    small: Small, tmp_path: Path
) -> None:
    scene = small(PATIENT)
    expected = run(
        load_scene(str(scene)), RunOptions(0, "memory", output=tmp_path / "near", picture=False), quiet=True
    )
    relay = Relay(delay_s=0.02, loss=0.01, seed=1)
    summary, after_s = _run_apart(scene, tmp_path, relay, cut_s=3.0)
    assert (summary["status"], summary["cells_lost"], summary["faults"]) == ("ok", [], [])
    assert (summary["messages"]["lost"], summary["messages"]["late"]) == (0, 0)
    assert summary["digest"] == expected.summary.digest
    assert load(tmp_path / "out").tick.tolist() == list(range(summary["ticks"] + 1))
    assert after_s > 3.0
    assert relay.lost > 0
    assert relay.cut > 0
