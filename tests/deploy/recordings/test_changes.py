"""Values of a recording that stay compressed until they are asked for are those that are not."""

from __future__ import annotations

import dataclasses
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deploy.recordings import rows
from deploy.recordings.changes import PackedValues
from deploy.recordings.difference import compare
from deploy.recordings.reader import load
from deploy.recordings.recording import Recording
from deploy.recordings.writer import Recorder

Make = Callable[..., Any]
FIELDS = ("held_presence", "held_drives", "held_wheel_speeds")


def both(path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Recording, Recording]:
    """A recording with all values in memory, and with none."""
    whole = load(path)
    with monkeypatch.context() as patched:
        patched.setattr(rows, "UNPACKED_BYTES", 0)
        packed = load(path)
    for name in FIELDS:
        assert isinstance(getattr(whole, name).values, np.ndarray)
        assert isinstance(getattr(packed, name).values, PackedValues)
    return whole, packed


@pytest.mark.parametrize("follow", [False, True], ids=["wheels", "wheels follow"])
@pytest.mark.parametrize("change", [False, True], ids=["constant", "changing"])
@pytest.mark.parametrize("chunk_bytes", [200, 1 << 20], ids=["many chunks", "one chunk"])
def test_they_are_the_same(
    tmp_path: Path,
    made_up_run: Make,
    monkeypatch: pytest.MonkeyPatch,
    follow: bool,
    change: bool,
    chunk_bytes: int,
) -> None:
    monkeypatch.setattr("deploy.recordings.writer.CHUNK_BYTES", chunk_bytes)
    path = made_up_run(ticks=30, wheels_change=change, wheels_follow=follow).record(tmp_path)
    whole, packed = both(path, monkeypatch)
    some = np.array([29, 3, 3, 0, 17])
    for name in FIELDS:
        one, other = getattr(whole, name), getattr(packed, name)
        np.testing.assert_array_equal(one.all(), other.all())
        assert one.all().dtype == other.all().dtype
        np.testing.assert_array_equal(one.of(7), other.of(7))
        np.testing.assert_array_equal(one.of(7, some), other.of(7, some))
        np.testing.assert_array_equal(one.of(7), one.all()[:, 7])
        nothing = np.array([], dtype=np.int64)
        assert one.of(7, nothing).shape == other.of(7, nothing).shape == (0, *one.all().shape[2:])
        assert [*one.each(nothing)] == [*other.each(nothing)] == []
        for instant in (0, 13, -1):
            np.testing.assert_array_equal(one.at(instant), other.at(instant))
        for a, b in zip(one.each(some), other.each(some), strict=True):
            np.testing.assert_array_equal(a, b)
        assert sorted({value.tobytes() for value in other.each(some)}) == sorted(
            {value.tobytes() for value in other.all()[some]}
        )
    for field in dataclasses.fields(whole.cell(1, 2)):
        one, other = (getattr(recording.cell(1, 2), field.name) for recording in (whole, packed))
        if field.name != "registers":
            np.testing.assert_array_equal(one, other)
    assert not compare(whole, packed).differences


def test_a_cut_recording_gives_what_it_has(
    tmp_path: Path, made_up_run: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("deploy.recordings.writer.CHUNK_BYTES", 200)
    path = made_up_run(ticks=30, wheels_change=True, wheels_follow=True).record(tmp_path)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    whole, packed = both(path, monkeypatch)
    assert 5 < len(whole.tick) < 30
    np.testing.assert_array_equal(whole.wheel_speeds, packed.wheel_speeds)


def test_values_of_another_size_or_kind_are_refused_though_nobody_asks_for_them(
    tmp_path: Path, made_up_run: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = made_up_run()
    monkeypatch.setattr(rows, "UNPACKED_BYTES", 0)
    run.drives = run.drives[:, :-1]
    with pytest.raises(Exception, match="drives must be 192 bytes"):
        load(run.record(tmp_path))


def test_a_long_recording_of_many_cells_takes_the_memory_of_its_file(
    tmp_path: Path, made_up_run: Make
) -> None:
    run = made_up_run(ticks=0, rows=50, columns=100)
    still = np.zeros((5000, 2), dtype=np.bool_)
    ticks, size = 1500, 80_000
    with Recorder(tmp_path, run.header) as recorder:
        for tick in range(ticks):
            speeds = np.full((5000, 2), float(tick))
            recorder.tick(tick, tick, still, speeds, speeds - 1.0, run.states[0])
        recorder.close("ok")
    assert ticks * size > 1.5 * rows.UNPACKED_BYTES
    tracemalloc.start()
    try:
        recording = load(tmp_path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 1.2 * rows.UNPACKED_BYTES
    assert recording.held_drives.at(1234)[4999, 1] == 1234.0
    assert recording.cell(49, 99).wheel_speeds[:, 0].tolist() == [tick - 1.0 for tick in range(ticks)]
