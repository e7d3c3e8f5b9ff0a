"""The whole system in one process: what a run returns and leaves behind."""

from __future__ import annotations

import json
import os
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deploy import cli
from deploy.commands.outcome import EXIT_STATUS
from deploy.errors import InputError
from deploy.recordings.reader import load
from deploy.recordings.writer import Recorder
from deploy.runs.run import run
from deploy.runs.summary import Outcome, ProtocolMessages
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene
from deploy.workers.plan import RunOptions
from plant.errors import PlantUnstable
from plant.plant import Plant


def _scene(duration_s: float = 0.1, **values: object) -> Scene:
    overrides = [Override((key,), value, "") for key, value in values.items()]
    return load_scene("motors", [Override(("duration_s",), duration_s, ""), *overrides])


def _run(scene: Scene, output: Path, **options: Any) -> Outcome:
    return run(scene, RunOptions(0, "memory", output=output, picture=False, **options), quiet=True)


def test_the_json_object_has_what_programs_rely_on(tmp_path: Path) -> None:
    found = json.loads(_run(_scene(), tmp_path).summary.to_json())
    assert set(found) >= {
        "status", "scene", "seed", "duration_s", "cells", "processes", "transport", "solver", "ticks", "wall_s",
        "startup_s", "ticks_per_s", "realtime_factor", "parcels", "support_changes", "messages", "faults",
        "cells_lost", "digest", "output",
    }  # fmt: skip
    assert (found["status"], found["scene"], found["cells"], found["ticks"]) == ("ok", "motors", 18, 25)
    assert set(found["messages"]) >= {"sent", "delivered", "lost", "late"}
    assert set(found["parcels"][0]) >= {
        "position_m", "angle_rad", "velocity_m_s", "angular_velocity_rad_s", "state", "time_s"
    }  # fmt: skip
    assert found == json.loads((tmp_path / "summary.json").read_text())


def test_messages_of_cells_and_frames_on_the_bus_are_counted_apart(tmp_path: Path) -> None:
    assert _run(_scene(), tmp_path).summary.messages.protocol is None  # velocity_field: cells don't talk
    changes = ("duration_s=0.1", "array.rows=2", "array.columns=3", "parcels=[]", "cells.parameters={}")
    scene = load_scene("heat", [Override.parse(text) for text in changes])
    messages = _run(scene, tmp_path).summary.messages
    ticks, links = 25, 14
    assert messages.protocol == ProtocolMessages(sent=ticks * links, received=(ticks - 1) * links)
    assert messages.sent == messages.delivered > 2 * ticks  # senses and drives, start and stop


def test_the_summary_says_whether_cells_run_on_arrays_or_one_by_one(tmp_path: Path) -> None:
    (tmp_path / "idle.py").write_text(
        "import numpy as np\n"
        "from cell_firmware.cell import CellFirmware, CellOutputs\n"
        "class Idle(CellFirmware):\n"
        "    message = np.dtype([('a', '<u2'), ('b', '?')])\n"
        "    def init(self, cell): return None\n"
        "    def step(self, state, inputs): return state, CellOutputs((0.0, 0.0))\n"
    )
    scene = _scene(cells={"firmware": str(tmp_path / "idle.py")})
    said = _run(scene, tmp_path / "idle").summary.firmware
    assert said == {"name": "idle.py", "form": "cell by cell", "message_bytes": 3}
    said = _run(_scene(), tmp_path / "motors").summary.firmware
    assert said == {"name": "velocity_field", "form": "on arrays", "message_bytes": 0}


def test_the_recording_begins_with_the_scene_and_ends_as_the_summary_does(tmp_path: Path) -> None:
    scene = _scene()
    summary = _run(scene, tmp_path).summary
    recording = load(tmp_path)
    assert recording.status == "ok"
    assert recording.digest == summary.digest
    assert recording.tick.tolist() == list(range(26))
    assert recording.time_ns[-1] == 100_000_000
    assert recording.parcels[0, 0].tolist() == [-0.19, 0.02, 0.15, 0.0, 0.0, 0.0]
    assert recording.parcels[-1, 0, :2].tolist() == list(summary.parcels[0].position_m)
    assert recording.header["scene"]["duration_s"] == 0.1
    assert not np.any(recording.wheel_speeds[0])
    assert np.any(recording.wheel_speeds[-1])


