"""The scene ``tree``: a parcel is carried to the elected root, and to the next one when the root has died."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cell_firmware.protocols.spanning_tree import SpanningTree
from deploy.recordings.reader import load
from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.workers.plan import RunOptions
from deploy.workers.worker import compile_program

ROOTS_M = ((0.4, -0.2), (-0.4, 0.2))
DIES_S = 8.0


def test_its_program_is_compiled_ahead_of_a_run_and_not_where_the_scene_is_read(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    compiled: list[str] = []
    monkeypatch.setattr(SpanningTree, "scalar_kernels", lambda program: compiled.append(program.form))
    scene = load_scene("tree")
    assert compiled == []
    compile_program(scene)
    assert compiled == ["compiled"]
    compile_program(load_scene("elliptic"))
    assert compiled == ["compiled"]


@pytest.mark.slow
def test_the_parcel_comes_near_the_first_root_and_after_its_death_near_the_second(tmp_path: Path) -> None:
    scene = load_scene("tree")
    options = RunOptions(0, "memory", output=tmp_path, picture=False, check="stop")
    summary = run(scene, options, quiet=True).summary
    assert summary.status == "ok", summary.reason
    places = load(tmp_path).run_trace().parcels[:, 0, :2]
    tick = int(DIES_S / scene.cells.period_s)
    first, second = (np.hypot(*(places - root).T) for root in ROOTS_M)
    assert first[:tick].min() < 0.15
    assert second[tick - 1] > 0.5
    assert second[-1] < 0.1
