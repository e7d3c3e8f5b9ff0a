"""The bundled scene whose array falls in two for a while."""

from __future__ import annotations

from pathlib import Path

from deploy.recordings.reader import load
from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.workers.plan import RunOptions

HEALS_S = 0.8


def test_no_speed_crosses_the_line_before_it_heals_and_speed_does_then(tmp_path: Path) -> None:
    changes = {("duration_s",): 1.0, ("faults", 0, "until_s"): HEALS_S}
    scene = load_scene("partition", [Override(path, value, "") for path, value in changes.items()])
    run(scene, RunOptions(0, "memory", output=tmp_path, picture=False), quiet=True)
    recording = load(tmp_path)
    drives = recording.held_drives.all()[:, :, 0].reshape(-1, 10, 20)
    heals = scene.tick_at(HEALS_S)
    assert not drives[:heals, :, 10:].any()
    assert (drives[heals, :, 9] > 0.1).all()
    assert (drives[heals, :, 10] > 0.0).all()
