"""What a campaign makes of runs that a cluster has completed or given up."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pytest

from deploy.errors import DeployError
from deploy.studies.campaign.cluster import record_of
from deploy.studies.campaign.result import CaseRecord

OK = CaseRecord(status="ok")


class KilledWorker(Exception):
    allowed_failures = 3


@dataclass
class Future:
    """As Dask's."""

    status: str
    error: Exception | None = None

    def exception(self) -> Exception | None:
        return self.error


def test_a_completed_run_is_its_record() -> None:
    assert record_of(Future("finished"), OK, "tcp://a:1") is OK


def test_a_run_that_ended_every_worker_it_was_given_to_has_failed() -> None:
    record = record_of(Future("error", KilledWorker()), None, "tcp://a:1")
    assert (record.status, record.reason) == ("failed", "its worker was lost 4 times")


@pytest.mark.parametrize(
    ("future", "said"),
    [
        (Future("error", OSError("no space")), "a worker of tcp://a:1: no space"),
        (Future("cancelled"), "lost the scheduler tcp://a:1; completed runs are kept"),
        (Future("lost"), "lost the scheduler tcp://a:1; completed runs are kept"),
    ],
)
def test_a_cluster_that_cant_run_anything_ends_the_campaign(future: Any, said: str) -> None:
    with pytest.raises(DeployError) as raised:
        record_of(future, None, "tcp://a:1")
    assert str(raised.value) == said
