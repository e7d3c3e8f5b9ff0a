"""Recordings that were cut, spoilt, or could not be written."""

from __future__ import annotations

import json
import os
import resource
import signal
import struct
import subprocess
import sys
import textwrap
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from deploy.errors import DeployError, InputError
from deploy.recordings.info import recording_info
from deploy.recordings.mcap import McapFile
from deploy.recordings.reader import load
from deploy.recordings.writer import Recorder

Make = Callable[..., Any]


def test_cut_anywhere_after_its_header_a_recording_gives_what_comes_before_the_cut(
    tmp_path: Path, made_up_run: Make
) -> None:
    run = made_up_run(ticks=30, wheels_change=True)
    with Recorder(tmp_path, run.header) as recorder:
        header_end = recorder.path.stat().st_size
        for tick in range(run.ticks):
            recorder.tick(
                tick, tick, run.presence[tick], run.drives[tick], run.wheel_speeds[tick], run.states[tick]
            )
            if tick % 5 == 4:
                recorder.flush()
        flushed = recorder.path.stat().st_size
        recorder.close("ok")
    whole = recorder.path.read_bytes()
    cut = tmp_path / "cut.mcap"
    counts = []
    for size in sorted({*range(header_end, flushed, 151), header_end, flushed}):
        cut.write_bytes(whole[:size])
        recording = load(cut)
        rows = len(recording.tick)
        assert not recording.complete
        np.testing.assert_array_equal(recording.parcels, run.states[:rows])
        np.testing.assert_array_equal(recording.drives, run.drives[:rows])
        counts.append(rows)
    assert counts == sorted(counts)
    assert set(counts) == {0, 5, 10, 15, 20, 25, 30}


def test_a_flush_puts_all_so_far_into_the_file(made_up_run: Make, recorder: Recorder) -> None:
    run = made_up_run()
    run.feed(recorder, end=False)
    recorder.flush()
    assert len(load(recorder.path).tick) == run.ticks


def test_cut_at_any_of_a_hundred_bytes_a_recording_opens_up_to_its_last_whole_chunk(
    tmp_path: Path, made_up_run: Make
) -> None:
    run = made_up_run(ticks=200, wheels_change=True, parcels=3)
    with Recorder(tmp_path, run.header, flush_s=1e9) as recorder:
        header_end = recorder.path.stat().st_size
        for tick in range(run.ticks):
            recorder.tick(
                tick, tick, run.presence[tick], run.drives[tick], run.wheel_speeds[tick], run.states[tick]
            )
            if tick % 9 == 8:
                recorder.flush()
        recorder.close("ok")
    with recorder.path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    chunks = [
        (one.chunk_start_offset + one.chunk_length, one.message_end_time) for one in summary.chunk_indexes
    ]
    assert len(chunks) > 20
    whole = recorder.path.read_bytes()
    cut = tmp_path / "cut.mcap"
    sizes = np.random.default_rng(7).choice(len(whole), 100, replace=False).tolist()
    refused = 0
    for size in sizes:
        cut.write_bytes(whole[:size])
        if size < header_end:
            with pytest.raises(InputError):
                load(cut)
            with pytest.raises(InputError):
                recording_info(cut)
            refused += 1
            continue
        rows = max((last + 1 for end, last in chunks if end <= size), default=0)
        recording, info = load(cut), recording_info(cut)
        if recording.complete:  # only the index at the end is cut
            assert len(recording.tick) == info.instants == run.ticks
            assert info.status == "ok"
            continue
        assert len(recording.tick) == info.instants == rows
        np.testing.assert_array_equal(recording.parcels, run.states[:rows])
        np.testing.assert_array_equal(recording.drives, run.drives[:rows])
        assert (info.complete, info.status, info.digest) == (False, None, None)
        assert info.ticks == (rows - 1 if rows else None)
        assert {topic.name: topic.messages for topic in info.topics}.get("/tick", 0) == rows
    assert refused < 20


def test_the_memory_of_info_does_not_grow_with_the_ticks(tmp_path: Path, made_up_run: Make) -> None:
    peaks = list[int]()
    for ticks in (500, 4000):
        folder = tmp_path / str(ticks)
        made_up_run(ticks=ticks, wheels_change=True, rows=20, columns=20).record(folder)
        recording_info(folder)
        tracemalloc.start()
        recording_info(folder)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.2 * peaks[0]


def test_zeros_at_the_end_count_as_cut(tmp_path: Path, made_up_run: Make, recorder: Recorder) -> None:
    run = made_up_run()
    run.feed(recorder, end=False)
    recorder.flush()
    spoilt = tmp_path / "spoilt.mcap"
    spoilt.write_bytes(recorder.path.read_bytes() + bytes(4096))
    recording = load(spoilt)
    assert len(recording.tick) == run.ticks
    assert not recording.complete


