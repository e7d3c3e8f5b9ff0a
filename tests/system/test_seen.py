"""What scanners and a camera tell cells is the same however a scene is cut, and only theirs who subscribe."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from bus.wire.keys import WireFormat
from deploy.runs.run import run
from deploy.runs.summary import Summary
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene
from deploy.workers.plan import Processes, RunOptions, Transport

PLAIN = """
from cell_firmware.cell import CellFirmware, CellOutputs

class Watcher(CellFirmware):
    def uses_camera(self):
        return True

    def init(self, cell):
        return (0.0, 0.0)

    def step(self, last, inputs):
        if inputs.camera is not None:
            x, y, angle = inputs.camera[0]
            last = (0.2 * x + 0.01 * len(inputs.camera), 0.1 * angle)
        return last, CellOutputs((last[0] + 0.03 * inputs.label, last[1]))
"""

ARRAYS = """
import numpy as np
from cell_firmware.firmware import Firmware, Outputs

class Watcher(Firmware):
    def uses_camera(self):
        return True

    def init(self, cells):
        return {"last": np.zeros((len(cells), 2))}

    def step(self, state, inputs):
        last = state["last"]
        if inputs.camera is not None:
            x, y, angle = inputs.camera.pose[0]
            last = np.tile((0.2 * x + 0.01 * len(inputs.camera.parcel), 0.1 * angle), (len(last), 1))
        speed = last.copy()
        speed[:, 0] += 0.03 * inputs.label
        return {"last": last}, Outputs(speed)
"""
DEAF = """
from cell_firmware.cell import CellFirmware, CellOutputs

class Deaf(CellFirmware):
    def init(self, cell):
        return None

    def step(self, state, inputs):
        assert inputs.camera is None
        return None, CellOutputs((0.05 * inputs.label, 0.0))
"""
EXITS = [
    {"name": name, "size_m": [0.05, 0.05], "position_m": [0.9, y]} for name, y in (("a", 0.5), ("b", -0.5))
]
EFFECTS = {
    "feeders": {"exits": EXITS},
    "scanners": {"cells": [[0, 0], [1, 1], [1, 2], [2, 1]]},
    "camera": {"period_s": 0.02, "latency_s": 0.005, "position_noise_m": 0.01, "angle_noise_rad": 0.1},
}
ONE_PROCESS: tuple[Processes, Transport, WireFormat] = (0, "memory", "packed")
WAYS: list[tuple[Processes, Transport, WireFormat]] = [
    ONE_PROCESS,
    (0, "memory", "per_cell"),
    (2, "zenoh", "packed"),
    (2, "zenoh", "per_cell"),
    ("each", "zenoh", "per_cell"),
]


@pytest.fixture
def scene_with(small: Callable[[str], Path], tmp_path: Path) -> Callable[..., Scene]:
    """A scene with a parcel for exit b, whose cells run a program."""

    def make(text: str, **more: object) -> Scene:
        (tmp_path / "program.py").write_text(text)
        given = {
            ("cells",): {"firmware": str(tmp_path / "program.py")},
            ("effects",): {**EFFECTS, **more},
            ("parcels", 0, "destination"): "b",
        }
        return load_scene(str(small("")), [Override(path, value, "") for path, value in given.items()])

    return make


def summary_of(scene: Scene, way: tuple[Processes, Transport, WireFormat], output: Path) -> Summary:
    processes, transport, wire = way
    options = RunOptions(processes, transport, wire, output=output, picture=False)
    found = run(scene, options, quiet=True).summary
    assert found.status == "ok", found
    return found


@pytest.mark.slow
@pytest.mark.parametrize("clocks", [{}, {"clock": {"error_ppm": 50_000.0}}], ids=["one clock", "own clocks"])
def test_labels_and_pictures_reach_cells_alike_in_every_process_form_and_program(
    clocks: dict[str, object], scene_with: Callable[..., Scene], tmp_path: Path
) -> None:
    digests = {
        (way, text): summary_of(scene_with(text, **clocks), way, tmp_path).digest
        for text in (PLAIN, ARRAYS)
        for way in (WAYS if text == PLAIN and not clocks else WAYS[:3])
    }
    assert len(set(digests.values())) == 1, digests
    blind = summary_of(scene_with(DEAF, **clocks), ONE_PROCESS, tmp_path).digest
    assert blind not in digests.values()


def test_what_a_camera_is_off_by_is_the_seeds_and_changes_nothing_for_who_does_not_subscribe(
    scene_with: Callable[..., Scene], tmp_path: Path
) -> None:
    def parcels(text: str, seed: int) -> object:
        scene = scene_with(text).model_copy(update={"seed": seed})
        return summary_of(scene, ONE_PROCESS, tmp_path).parcels

    assert parcels(PLAIN, 1) == parcels(PLAIN, 1) != parcels(PLAIN, 2)
    assert parcels(DEAF, 1) == parcels(DEAF, 2)
