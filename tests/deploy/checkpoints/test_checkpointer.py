"""Checkpoints that can't be finished are given up, and the run goes on."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any, cast

import pytest

from bus.lockstep.counters import MessageCounters
from bus.lockstep.snapshots import ShardSnapshot, SnapshotCollector
from deploy.checkpoints.checkpoint import Checkpoint
from deploy.checkpoints.checkpointer import Checkpointer, CheckpointMetadata
from deploy.checkpoints.store import FILE_NAME, CheckpointStore
from deploy.recordings.digest import Digest
from deploy.scenes.files import load_scene
from tests.deploy.checkpoints.direct import DirectRun


class Books:
    """Of a run: what the checkpointer needs of coordinator, run log and recorder."""

    def __init__(self) -> None:
        self.digest, self.disturbed, self.requested = Digest(b""), False, list[int]()
        self.keeping: SnapshotCollector | None = None
        self.disk, self.secured = threading.Event(), list[int]()
        self.disk.set()
        self.given_up = 0

    state_fields = Digest.state_fields
    value = motion = bytes(32)

    def request_snapshot(self, tick: int) -> None:
        self.requested.append(tick)
        self.keeping = SnapshotCollector(tick, [0])

    def record_snapshot(self) -> None:
        assert self.keeping is not None
        self.keeping.record(MessageCounters(), {}, [0])

    def poll_snapshot(self) -> Any:
        return None if self.keeping is None else self.keeping.combined({})

    def cancel_snapshot(self) -> list[int]:
        self.given_up += 1
        return [] if self.keeping is None else self.keeping.missing

    def position(self) -> tuple[dict[str, int], int]:
        return {"/tick": 1}, 77

    def sync_to(self, mark: int) -> None:
        self.disk.wait(10.0)
        self.secured.append(mark)


class Scenery:
    """A checkpointer, its run, and a clock."""

    def __init__(self, folder: Path, begun: float = 0.0) -> None:
        self.now, self.books, self.warned = begun, Books(), list[str]()
        self.process = DirectRun(load_scene("elliptic")).process
        about = CheckpointMetadata(scene_name="", scene={}, bound={}, options={}, wall_s=3.0)
        books = cast("Any", self.books)
        self.checkpointer = Checkpointer(
            10.0,
            books,
            books,
            books,
            None,
            CheckpointStore(folder),
            about,
            patience_s=0.0,
            warn=self.warned.append,
            clock=lambda: self.now,
        )

    def tick(self, now: float, answer: bool = False) -> None:
        """One that begins at a time, all but the first after another was taken down."""
        self.now = now
        self.checkpointer.before_tick(self.process)
        if answer and self.books.keeping is not None:
            self.books.keeping.handle(0, ShardSnapshot(self.books.keeping.tick, (1, 1, 0, 0), (), b"cells"))
        self.process.step()
        self.checkpointer.poll()


def test_a_checkpoint_is_taken_when_due_and_the_tick_after_the_request(tmp_path: Path) -> None:
    run = Scenery(tmp_path)
    run.tick(9.0)
    assert run.books.requested == []
    run.tick(10.0)
    assert run.books.requested == [2]
    run.tick(10.1, answer=True)
    run.checkpointer.close()
    assert Checkpoint.from_bytes((tmp_path / FILE_NAME).read_bytes()).tick == 2
    assert run.warned == []


def test_cells_that_don_t_answer_in_time_cost_the_checkpoint_and_not_the_run(tmp_path: Path) -> None:
    run = Scenery(tmp_path)
    for now in (10.0, 10.1, 15.0):
        run.tick(now)
    assert run.warned == []
    run.tick(15.1)
    assert run.warned == ["no checkpoint before tick 1: shard 0 sent no snapshot within 5 s"]
    run.tick(21.0)
    assert run.books.requested == [1, 5]


def test_a_disk_that_is_full_costs_the_checkpoint_and_not_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = Scenery(tmp_path)

    def full(self: CheckpointStore, content: bytes) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(CheckpointStore, "write", full)
    run.tick(10.0)
    run.tick(10.1, answer=True)
    run.checkpointer.close()
    assert run.warned == ["no checkpoint: [Errno 28] No space left on device"]
    monkeypatch.undo()
    run.tick(20.1)
    run.tick(20.2, answer=True)
    run.checkpointer.close()
    assert len(run.warned) == 1
    assert run.checkpointer.written == [3]


def test_what_was_done_to_a_run_by_hand_ends_its_checkpoints(tmp_path: Path) -> None:
    run = Scenery(tmp_path)
    run.tick(10.0)
    run.books.disturbed = True
    for now in (10.1, 50.0, 90.0):
        run.tick(now)
    assert len(run.warned) == 1
    assert "no more checkpoints" in run.warned[0]
    assert run.books.given_up == 1
    assert run.books.requested == [1]


def _writer() -> threading.Thread | None:
    """The thread that writes a checkpoint."""
    return next((thread for thread in threading.enumerate() if thread.name == "checkpoint"), None)


def test_one_says_what_of_the_wall_clock_went_by_since_the_very_start(tmp_path: Path) -> None:
    run = Scenery(tmp_path, begun=1.0)
    run.checkpointer.close()
    run.tick(10.9)
    assert run.books.requested == []
    run.tick(11.0)
    run.tick(11.5, answer=True)
    run.checkpointer.close()
    checkpoint = Checkpoint.from_bytes((tmp_path / FILE_NAME).read_bytes())
    assert checkpoint.wall_s == 13.5
    assert checkpoint.reporter is None
    assert run.checkpointer.written == [checkpoint.tick]


def test_no_request_is_sent_before_the_file_is_written_and_the_recording_is_synced_before_it(
    tmp_path: Path,
) -> None:
    run = Scenery(tmp_path)
    run.books.disk.clear()
    run.tick(10.0)
    run.tick(10.1, answer=True)
    writer = _writer()
    assert writer is not None
    assert writer.daemon, "a disk that hangs keeps nobody from ending"
    run.tick(25.0)
    run.tick(25.1)
    assert (run.books.requested, run.books.secured, list(tmp_path.iterdir())) == ([1], [], [])
    run.books.disk.set()
    writer.join()
    assert run.books.secured == [77]
    run.tick(25.2)
    run.tick(25.3)
    run.tick(25.4, answer=True)
    run.checkpointer.close()
    run.tick(35.1)
    assert run.books.requested == [1, 6]
    run.tick(35.2)
    assert run.books.requested == [1, 6, 9]


def test_a_long_tick_before_the_plant_s_own_part_costs_no_checkpoint(tmp_path: Path) -> None:
    run = Scenery(tmp_path)
    run.tick(10.0)
    run.now = 16.0
    run.checkpointer.poll()
    run.tick(16.1, answer=True)
    run.checkpointer.close()
    assert run.warned == []
    assert run.checkpointer.written == [1]


def test_the_next_begins_so_much_earlier_as_the_last_took_to_be_on_the_disk(tmp_path: Path) -> None:
    run = Scenery(tmp_path)
    run.tick(10.0)
    run.tick(12.0, answer=True)
    run.checkpointer.close()
    run.tick(17.9)
    assert run.books.requested == [1]
    run.tick(18.0)
    assert run.books.requested == [1, 4]
