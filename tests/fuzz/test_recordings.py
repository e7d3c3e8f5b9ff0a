"""No spoilt recording makes more of the loader than a recording that can be used, or an InputError."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.fuzz.conftest import Rounds
from tests.fuzz.mutator import Mutator
from tests.fuzz.recordings import SpoiltMessages, record, use


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With a good recording."""
    folder = tmp_path_factory.mktemp("recordings")
    record(folder)
    return folder


def test_the_recording_that_is_spoilt_is_good_before(folder: Path) -> None:
    recording = use(folder / "recording.mcap")
    assert recording is not None
    assert (recording.status, len(recording.tick), sorted(recording.registers)) == ("ok", 4, ["led", "u"])


def test_a_file_of_which_bytes_are_changed_or_cut_is_loaded_or_refused(folder: Path, rounds: Rounds) -> None:
    mutator, path = (
        Mutator([(folder / "recording.mcap").read_bytes()], "tests file", None),
        folder / "changed.mcap",
    )
    loaded: list[bool] = []
    for _ in rounds(250):
        path.write_bytes(mutator.next())
        loaded.append(use(path) is not None)
    assert 0 < sum(loaded) < len(loaded)


def test_a_whole_file_of_spoilt_messages_is_loaded_or_refused(folder: Path, rounds: Rounds) -> None:
    spoilt = SpoiltMessages(folder, "tests messages")
    loaded = [use(spoilt.next()) is not None for _ in rounds(250)]
    assert 0 < sum(loaded) < len(loaded)
