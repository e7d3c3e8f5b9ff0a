"""Latency as part of the model: drives act later, messages are read later, the same in every partition."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bus.spec import BusSpec
from deploy.checkpoints.checkpointer import Checkpointer
from deploy.checkpoints.store import CheckpointStore, find_checkpoint, options_of, scene_of
from deploy.recordings.reader import load
from deploy.runs.backends import InProcess
from deploy.runs.run import run
from deploy.runs.simulation import Simulation
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene
from deploy.workers.plan import RunOptions
from plant.process import PlantProcess
from tests.system.schedules import Schedule, carry_out
from tests.system.test_same_digest import CRASHES, EACH, TALKERS, WAYS, Way

CLOCKWORK = """
import numpy as np
from cell_firmware.cell import CellFirmware, CellOutputs

class Clockwork(CellFirmware):
    message = np.dtype([("sent", "<i4")])

    def init(self, cell):
        return (0, -1)

    def step(self, state, inputs):
        tick, _ = state
        ages = {tick - int(word["sent"]) for word in inputs.inbox.values() if word is not None}
        age = ages.pop() if len(ages) == 1 else -1
        return (tick + 1, age), CellOutputs((tick / 1024, age / 1024), dict.fromkeys(inputs.inbox, {"sent": tick}))
"""
"""Firmware that drives the number of its tick, and the age of the messages that it reads."""


def _scene(small: Callable[[str], Path], firmware: str, bus: BusSpec, more: str = "") -> Scene:
    path = small(more)
    (path.parent / "program.py").write_text(firmware)
    given = {"firmware": str(path.parent / "program.py")}
    return load_scene(str(path), [Override(("cells",), given, ""), Override(("bus",), bus.model_dump(), "")])


def _digest(scene: Scene, way: Way, output: Path) -> str:
    processes, transport, wire = way
    outcome = run(scene, RunOptions(processes, transport, wire, output=output, picture=False), quiet=True)
    assert outcome.summary.status == "ok", (way, outcome)
    return outcome.summary.digest


@pytest.mark.parametrize(("drive_ticks", "link_ticks"), [(0, 1), (3, 1), (0, 4), (5, 3), (2, 7)])
def test_drives_act_and_messages_are_read_after_the_scenes_ticks(
    drive_ticks: int, link_ticks: int, small: Callable[[str], Path], tmp_path: Path
) -> None:
    scene = _scene(small, CLOCKWORK, BusSpec(sense_to_drive_ticks=drive_ticks, link_ticks=link_ticks))
    options = RunOptions(2, output=tmp_path, picture=False, registers=1, trace_messages="all")
    assert run(scene, options, quiet=True).summary.status == "ok"
    recording = load(tmp_path)
    drives = recording.drives
    ticks = np.arange(len(drives) - 1)
    sensed = ticks - drive_ticks
    assert (drives[:-1, :, 0] == np.where(sensed < 0, 0, sensed)[:, None] / 1024).all()
    age = np.where(sensed < 0, 0, np.where(sensed < link_ticks, -1, link_ticks))
    assert (drives[:-1, :, 1] == age[:, None] / 1024).all()
    traced = recording.traced_messages()
    read = [one for one in traced if one.fate == "read" and one.sent_tick is not None]
    assert {one.read_tick - one.sent_tick for one in read if one.read_tick is not None} == {link_ticks}
    assert {one.fate for one in traced} == {"read", "under way"}
    assert {one.sent_tick for one in traced} == set(ticks.tolist())


LATENCIES = [
    BusSpec(sense_to_drive_ticks=3, link_ticks=4),
    BusSpec(sense_to_drive_ticks=4, link_ticks=2),
    BusSpec(sense_to_drive_ticks=2),
    BusSpec(link_ticks=3),
]


@pytest.mark.slow
@pytest.mark.parametrize("bus", LATENCIES, ids=lambda bus: f"{bus.sense_to_drive_ticks},{bus.link_ticks}")
def test_delayed_runs_with_crashes_are_alike_however_the_scene_is_cut(
    bus: BusSpec, small: Callable[[str], Path], tmp_path: Path
) -> None:
    scene = _scene(small, TALKERS, bus, CRASHES.format(policy="hold"))
    digests = {way: _digest(scene, way, tmp_path) for way in [WAYS[0], WAYS[4], WAYS[7], *EACH]}
    with Simulation.open(scene, InProcess()) as simulation:
        assert simulation.run().status == "ok"
    assert len(set(digests.values())) == 1, digests
    prompt = scene.model_copy(update={"bus": BusSpec()})
    assert _digest(prompt, WAYS[0], tmp_path) not in digests.values()


@pytest.mark.slow
def test_compiled_boards_act_alike_with_latency_however_the_scene_is_cut(tmp_path: Path) -> None:
    changes = ("duration_s=0.15", "bus.sense_to_drive_ticks=2", "bus.link_ticks=3")
    scene = load_scene("prototype", [Override.parse(change) for change in changes])
    digests = {way: _digest(scene, way, tmp_path) for way in [WAYS[0], WAYS[4], WAYS[7], EACH[0], EACH[2]]}
    assert len(set(digests.values())) == 1, digests


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_runs_that_lose_processes_are_repeated_with_latency(seed: int, tmp_path: Path) -> None:
    schedule = replace(Schedule.drawn(1_000 + seed), bus=LATENCIES[seed % len(LATENCIES)])
    verdict = carry_out(schedule, tmp_path)
    assert not verdict.wrong, (schedule, verdict)


LAST = """
[[faults]]
at_s = 0.45
cell = [0, 0]
[[faults]]
at_s = 0.4505
cell = [2, 3]
"""
"""Deaths shortly before the last checkpoint."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("way", "bus"),
    [
        ((2, "zenoh", "packed"), LATENCIES[0]),
        (EACH[0], LATENCIES[1]),
        (EACH[2], LATENCIES[0]),
        ((0, "memory", "packed"), LATENCIES[2]),
    ],
    ids=["packed", "per_cell", "relayed", "memory"],
)
def test_a_run_goes_on_from_a_checkpoint_with_drives_and_messages_under_way(
    way: Way, bus: BusSpec, small: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(CheckpointStore, "clear", lambda _: None)
    scene = _scene(small, TALKERS, bus, LAST).model_copy(update={"duration_s": 0.5})
    processes, transport, wire = way
    options = RunOptions(processes, transport, wire, output=tmp_path, picture=False, checkpoint_s=1e-3)
    whole = run(scene, options, quiet=True).summary
    assert whole.status == "ok"
    (tmp_path / "summary.json").unlink()
    checkpoint = find_checkpoint(tmp_path)
    again = options_of(checkpoint, RunOptions(output=tmp_path, picture=False))
    resumed = run(scene_of(checkpoint), again, quiet=True, resumed=checkpoint).summary
    assert resumed.digest == whole.digest
    # how much still comes from a dropped cell is a matter of the wall clock
    assert replace(resumed.messages, late=0) == replace(whole.messages, late=0)


@pytest.mark.slow
@pytest.mark.parametrize("bus", [LATENCIES[0], LATENCIES[2]], ids=["ahead", "prompt"])
@pytest.mark.parametrize("after", range(-1, 5))
def test_payloads_are_counted_alike_from_a_checkpoint_just_after_a_death(
    after: int, bus: BusSpec, small: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = _scene(small, TALKERS, bus, LAST).model_copy(update={"duration_s": 0.5})
    requested = scene.tick_at(0.45) + after - 1

    def only_once(checkpointer: Checkpointer, process: PlantProcess) -> None:
        due = process.tick == requested
        monkeypatch.setattr(checkpointer, "_last", -math.inf if due else math.inf)
        before_tick(checkpointer, process)

    before_tick = Checkpointer.before_tick
    monkeypatch.setattr(CheckpointStore, "clear", lambda _: None)
    monkeypatch.setattr(Checkpointer, "before_tick", only_once)
    whole = run(
        scene, RunOptions("each", output=tmp_path, picture=False, checkpoint_s=1e9), quiet=True
    ).summary
    (tmp_path / "summary.json").unlink()
    checkpoint = find_checkpoint(tmp_path)
    assert checkpoint.tick == requested + 1
    again = options_of(checkpoint, RunOptions(output=tmp_path, picture=False))
    resumed = run(scene_of(checkpoint), again, quiet=True, resumed=checkpoint).summary
    assert replace(resumed.messages, late=0) == replace(whole.messages, late=0)


@pytest.mark.slow
def test_cells_with_clocks_and_repairs_are_alike_with_latency(
    small: Callable[[str], Path], tmp_path: Path
) -> None:
    repaired = '\n[[faults]]\nkind = "crash"\nat_s = 0.05\nuntil_s = 0.058\ncell = [1, 2]\n'
    scene = _scene(small, TALKERS, BusSpec(sense_to_drive_ticks=4, link_ticks=3), repaired)
    with_clocks = Override(
        ("effects",), {"clock": {"error_ppm": 60_000.0, "exchanges_per_period": 2}, "motors": {}}, ""
    )
    path = small(repaired)
    given = {"firmware": str(path.parent / "program.py")}
    clocked = load_scene(
        str(path),
        [Override(("cells",), given, ""), Override(("bus",), scene.bus.model_dump(), ""), with_clocks],
    )
    for one in (scene, clocked):
        digests = {way: _digest(one, way, tmp_path) for way in [WAYS[0], WAYS[7], EACH[2]]}
        with Simulation.open(one, InProcess()) as simulation:
            assert simulation.run().status == "ok"
        assert len(set(digests.values())) == 1, digests
