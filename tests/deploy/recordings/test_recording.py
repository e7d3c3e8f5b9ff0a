"""A recording gives back what was put in, whatever happened to the file in between."""

from __future__ import annotations

import json
import re
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from deploy.errors import DeployError, InputError
from deploy.recordings.digest import Digest
from deploy.recordings.format import PARCELS, Header
from deploy.recordings.info import recording_info
from deploy.recordings.reader import load
from deploy.recordings.recording import Recording
from deploy.recordings.writer import Recorder

Make = Callable[..., Any]


def assert_holds(recording: Recording, run: Any, rows: int) -> None:
    """The first rows of the run, bit for bit."""
    assert recording.tick.tolist() == list(range(rows))
    assert recording.time_ns.tolist() == [tick * 4_096_000 for tick in range(rows)]
    acting = min(rows, run.ticks)
    np.testing.assert_array_equal(recording.presence, run.presence[:rows])
    np.testing.assert_array_equal(recording.drives[:acting], run.drives[:acting])
    np.testing.assert_array_equal(recording.wheel_speeds, run.wheel_speeds[:rows])
    np.testing.assert_array_equal(recording.parcels, run.states[:rows])


@pytest.mark.parametrize("wheels_change", [False, True])
@pytest.mark.parametrize(("sensors", "parcels"), [(1, 0), (1, 1), (5, 3)])
def test_all_that_was_recorded_comes_back_bit_for_bit(
    tmp_path: Path, made_up_run: Make, wheels_change: bool, sensors: int, parcels: int
) -> None:
    run = made_up_run(sensors=sensors, parcels=parcels, wheels_change=wheels_change)
    recording = load(run.record(tmp_path))
    assert_holds(recording, run, run.ticks + 1)
    assert recording.header == run.header
    assert recording.status == "ok"
    assert recording.complete
    assert recording.digest == "ab" * 32


@pytest.mark.parametrize("wheels_change", [False, True])
def test_wheels_at_the_speed_of_the_drives_before_take_no_room(
    tmp_path: Path, made_up_run: Make, wheels_change: bool
) -> None:
    size: list[int] = []
    for follow in (False, True):
        run = made_up_run(ticks=40, rows=20, wheels_change=wheels_change, wheels_follow=follow)
        path = run.record(tmp_path / str(follow))
        assert_holds(load(path), run, run.ticks + 1)
        size.append(path.stat().st_size)
    values = run.wheel_speeds[0].nbytes
    assert size[0] - size[1] > (0.9 * 39 * values if wheels_change else -0.1 * values)