@pytest.mark.parametrize("size", [0, 5, 8, 60])
def test_cut_inside_its_header_a_recording_is_refused(tmp_path: Path, made_up_run: Make, size: int) -> None:
    path = made_up_run().record(tmp_path)
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(InputError, match="it holds no complete header"):
        load(path)


def test_a_changed_byte_in_the_data_is_found(tmp_path: Path, made_up_run: Make) -> None:
    with Recorder(tmp_path, made_up_run().header) as recorder:
        header_end = recorder.path.stat().st_size
        made_up_run(ticks=200).feed(recorder)
        recorder.close("ok")
    data = bytearray(recorder.path.read_bytes())
    data[header_end + 3000] ^= 0x20
    recorder.path.write_bytes(data)
    with pytest.raises(InputError, match=r"is corrupt: record at byte \d+"):
        load(recorder.path)


def _file_of_one_chunk(folder: Path, header: Any, *, compression: str, size: int, packed: bytes) -> Path:
    """A recording of a chunk that a writer of ours would never have written."""
    path = folder / "recording.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="mdms", library="other")
        writer.add_metadata("mdms.header", {"format": "2", "json": json.dumps(header)})
        stream.flush()
        content = struct.pack("<QQQI", 0, 0, size, 0)
        content += (
            struct.pack("<I", len(compression))
            + compression.encode()
            + struct.pack("<Q", len(packed))
            + packed
        )
        stream.write(struct.pack("<BQ", 0x06, len(content)) + content)
    return path


@pytest.mark.parametrize("compression", ["lz4", "zstd", "", "other"])
def test_a_chunk_that_says_it_is_huge_is_refused_before_memory_is_taken(
    tmp_path: Path, made_up_run: Make, compression: str
) -> None:
    packed = {"lz4": lz4.frame.compress(b"short"), "zstd": zstandard.compress(b"short")}.get(
        compression, b"short"
    )
    header = made_up_run().header
    path = _file_of_one_chunk(tmp_path, header, compression=compression, size=2**40, packed=packed)
    with pytest.raises(InputError, match="is corrupt: record at byte"):
        load(path)


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.NONE])
def test_a_recording_rewritten_by_another_tool_is_read(
    tmp_path: Path, made_up_run: Make, compression: CompressionType
) -> None:
    run = made_up_run()
    original, copy = run.record(tmp_path), tmp_path / "copy.mcap"
    with copy.open("wb") as stream, original.open("rb") as source:
        writer = Writer(stream, compression=compression)
        writer.start(profile="mdms", library="other")
        reader = make_reader(source)
        for note in reader.iter_metadata():
            writer.add_metadata(note.name, note.metadata)
        channels = dict[str, int]()
        for _, channel, message in reader.iter_messages():
            if channel.topic not in channels:
                channels[channel.topic] = writer.register_channel(channel.topic, channel.message_encoding, 0)
            writer.add_message(channels[channel.topic], message.log_time, message.data, message.publish_time)
        writer.finish()
    np.testing.assert_array_equal(load(copy).parcels, load(original).parcels)


def test_a_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "recording.mcap"
    path.write_bytes(b"PK\x03\x04 something else entirely")
    with pytest.raises(InputError, match="is not a recording: it does not begin as an MCAP file does"):
        load(path)


def test_an_mcap_file_of_another_program_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "robot.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="other")
        writer.finish()
    with pytest.raises(InputError, match="profile 'ros2', not 'mdms'"):
        load(path)


def test_a_header_with_fewer_than_no_parcels_is_refused(tmp_path: Path, made_up_run: Make) -> None:
    path = made_up_run(extra={"own_parcels": -(2**63)}).record(tmp_path)
    with pytest.raises(
        InputError, match=r"is corrupt: the header: own_parcels: .* greater than or equal to 0"
    ):
        load(path)


def test_a_missing_recording_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^there is no recording\.mcap in .*$"):
        load(tmp_path)


def test_a_folder_that_is_a_file_is_refused_before_anything_starts(tmp_path: Path, made_up_run: Make) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    with pytest.raises(
        InputError, match=r"output .*: can't write recording\.mcap there: (File exists|Not a)"
    ):
        Recorder(blocked, made_up_run().header)


def test_a_folder_without_permission_is_refused_before_anything_starts(made_up_run: Make) -> None:
    # /proc refuses even the superuser, whom file modes would not stop.
    with pytest.raises(InputError, match="can't write"):
        Recorder("/proc/mdms", made_up_run().header)


