"""Names, folders and headers of what a run leaves behind."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from bus.wire.keys import check_run
from deploy.runs.output import recording_header, run_name, versions
from deploy.runs.output_folder import output_folder
from deploy.scenes.files import load_scene, scene_text
from plant.array import CellArray


def _no_warning(line: str) -> None:
    raise AssertionError(line)


@pytest.mark.parametrize("name", ["elliptic", "./a b/c d.toml", "/x/ä.toml", "-.toml", "x" * 300])
def test_a_run_of_any_scene_gets_a_name_that_can_stand_in_a_key(name: str) -> None:
    scene = load_scene("elliptic").named(name)
    assert check_run(run_name(scene, "0123abcd"))


def test_the_default_folder_is_new_each_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    scene = load_scene("elliptic")
    folders = list[Path]()
    for _ in range(3):
        with output_folder(scene, None, _no_warning) as folder:
            folders.append(folder)
    assert len(set(folders)) == 3
    assert all(re.fullmatch(r"runs/elliptic-\d{8}-\d{6}(-\d)?", str(folder)) for folder in folders)


def test_a_folder_used_again_loses_the_results_of_the_run_before(tmp_path: Path) -> None:
    """The recording stays until the recorder replaces it."""
    for name in (
        *("summary.json", "overview.png", "notes.txt", "recording.mcap", "protocol.csv", "protocol.png"),
        *("checkpoint.msgpack", "checkpoint-before.msgpack", ".checkpoint.msgpack.draft", ".x.png.77.draft"),
    ):
        (tmp_path / name).write_text("old")
    with output_folder(load_scene("elliptic"), tmp_path, _no_warning) as folder:
        assert folder == tmp_path
        left = {".mdms.lock", "notes.txt", "recording.mcap"}
        assert {path.name for path in tmp_path.iterdir()} == left
    assert {path.name for path in tmp_path.iterdir()} == left - {".mdms.lock"}


def test_the_header_has_the_whole_scene_and_where_everything_is(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(scene_text("motors"))
    scene = load_scene(str(path))
    array = CellArray(scene.array)
    rectangle = np.array([[-0.25, -0.2], [0.25, -0.2], [0.25, 0.2], [-0.25, 0.2]])
    made = recording_header("r", scene, array, [rectangle])
    assert made["cells"][:3] == [[0, 0], [0, 1], [0, 3]]
    assert np.array_equal(made["positions_m"], array.positions_m)
    assert made["footprints_m"] == [rectangle.tolist()]
    assert made["scene"]["duration_s"] == 10.0
    assert {"python", "numpy", "numba", "eclipse-zenoh"} <= set(made["versions"])
    assert made["versions"] == versions()