def test_a_recording_of_the_format_before_is_read(
    tmp_path: Path, made_up_run: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("deploy.recordings.mcap.FORMAT", 2)
    run = made_up_run(wheels_change=True)
    path = run.record(tmp_path)
    assert_holds(load(path), run, run.ticks + 1)
    assert recording_info(path).format == 2


@pytest.mark.parametrize("version", [1, 4])
def test_a_recording_of_another_format_is_refused_with_both_numbers(
    tmp_path: Path, made_up_run: Make, monkeypatch: pytest.MonkeyPatch, version: int
) -> None:
    monkeypatch.setattr("deploy.recordings.mcap.FORMAT", version)
    with pytest.raises(
        InputError, match=f"a recording of format {version}: this version reads formats 2 and 3"
    ):
        load(made_up_run().record(tmp_path))


def test_the_end_repeats_the_last_drives(tmp_path: Path, made_up_run: Make) -> None:
    run = made_up_run(wheels_change=True)
    recording = load(run.record(tmp_path))
    np.testing.assert_array_equal(recording.drives[-1], run.drives[run.ticks - 1])


def test_constant_wheels_are_written_once(tmp_path: Path, made_up_run: Make) -> None:
    run = made_up_run(ticks=50)
    recording = load(run.record(tmp_path))
    assert len(recording.held_drives.values) == 1
    assert len(recording.held_wheel_speeds.values) == 1
    np.testing.assert_array_equal(recording.held_drives.at(30), run.drives[30])


def test_constant_wheels_that_follow_constant_drives_are_written_twice(
    tmp_path: Path, made_up_run: Make
) -> None:
    recording = load(made_up_run(ticks=50, wheels_follow=True).record(tmp_path))
    assert len(recording.held_wheel_speeds.values) == 2  # before the first drives, and with them


def test_wheels_that_return_to_an_earlier_speed_are_distinguished_from_wheels_that_stay(
    tmp_path: Path, made_up_run: Make
) -> None:
    run = made_up_run(ticks=6)
    run.wheel_speeds[2] = 7.0
    run.wheel_speeds[4:] = -0.0
    assert_holds(load(run.record(tmp_path)), run, 7)


def test_the_output_folder_may_be_given_for_the_file(tmp_path: Path, made_up_run: Make) -> None:
    made_up_run().record(tmp_path / "deep" / "er")
    assert load(tmp_path / "deep" / "er").complete


def test_events_faults_and_commands_come_back_with_what_else_they_say(
    tmp_path: Path, made_up_run: Make
) -> None:
    event = {"time_s": 0.01, "kind": "tipped", "parcel": 0, "cells": [[0, 1]], "detail": "edge 2"}
    fault = {"time_s": 0.02, "kind": "crash", "cell": [1, 2]}
    run = made_up_run(events=[event], faults=[fault])
    with Recorder(tmp_path, run.header) as recorder:
        run.feed(recorder)
        recorder.control({"time_s": 0.03, "kind": "pause"})
        recorder.close("ok")
    recording = load(tmp_path)
    assert recording.events == [event]
    assert recording.faults == [fault]
    assert recording.control == [{"time_s": 0.03, "kind": "pause"}]


def test_numpy_numbers_in_an_event_become_json(tmp_path: Path, made_up_run: Make) -> None:
    event = {"time_s": np.float64(0.5), "kind": "support", "cells": np.array([[1, 2]])}
    recording = load(made_up_run(events=[event]).record(tmp_path))
    assert recording.events == [{"time_s": 0.5, "kind": "support", "cells": [[1, 2]]}]


def test_a_run_of_no_ticks_is_a_recording(tmp_path: Path, made_up_run: Make) -> None:
    recording = load(made_up_run(ticks=0).record(tmp_path, status="interrupted"))
    assert recording.complete
    assert recording.drives.shape == (1, 12, 2)
    assert recording.parcels.shape == (1, 1, 6)


def test_a_recording_without_any_instant_is_a_recording(tmp_path: Path, made_up_run: Make) -> None:
    Recorder(tmp_path, made_up_run().header).close("failed")
    recording = load(tmp_path)
    assert recording.status == "failed"
    assert recording.presence.shape == (0, 12, 2)
    assert recording.drives.shape == (0, 12, 2)
    assert recording.parcels.shape == (0, 1, 6)


def test_the_digest_can_be_taken_again_from_the_recording(tmp_path: Path, made_up_run: Make) -> None:
    run = made_up_run(wheels_change=True)
    live = Digest(b"scene")
    for tick in range(run.ticks):
        live.tick(tick, run.presence[tick], run.drives[tick], run.states[tick + 1])
    recording = load(run.record(tmp_path))
    again = Digest(b"scene")
    for row in range(len(recording.tick) - 1):
        again.tick(
            int(recording.tick[row]),
            recording.presence[row],
            recording.drives[row],
            recording.parcels[row + 1],
        )
    assert again.hexdigest == live.hexdigest


def test_the_library_s_own_reader_reads_a_closed_recording(tmp_path: Path, made_up_run: Make) -> None:
    run = made_up_run(faults=[{"time_s": 0.0, "kind": "crash", "cell": [0, 0]}])
    with run.record(tmp_path).open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        messages = list(reader.iter_messages(topics=[PARCELS]))
    assert summary.statistics.message_count == 2 * 13 + 2
    assert [message.log_time for _, _, message in messages] == [t * 4_096_000 for t in range(13)]
    states = [
        [list(parcel.values()) for parcel in json.loads(message.data)["parcels"]]
        for _, _, message in messages
    ]
    np.testing.assert_array_equal(np.array(states), run.states)


def test_a_number_that_is_not_finite_is_null_for_json_and_itself_for_us(
    tmp_path: Path, made_up_run: Make
) -> None:
    run = made_up_run(ticks=1)
    run.states[1, 0, 3] = np.inf
    path = run.record(tmp_path, status="unstable")
    assert load(path).parcels[1, 0, 3] == np.inf
    with path.open("rb") as stream:
        *_, (_, _, last) = make_reader(stream).iter_messages(topics=[PARCELS])
    assert json.loads(last.data)["parcels"][0]["velocity_x_m_s"] is None


def test_leaving_the_block_closes_the_recording(tmp_path: Path, made_up_run: Make) -> None:
    run = made_up_run()
    with Recorder(tmp_path / "left", run.header):
        pass
    with pytest.raises(KeyboardInterrupt), Recorder(tmp_path / "interrupted", run.header):
        raise KeyboardInterrupt
    assert load(tmp_path / "left").status == "failed"
    assert load(tmp_path / "interrupted").status == "interrupted"


def test_closing_twice_changes_nothing_and_leaves_no_thread(tmp_path: Path, made_up_run: Make) -> None:
    recorder = Recorder(tmp_path, made_up_run().header)
    recorder.close("ok")
    recorder.close("failed")
    assert load(tmp_path).status == "ok"
    assert all(thread.name != "recorder" for thread in threading.enumerate())


def test_recording_after_closing_is_named_as_a_bug(tmp_path: Path, made_up_run: Make) -> None:
    recorder = Recorder(tmp_path, made_up_run().header)
    recorder.close("ok")
    with pytest.raises(DeployError, match=r"this is a bug: .* is closed"):
        recorder.event({"time_s": 0.0, "kind": "late"})


def test_a_recording_in_the_folder_is_replaced(tmp_path: Path, made_up_run: Make) -> None:
    made_up_run(ticks=40).record(tmp_path)
    run = made_up_run(ticks=2)
    assert_holds(load(run.record(tmp_path)), run, 3)


def test_the_header_must_name_all_its_keys(tmp_path: Path, made_up_run: Make) -> None:
    header = dict(made_up_run().header)
    del header["pitch_m"]
    Recorder(tmp_path, Header(**header)).close("ok")  # type: ignore[typeddict-item]
    with pytest.raises(InputError, match="its header has no pitch_m"):
        load(tmp_path)


@pytest.mark.parametrize(
    ("fault", "place"),
    [
        ({"phase": "begins"}, "cells"),
        ({"phase": "begins", "cells": [[0]]}, "cells.0"),
        ({"phase": "pauses", "cells": [[0, 0]]}, "phase"),
        ({"cell": [0, 0, 0]}, "cell"),
    ],
)
def test_a_fault_without_affected_cells_is_refused(
    fault: dict[str, Any], place: str, tmp_path: Path, made_up_run: Make
) -> None:
    path = made_up_run(faults=[{"time_s": 0.0, "kind": "crash", **fault}]).record(tmp_path)
    with pytest.raises(InputError, match=f"a fault: {re.escape(place)}: "):
        load(path)