def test_a_disk_that_is_full_at_the_start_is_left_as_it_was(tmp_path: Path, made_up_run: Make) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, hard))
    try:
        with pytest.raises(InputError, match=r"can't write recording\.mcap there: File too large"):
            Recorder(tmp_path, made_up_run().header)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_a_disk_that_is_full_at_the_start_is_refused(tmp_path: Path, made_up_run: Make) -> None:
    (tmp_path / "recording.mcap").symlink_to("/dev/full")
    with pytest.raises(InputError, match="No space left on device"):
        Recorder(tmp_path, made_up_run().header)


def _feed_and_flush(run: Any, recorder: Recorder) -> None:
    run.feed(recorder)
    recorder.flush()


def test_a_disk_that_fills_up_during_the_run_ends_it_with_the_file_and_the_cause(
    tmp_path: Path, made_up_run: Make
) -> None:
    run = made_up_run(ticks=400, wheels_change=True)
    recorder = Recorder(tmp_path, run.header)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))
    try:
        with pytest.raises(DeployError, match=r"can't write the recording .*recording\.mcap: File too large"):
            _feed_and_flush(run, recorder)
        with pytest.raises(DeployError, match="File too large"):
            recorder.event({"time_s": 0.0, "kind": "too late"})
        with pytest.raises(DeployError, match="File too large"):
            recorder.close("failed")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not load(tmp_path).complete


def test_a_disk_that_is_slow_holds_the_run_up_at_the_backlog_and_costs_nothing_else(
    tmp_path: Path, made_up_run: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    flush, most = McapFile.flush, 64_000

    def slowly(file: McapFile) -> None:
        time.sleep(0.1)  # of a real clock: a disk is slow by that
        flush(file)

    monkeypatch.setattr(McapFile, "flush", slowly)
    monkeypatch.setattr("deploy.recordings.writer.BACKLOG_BYTES", most)
    monkeypatch.setattr("deploy.recordings.writer.CHUNK_BYTES", 4_000)
    run, backlogs, put = made_up_run(ticks=300, wheels_change=True), list[int](), Recorder._put

    def watch(recorder: Recorder, *arguments: Any) -> None:
        put(recorder, *arguments)
        backlogs.append(recorder._queued - recorder._written)

    monkeypatch.setattr(Recorder, "_put", watch)
    begun = time.monotonic()
    with Recorder(tmp_path, run.header) as recorder:
        run.feed(recorder)
        recorder.close("ok")
    assert time.monotonic() - begun > 0.2
    assert most / 2 < max(backlogs) < most
    recording = load(tmp_path)
    assert recording.complete
    np.testing.assert_array_equal(recording.parcels, run.states)


_ENDLESS = """
    import os, sys, time
    import numpy as np
    from deploy.recordings.writer import Recorder
    header = dict(run="r", title="", scene_name="", scene={}, versions={}, period_ns=1, pitch_m=0.1,
                  cells=[[0, 0]], positions_m=[[0, 0]], sensors_m=[[0, 0]], footprints_m=[])
    recorder = Recorder(sys.argv[1], header)
    made = os.open(sys.argv[2], os.O_WRONLY | os.O_CREAT)
    for tick in range(int(sys.argv[3])):
        now = time.monotonic_ns()
        recorder.tick(tick, now, np.ones((1, 1), bool), np.zeros((1, 2)), np.zeros((1, 2)), np.zeros((0, 6)))
        os.write(made, now.to_bytes(8, "little"))
        if tick == 0:
            print("started", flush=True)
        time.sleep(0.001)
    print("stopped", flush=True)
    time.sleep(60)
"""


def _endless(folder: Path, ticks: int) -> subprocess.Popen[str]:
    """A process that records a tick a millisecond, then stands still; it notes the time of each in a file."""
    return subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(_ENDLESS), folder, folder / "made", str(ticks)],
        stdout=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[2],
    )


def test_killed_at_any_moment_a_run_leaves_all_but_its_last_half_second(tmp_path: Path) -> None:
    with _endless(tmp_path, 10**9) as process:
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(1.1)  # of a real clock: the claim is about one
        killed = time.monotonic_ns()
        os.kill(process.pid, signal.SIGKILL)
    made = np.fromfile(tmp_path / "made", dtype="<u8")
    recording = load(tmp_path)
    count = len(recording.tick)
    assert not recording.complete
    assert recording.time_ns.tolist() == made[:count].tolist()
    assert count >= np.count_nonzero(made < killed - 500_000_000) > 0


def test_killed_while_it_stands_still_a_run_leaves_everything(tmp_path: Path) -> None:
    with _endless(tmp_path, 100) as process:
        assert process.stdout is not None
        assert [process.stdout.readline() for _ in range(2)] == ["started\n", "stopped\n"]
        time.sleep(0.5)  # as above
        os.kill(process.pid, signal.SIGKILL)
    assert len(load(tmp_path).tick) == 100
