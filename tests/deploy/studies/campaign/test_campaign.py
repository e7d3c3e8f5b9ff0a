"""What is run, in which order, and what a campaign comes to, whoever runs it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from deploy.scenes.files import scene_text
from deploy.scenes.scene import Scene
from deploy.studies.campaign.cases import cases_of
from deploy.studies.campaign.result import CaseRecord
from deploy.studies.campaign.runner import Campaign, Journal
from deploy.studies.campaign.spec import read_options
from deploy.util.signals import Interrupted, Interruption

OK = CaseRecord(status="ok")


@dataclass
class Executor:
    """Runs nothing, last scene first; ends as requested after so many runs."""

    ending: CaseRecord = OK
    interrupted_after: int = 10**9
    ran: list[Scene] = field(default_factory=list)

    def map(self, scenes: Iterable[Scene]) -> Iterator[tuple[int, CaseRecord]]:
        for place, scene in reversed(list(enumerate(scenes))):
            if len(self.ran) == self.interrupted_after:
                raise Interrupted
            self.ran.append(scene)
            yield place, self.ending


def campaign(folder: Path, **given: Any) -> Campaign:
    spec = read_options({"scene": "noisy", "fault": "crash", "share": "0.1,0.2", "seeds": "2", **given})
    return Campaign(spec, cases_of(spec, scene_text("noisy")), folder, quiet=True)


def test_undisturbed_runs_come_first_each_once_and_those_that_are_over_are_not_run_again(
    tmp_path: Path,
) -> None:
    first, second, third = Executor(interrupted_after=4), Executor(), Executor()
    with Journal(tmp_path) as journal, pytest.raises(Interrupted):
        campaign(tmp_path).execute(first, journal)
    assert [(len(scene.faults), scene.seed) for scene in first.ran] == [(0, 2), (0, 1), (1, 2), (1, 1)]
    with Journal(tmp_path) as journal:
        campaign(tmp_path).execute(second, journal)
        assert len(journal.runs) == 4
        campaign(tmp_path).execute(third, journal)
    assert [(scene.faults[0].share, scene.seed) for scene in second.ran] == [(0.1, 2), (0.1, 1)]
    assert third.ran == []


def test_a_campaign_none_of_whose_runs_comes_to_its_end_has_failed(tmp_path: Path) -> None:
    wanted = campaign(tmp_path)
    with Journal(tmp_path) as journal:
        wanted.execute(Executor(CaseRecord(status="unstable", reason="why")), journal)
    report = wanted.run(1, Interruption())
    assert (report.status, report.reason) == (
        "failed",
        "no run completed; the first: unstable: why",
    )
    assert [(values, seed) for values, seed, _ in report.failed()] == [
        ({"fault.share": share}, seed) for share in (0.1, 0.2) for seed in (1, 2)
    ]