def test_motion_that_cannot_be_followed_is_unstable_and_exits_with_3(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    advance = Plant.advance

    def runs_away(plant: Plant, drives: Any, until_ns: int, **how: Any) -> Any:
        if plant.time_ns >= 40_960_000:
            raise PlantUnstable("parcel 0 at t = 0.041 s: the motion is no longer finite")
        return advance(plant, drives, until_ns, **how)

    monkeypatch.setattr(Plant, "advance", runs_away)
    summary = _run(_scene(), tmp_path).summary
    assert (summary.status, EXIT_STATUS[summary.status], summary.ticks) == ("unstable", 3, 10)
    assert summary.reason == "parcel 0 at t = 0.041 s: the motion is no longer finite (tick 10)"
    recording = load(tmp_path)
    assert (recording.status, recording.digest) == ("unstable", summary.digest)


def test_a_plant_that_refuses_the_scene_starts_nothing(tmp_path: Path) -> None:
    parcel = {"size_m": [0.5, 0.4], "mass_kg": 3.0, "position_m": [9.0, 9.0]}
    with pytest.raises(InputError, match=r"^scene motors: parcels\[0\]\.position_m = .* stands on nothing"):
        _run(_scene(parcels=[parcel]), tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
@pytest.mark.parametrize(("full_at", "ticks"), [(15, 15), (24, 25)], ids=["midway", "at the end"])
def test_a_disk_that_fills_up_fails_the_run_and_leaves_what_was_recorded_and_the_summary(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, full_at: int, ticks: int
) -> None:
    tick = Recorder.tick

    def fill(recorder: Recorder, number: int, *more: Any) -> None:
        if number == full_at:
            recorder.flush()
            full = os.open("/dev/full", os.O_WRONLY)
            os.dup2(full, recorder._file._stream.fileno())
            os.close(full)
        tick(recorder, number, *more)
        if full_at < 24:
            recorder.flush()

    monkeypatch.setattr(Recorder, "tick", fill)
    summary = _run(_scene(), tmp_path).summary
    assert summary.status == "failed"
    assert (
        summary.reason == f"can't write the recording {tmp_path / 'recording.mcap'}: No space left on device"
    )
    assert summary.ticks == ticks
    assert json.loads((tmp_path / "summary.json").read_text())["reason"] == summary.reason
    recording = load(tmp_path)
    assert not recording.complete
    assert recording.tick.tolist() == list(range(full_at))


def test_a_summary_that_can_not_be_written_fails_the_run_and_is_returned_all_the_same(tmp_path: Path) -> None:
    (tmp_path / f".summary.json.{os.getpid()}.draft").mkdir()
    summary = _run(_scene(), tmp_path).summary
    assert (summary.status, summary.simulated_s) == ("failed", 0.1)
    assert summary.reason == f"can't write {tmp_path / 'summary.json'}: Is a directory"
    assert load(tmp_path).status == "ok"


def test_a_replay_over_what_it_repeats_is_refused(tmp_path: Path) -> None:
    _run(_scene(), tmp_path)
    before = (tmp_path / "recording.mcap").read_bytes()
    for replay in (tmp_path, tmp_path / "recording.mcap"):
        with pytest.raises(InputError, match=r"--replay .* would be overwritten by --output"):
            _run(_scene(), tmp_path / ".." / tmp_path.name, replay=replay)
    assert (tmp_path / "recording.mcap").read_bytes() == before


def test_a_run_that_goes_on_can_be_plotted_and_nothing_else_may_write_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tick, statuses = Recorder.tick, list[int]()

    def meanwhile(recorder: Recorder, number: int, *state: Any) -> None:
        tick(recorder, number, *state)
        if number == 5:
            recorder.flush()
            monkeypatch.setattr(Recorder, "tick", tick)
            other = ["run", "motors", "--processes", "0", "--transport", "memory", "--output", str(tmp_path)]
            statuses.extend((cli.main(["plot", str(tmp_path)]), cli.main(other)))
            statuses.append(cli.main(["run", "--resume", str(tmp_path)]))

    monkeypatch.setattr(Recorder, "tick", meanwhile)
    summary = _run(_scene(), tmp_path).summary
    assert statuses == [0, 2, 2]
    assert (tmp_path / "overview.png").exists()
    assert (summary.status, load(tmp_path).digest) == ("ok", summary.digest)


def test_an_unforeseen_error_still_ends_everything_and_closes_the_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(plant: Plant, drives: Any, until_ns: int, **how: Any) -> Any:
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(Plant, "advance", broken)
    threads = set(threading.enumerate())
    with pytest.raises(ZeroDivisionError):
        _run(_scene(), tmp_path)
    assert set(threading.enumerate()) <= threads
    assert load(tmp_path).status == "failed"


def test_a_run_leaves_no_thread_behind(tmp_path: Path) -> None:
    threads = set(threading.enumerate())
    _run(_scene(), tmp_path)
    assert set(threading.enumerate()) <= threads


def test_a_run_works_in_any_thread(tmp_path: Path) -> None:
    statuses: list[str] = []
    thread = threading.Thread(target=lambda: statuses.append(_run(_scene(), tmp_path).summary.status))
    thread.start()
    thread.join(60.0)
    assert statuses == ["ok"]


def test_a_run_keeps_pace_with_the_wall_clock(tmp_path: Path) -> None:
    assert _run(_scene(0.2), tmp_path, realtime=2.0).summary.wall_s >= 0.098  # the last tick begins there


def test_the_picture_is_drawn_from_the_recording(tmp_path: Path) -> None:
    outcome = run(_scene(0.02), RunOptions(0, "memory", output=tmp_path), quiet=True)
    assert outcome.summary.status == "ok"
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "overview.png",
        "recording.mcap",
        "summary.json",
    ]
    assert (tmp_path / "overview.png").read_bytes().startswith(b"\x89PNG")


def test_quiet_says_nothing(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    _run(_scene(0.02), tmp_path)
    assert capfd.readouterr() == ("", "")
