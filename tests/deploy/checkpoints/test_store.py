"""Checkpoints on the disk: whole, or refused and the one before taken."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from hashlib import sha256
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.state_codec import encode
from deploy.checkpoints.checkpoint import MAGIC, Checkpoint
from deploy.checkpoints.store import FILE_NAME, PREVIOUS, CheckpointStore
from deploy.errors import DeployError, InputError

CHECKPOINT = Checkpoint(
    scene_name="elliptic",
    scene={"seed": 1},
    bound={"numpy": "2"},
    options={"processes": 1},
    tick=7,
    time_ns=28_672_000,
    process=b"plant",
    states={0: b"cells", 3: b"more"},
    links={0: ((b"\1", b"message"),)},
    relayed={2: (b"\1", b"message")},
    run_log=b"run log",
    reporter=None,
    counts=(4, 3, 2, 1),
    refused={("cell 1,2", "sense: type"): 1},
    counters={"sensor.bounces": 2},
    recorded={"/tick": 7},
    dead=(2, 5),
    wall_s=0.5,
    resumed=(3,),
)
CONTENT = CHECKPOINT.to_bytes()


def test_a_checkpoint_comes_back_as_it_was(tmp_path: Path) -> None:
    store = CheckpointStore(tmp_path)
    store.write(CONTENT)
    assert store.read() == CHECKPOINT
    assert [path.name for path in tmp_path.iterdir()] == [FILE_NAME]


def test_the_last_two_stay(tmp_path: Path) -> None:
    store = CheckpointStore(tmp_path)
    for tick in (1, 2, 3):
        store.write(replace(CHECKPOINT, tick=tick).to_bytes())
    assert store.read().tick == 3
    assert Checkpoint.from_bytes((tmp_path / PREVIOUS).read_bytes()).tick == 2


@pytest.mark.parametrize("damage", ["cut", "changed", "empty", "gone"])
def test_where_the_last_is_not_whole_the_one_before_is_taken(tmp_path: Path, damage: str) -> None:
    store, last = CheckpointStore(tmp_path), tmp_path / FILE_NAME
    store.write(CONTENT)
    store.write(replace(CHECKPOINT, tick=9).to_bytes())
    content = last.read_bytes()
    match damage:
        case "cut":
            last.write_bytes(content[:-5])
        case "changed":
            last.write_bytes(content[:-5] + b"12345")
        case "empty":
            last.write_bytes(b"")
        case _:
            last.unlink()
    assert store.read() == CHECKPOINT


def test_one_that_is_not_whole_does_not_take_the_place_of_the_one_that_is_gone_on_from(
    tmp_path: Path,
) -> None:
    store = CheckpointStore(tmp_path)
    store.write(CONTENT)
    store.write(CONTENT)
    (tmp_path / FILE_NAME).write_bytes(b"torn")
    store.keep(store.read())
    store.write(replace(CHECKPOINT, tick=9).to_bytes())
    (tmp_path / FILE_NAME).write_bytes(b"torn again")
    assert store.read() == CHECKPOINT


class Power:
    """Goes off before the n-th thing that is done to the folder."""

    def __init__(self, lasts: int, monkeypatch: pytest.MonkeyPatch) -> None:
        self.left, self.done = lasts, list[str]()
        for owner, name in ((os, "fsync"), (Path, "replace"), (Path, "unlink")):
            monkeypatch.setattr(owner, name, self._unless_off(name, getattr(owner, name)))

    def _unless_off(self, name: str, act: Callable[..., object]) -> Callable[..., object]:
        def acted(*arguments: object) -> object:
            if not self.left:
                raise OSError(5, "no power")
            self.left -= 1
            self.done.append(name)
            return act(*arguments)

        return acted


@pytest.mark.parametrize("lasts", range(4))
@pytest.mark.parametrize("last", ["whole", "torn"])
def test_whenever_the_power_goes_there_is_a_whole_one(
    tmp_path: Path, last: str, lasts: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = CheckpointStore(tmp_path)
    for _ in range(2):
        store.write(CONTENT)
    if last == "torn":
        (tmp_path / FILE_NAME).write_bytes(b"torn")
    after = replace(CHECKPOINT, tick=9).to_bytes()
    act = partial(store.keep, CHECKPOINT) if last == "torn" else partial(store.write, after)
    with monkeypatch.context() as patch:
        Power(lasts, patch)
        with pytest.raises((DeployError, OSError), match="no power"):
            act()
    assert replace(store.read(), tick=7) == CHECKPOINT


def test_content_is_on_the_disk_before_it_has_a_name_and_its_name_after(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written: list[tuple[str, int]] = []

    def fsync(handle: int) -> None:
        path = Path(f"/proc/self/fd/{handle}").resolve()
        written.append((path.name, path.stat().st_size if path.is_file() else -1))

    store, before = CheckpointStore(tmp_path), len(list(Path("/proc/self/fd").iterdir()))
    store.write(CONTENT)
    power = Power(9, monkeypatch)
    monkeypatch.setattr(os, "fsync", fsync)
    store.write(CONTENT)
    assert [name for name, _ in written] == [".checkpoint.msgpack.draft", tmp_path.name]
    assert written[0][1] == len(CONTENT)
    assert power.done == ["replace", "replace"]
    assert len(list(Path("/proc/self/fd").iterdir())) == before


def test_the_one_that_is_gone_on_from_stays_alone_and_all_can_be_removed(tmp_path: Path) -> None:
    store = CheckpointStore(tmp_path)
    for _ in range(2):
        store.write(CONTENT)
    store.keep(CHECKPOINT)
    assert [path.name for path in tmp_path.iterdir()] == [FILE_NAME]
    store.write(CONTENT)
    store.clear()
    assert list(tmp_path.iterdir()) == []


def test_one_that_is_too_large_or_can_not_be_read_is_passed_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = CheckpointStore(tmp_path)
    store.write(CONTENT)
    with monkeypatch.context() as patch:
        patch.setattr("deploy.checkpoints.store.LARGEST_BYTES", len(CONTENT))
        assert store.read() == CHECKPOINT
        patch.setattr("deploy.checkpoints.store.LARGEST_BYTES", len(CONTENT) - 1)
        with pytest.raises(InputError, match=f"must be at most {len(CONTENT) - 1} bytes"):
            store.read()
    (tmp_path / FILE_NAME).unlink()
    (tmp_path / FILE_NAME).mkdir()
    with pytest.raises(InputError, match=r"checkpoint\.msgpack: Is a directory"):
        store.read()


def test_where_none_is_whole_what_is_the_matter_with_each_is_said(tmp_path: Path) -> None:
    (tmp_path / FILE_NAME).write_bytes(CONTENT[:-1])
    (tmp_path / PREVIOUS).write_bytes(b"something else")
    with pytest.raises(InputError, match=r"(?s)cut or changed.*not a checkpoint"):
        CheckpointStore(tmp_path).read()


def test_another_format_is_refused_by_its_number() -> None:
    with pytest.raises(InputError, match="of format 7: this version reads format 4"):
        Checkpoint.from_bytes(MAGIC + (7).to_bytes(2, "little") + CONTENT[len(MAGIC) + 2 :])


@pytest.mark.parametrize("content", [MAGIC, MAGIC + bytes(33), b"x" * 99], ids=repr)
def test_what_is_shorter_than_its_head_or_begins_otherwise_is_none(content: bytes) -> None:
    with pytest.raises(InputError, match="not a checkpoint, or cut at its beginning"):
        Checkpoint.from_bytes(content)


@pytest.mark.parametrize("values", [[], {}, {"tick": 1}], ids=repr)
def test_a_whole_file_of_something_else_is_refused(values: object) -> None:
    head, body = CONTENT[: len(MAGIC) + 2], encode(values, {})
    with pytest.raises(InputError, match="must hold scene_name, scene, bound"):
        Checkpoint.from_bytes(head + sha256(head + body).digest() + body)


def test_the_first_tick_may_be_over_and_the_counts_are_those_of_the_bus() -> None:
    assert Checkpoint.from_bytes(replace(CHECKPOINT, tick=1, dead=(0,)).to_bytes()).tick == 1
    counts = CHECKPOINT.all_counts()
    assert (counts.sent, counts.delivered, counts.lost, counts.late) == (4, 3, 2, 1)
    assert (dict(counts.refused), dict(counts.cell_counters)) == (CHECKPOINT.refused, CHECKPOINT.counters)


@given(st.integers(0, len(CONTENT) - 1), st.integers(1, 255))
def test_a_changed_byte_is_noticed_wherever_it_is(place: int, change: int) -> None:
    changed = bytearray(CONTENT)
    changed[place] ^= change
    with pytest.raises(InputError):
        Checkpoint.from_bytes(bytes(changed))


@pytest.mark.parametrize(
    ("field", "value", "problem"),
    [
        ("tick", "seven", "tick: must be int"),
        ("states", {"a": b""}, "states: must map int to bytes"),
        ("tick", 0, "tick: must be at least 1"),
        ("reporter", 3, "reporter: must be bytes or NoneType"),
        ("bound", {"python": "3", "numpy": 2}, "bound: must map str to str"),
        ("refused", {"a": 1}, "refused: must map tuple to int"),
        ("resumed", (True,), "resumed: must be numbers from 0"),
        ("dead", (0, -1), "dead: must be numbers from 0"),
        ("counts", (1, 2), "counts: must be four numbers"),
    ],
)
def test_a_whole_file_of_other_values_is_refused_by_field(field: str, value: object, problem: str) -> None:
    content = replace(CHECKPOINT, **{field: value}).to_bytes()  # type: ignore[arg-type]
    with pytest.raises(InputError, match=problem):
        Checkpoint.from_bytes(content)
