"""Checkpoints on the disk: whole, or refused and the one before taken."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deploy.checkpoints.checkpoint import MAGIC, Checkpoint
from deploy.checkpoints.store import BEFORE, FILE_NAME, Store
from deploy.errors import InputError

CHECKPOINT = Checkpoint(
    scene_name="elliptic",
    scene={"seed": 1},
    bound={"numpy": "2"},
    options={"processes": 1},
    tick=7,
    time_ns=28_672_000,
    process=b"plant",
    states={0: b"cells", 3: b"more"},
    ledger=b"ledger",
    reporter=None,
    counts=(4, 3, 2, 1),
    refused={("cell 1,2", "sense: type"): 1},
    tally={"sensor.bounces": 2},
    recorded={"/tick": 7},
    dead=(2, 5),
    wall_s=0.5,
    resumed=(3,),
)
CONTENT = CHECKPOINT.to_bytes()


def test_a_checkpoint_comes_back_as_it_was(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.write(CONTENT)
    assert store.read() == CHECKPOINT
    assert [path.name for path in tmp_path.iterdir()] == [FILE_NAME]


def test_the_last_two_stay(tmp_path: Path) -> None:
    store = Store(tmp_path)
    for tick in (1, 2, 3):
        store.write(replace(CHECKPOINT, tick=tick).to_bytes())
    assert store.read().tick == 3
    assert Checkpoint.from_bytes((tmp_path / BEFORE).read_bytes()).tick == 2


@pytest.mark.parametrize("damage", ["cut", "changed", "empty", "gone"])
def test_where_the_last_is_not_whole_the_one_before_is_taken(tmp_path: Path, damage: str) -> None:
    store, last = Store(tmp_path), tmp_path / FILE_NAME
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
    store = Store(tmp_path)
    store.write(CONTENT)
    store.write(CONTENT)
    (tmp_path / FILE_NAME).write_bytes(b"torn")
    store.keep(store.read())
    store.write(replace(CHECKPOINT, tick=9).to_bytes())
    (tmp_path / FILE_NAME).write_bytes(b"torn again")
    assert store.read() == CHECKPOINT


def test_where_none_is_whole_what_is_the_matter_with_each_is_said(tmp_path: Path) -> None:
    (tmp_path / FILE_NAME).write_bytes(CONTENT[:-1])
    (tmp_path / BEFORE).write_bytes(b"something else")
    with pytest.raises(InputError, match=r"(?s)cut or changed.*not a checkpoint"):
        Store(tmp_path).read()


def test_another_format_is_refused_by_its_number() -> None:
    with pytest.raises(InputError, match="of format 7: this version reads format 1"):
        Checkpoint.from_bytes(MAGIC + (7).to_bytes(2, "little") + CONTENT[len(MAGIC) + 2 :])


@given(st.integers(0, len(CONTENT) - 1), st.integers(1, 255))
def test_a_changed_byte_is_noticed_wherever_it_is(place: int, change: int) -> None:
    changed = bytearray(CONTENT)
    changed[place] ^= change
    with pytest.raises(InputError):
        Checkpoint.from_bytes(bytes(changed))


@pytest.mark.parametrize(
    ("field", "value", "told"),
    [
        ("tick", "seven", "tick: must be int"),
        ("states", {"a": b""}, "states: must map int to bytes"),
        ("dead", (-1,), "dead: must be numbers from 0"),
        ("counts", (1, 2), "counts: must be four numbers"),
    ],
)
def test_a_whole_file_of_other_values_is_refused_by_field(field: str, value: object, told: str) -> None:
    content = replace(CHECKPOINT, **{field: value}).to_bytes()  # type: ignore[arg-type]
    with pytest.raises(InputError, match=told):
        Checkpoint.from_bytes(content)
