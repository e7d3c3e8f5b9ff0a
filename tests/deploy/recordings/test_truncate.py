"""A recording that begins with what another did."""

from __future__ import annotations

import resource
from pathlib import Path

import numpy as np
import pytest

from deploy.errors import InputError
from deploy.recordings.format import EVENTS, FAULTS, FILE_NAME, PARCELS, TICK
from deploy.recordings.reader import load
from deploy.recordings.writer import Recorder
from tests.deploy.conftest import MadeUpRun

HEADER = MadeUpRun().header
PREFIX = {TICK: 3, PARCELS: 3, EVENTS: 1}


def _ticks(recorder: Recorder, first: int, last: int, *, follow: bool = False) -> None:
    """Ticks in each of which only what it must be is another; with wheels that stand, or follow the drives."""
    cells, sensors = len(HEADER["cells"]), len(HEADER["sensors_m"])
    for tick in range(first, last):
        presence = np.full((cells, sensors), tick >= 2)
        drives = np.full((cells, 2), float(tick // 3))
        recorder.tick(
            tick,
            tick * 1_000,
            presence,
            drives,
            np.full((cells, 2), float(max(tick - 1, 0) // 3) if follow else 0.0),
            np.full((len(HEADER["footprints_m"]), 6), 0.5 * tick),
        )
        recorder.event({"time_s": tick * 1e-6, "kind": f"event {tick}"})


def _recorded(folder: Path, ticks: int = 6) -> None:
    with Recorder(folder, HEADER) as recorder:
        _ticks(recorder, 0, ticks)
        recorder.fault({"time_s": 5e-6, "kind": "crash"})
        recorder.close("interrupted", "00")


def _loaded(folder: Path) -> tuple[object, ...]:
    found = load(folder)
    return (
        found.tick.tolist(),
        found.parcels.tolist(),
        found.presence.tolist(),
        found.drives.tolist(),
        found.wheel_speeds.tolist(),
        [event["kind"] for event in found.events],
        found.faults,
    )


@pytest.mark.parametrize("torn", [False, True], ids=["whole", "torn"])
def test_it_goes_on_without_a_tick_missing_or_doubled(tmp_path: Path, torn: bool) -> None:
    _recorded(tmp_path / "other")
    path = tmp_path / "other" / FILE_NAME
    if torn:
        with Recorder(tmp_path / "other", HEADER) as recorder:
            _ticks(recorder, 0, 6)
            recorder.flush()
            content = path.read_bytes()
        path.write_bytes(content + b"\x06\xff\x00\x00\x00\x00\x00\x00\x00torn")
    with Recorder(tmp_path / "other", HEADER, continued_from={**PREFIX, EVENTS: 3}) as recorder:
        _ticks(recorder, 3, 5)
        recorder.close("ok", "11")
    with Recorder(tmp_path / "whole", HEADER) as recorder:
        _ticks(recorder, 0, 5)
        recorder.close("ok", "11")
    assert _loaded(tmp_path / "other") == _loaded(tmp_path / "whole")
    assert load(tmp_path / "other").status == "ok"


def test_wheels_that_stop_following_their_drives_where_it_goes_on_do_so_there(tmp_path: Path) -> None:
    for name in ("whole", "other"):
        with Recorder(tmp_path / name, HEADER) as recorder:
            _ticks(recorder, 0, 5, follow=True)
            if name == "whole":
                _ticks(recorder, 5, 7)
    with Recorder(tmp_path / "other", HEADER, continued_from={TICK: 5, PARCELS: 5, EVENTS: 5}) as recorder:
        _ticks(recorder, 5, 7)
    assert _loaded(tmp_path / "other") == _loaded(tmp_path / "whole")
    assert load(tmp_path / "whole").wheel_speeds[:, 0, 0].tolist() == [0, 0, 0, 0, 1, 0, 0]


def test_a_recording_that_lacks_the_prefix_is_refused_and_stays(tmp_path: Path) -> None:
    _recorded(tmp_path)
    before = (tmp_path / FILE_NAME).read_bytes()
    with pytest.raises(InputError, match="2 messages of /tick, 1 message of /faults are missing"):
        Recorder(tmp_path, HEADER, continued_from={TICK: 8, FAULTS: 2})
    assert (tmp_path / FILE_NAME).read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == [FILE_NAME]


def test_one_that_is_gone_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"there is no recording\.mcap"):
        Recorder(tmp_path, HEADER, continued_from=PREFIX)


def test_the_prefix_is_in_the_file_before_the_first_new_tick(tmp_path: Path) -> None:
    _recorded(tmp_path)
    with Recorder(tmp_path, HEADER, continued_from=PREFIX, flush_s=60.0):
        assert load(tmp_path).tick.tolist() == [0, 1, 2]


def test_without_room_for_the_copy_it_is_refused_and_all_stays(tmp_path: Path) -> None:
    _recorded(tmp_path, 400)
    before = (tmp_path / FILE_NAME).read_bytes()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4_000, hard))
    try:
        with pytest.raises(InputError, match=r"can't write recording\.mcap there: File too large"):
            Recorder(tmp_path, HEADER, continued_from={TICK: 400, PARCELS: 400})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert (tmp_path / FILE_NAME).read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == [FILE_NAME]
