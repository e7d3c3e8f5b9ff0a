"""What is over is kept, whatever ends the campaign."""

from __future__ import annotations

import errno
import io
from dataclasses import replace
from pathlib import Path

import pytest

from deploy.errors import DeployError, InputError
from deploy.scenes.files import scene_text
from deploy.studies.campaign.cases import Case, cases_of
from deploy.studies.campaign.result import CaseRecord, CaseOutcome, ParcelEnd
from deploy.studies.campaign.runner import FILE_NAME, Journal
from deploy.studies.campaign.spec import read_options

OUTCOME = CaseOutcome(
    status="failed",
    reason="“why”\nand more",
    succeeded=False,
    error_m=0.1 + 0.2,
    time_s=None,
    cells_lost=1,
    digest="d",
    wall_s=0.5,
)
ENDING = CaseRecord(
    status="ok", parcels=(ParcelEnd("at_rest", 1 / 3, (0.1, 1 / 7), ((0.1, 2.0),)),), digest="e"
)


@pytest.fixture
def case() -> Case:
    return cases_of(read_options({"scene": "heat", "vary": ("duration_s=1,2",)}), scene_text("heat")).cases[1]


def test_what_was_added_is_there_again_to_the_last_digit(tmp_path: Path, case: Case) -> None:
    with Journal(tmp_path) as journal:
        journal.add_baseline("key", 3, ENDING)
        journal.add_run(case, 3, OUTCOME)
    with Journal(tmp_path) as journal:
        assert journal.baselines == {"key": ENDING}
        assert journal.runs == {(1, 3): OUTCOME}


@pytest.mark.parametrize("left", [1, 40, -1])
def test_a_torn_last_line_is_dropped_and_the_next_is_whole(tmp_path: Path, case: Case, left: int) -> None:
    with Journal(tmp_path) as journal:
        journal.add_run(case, 3, OUTCOME)
        whole = (tmp_path / FILE_NAME).stat().st_size
        journal.add_run(case, 4, OUTCOME)
    content = (tmp_path / FILE_NAME).read_bytes()
    torn = len(content) - 1 if left < 0 else whole + left
    (tmp_path / FILE_NAME).write_bytes(content[:torn])
    with Journal(tmp_path) as journal:
        assert journal.runs == {(1, 3): OUTCOME}
        journal.add_run(case, 5, replace(OUTCOME, status="ok"))
    with Journal(tmp_path) as journal:
        assert set(journal.runs) == {(1, 3), (1, 5)}


def test_a_line_that_is_no_run_is_named(tmp_path: Path, case: Case) -> None:
    with Journal(tmp_path) as journal:
        journal.add_run(case, 3, OUTCOME)
    with (tmp_path / FILE_NAME).open("a") as file:
        file.write('{"case": 1}\n')
    with pytest.raises(InputError, match=r"runs\.jsonl: line 2 is not a run of a campaign"):
        Journal(tmp_path)


class FullDisk:
    """Takes a few bytes, and no more."""

    def __init__(self, file: io.FileIO, room: int) -> None:
        self.file, self.room = file, room

    def write(self, content: bytes) -> int:
        if self.room == 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        taken = self.file.write(content[: self.room])
        self.room -= taken
        return taken


def test_a_full_disk_fails_the_campaign_and_finished_runs_are_retained(tmp_path: Path, case: Case) -> None:
    with Journal(tmp_path) as journal:
        journal.add_run(case, 3, OUTCOME)
        journal._file, file = FullDisk(journal._file, 20), journal._file
        with pytest.raises(DeployError, match=r"can't write .*runs\.jsonl: No space left"):
            journal.add_run(case, 4, OUTCOME)
        journal._file = file
    with Journal(tmp_path) as journal:
        assert set(journal.runs) == {(1, 3)}
