"""Runs that fail, hang or are killed end as failed, and the others go on."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest

from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene
from deploy.studies.campaign.pool import ExecutorPool
from deploy.studies.campaign.result import CaseRecord, run_case
from deploy.workers.plan import RunOptions
from deploy.workers.pool import WorkerError

pytestmark = pytest.mark.slow

FIRMWARE = """
import os, signal, time
from pathlib import Path
from bus.spec import Spec
from cell_firmware.cell import CellFirmware, CellOutputs

class Parameters(Spec):
    how: str

class Program(CellFirmware):
    Parameters = Parameters

    def init(self, cell):
        return 0

    def step(self, state, inputs):
        how, marker = self.parameters.how, Path(__file__).with_name("died")
        if state == 5 and how == "sleeps":
            time.sleep(100)
        if state == 5 and (how == "dies" or (how == "dies once" and not marker.exists())):
            marker.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        if state == 5 and how == "raises":
            raise ValueError("so it is")
        return state + 1, CellOutputs(speed_m_s=(0.1, 0.0))
"""
LIMIT_S = 15.0


def scene(tmp_path: Path, how: str, deadline_s: float = 3600.0) -> Scene:
    program = tmp_path / "program.py"
    program.write_text(FIRMWARE)
    return load_scene(
        "motors",
        [
            Override(("cells", "firmware"), f"{program}:Program", ""),
            Override(("cells", "parameters"), {"how": how}, ""),
            Override(("duration_s",), 0.1, ""),
            Override(("stall",), {"policy": "abort", "deadline_s": deadline_s}, ""),
        ],
    )


def nothing() -> None:
    pass


@pytest.fixture(scope="module")
def endings(tmp_path_factory: pytest.TempPathFactory) -> list[CaseRecord]:
    """Of a run each: in order, what misbehaves before what doesn't, in the same two workers."""
    folder = tmp_path_factory.mktemp("programs")
    scenes = [
        scene(folder, "dies once"),
        scene(folder, "sleeps"),
        scene(folder, "dies"),
        scene(folder, "sleeps", deadline_s=0.2),
        scene(folder, "raises"),
        load_scene("motors", [Override(("friction", "coefficient_s_per_m"), 1e300, "")]),
        scene(folder, "is well"),
        scene(folder, "is well"),
    ]
    with ExecutorPool(2, LIMIT_S, nothing) as pool:
        found = dict(pool.map(scenes))
    assert found.keys() == set(range(len(scenes)))
    return [found[place] for place in range(len(scenes))]


def test_a_run_whose_process_is_killed_is_tried_once_more(endings: list[CaseRecord]) -> None:
    assert endings[0] == CaseRecord(
        status="ok", parcels=endings[6].parcels, digest=endings[0].digest, wall_s=endings[0].wall_s
    )


def test_a_run_whose_process_is_killed_twice_has_failed(endings: list[CaseRecord]) -> None:
    assert (endings[2].status, endings[2].reason) == (
        "failed",
        "its process was lost twice: killed by SIGKILL",
    )


def test_a_run_that_hangs_is_ended_at_the_limit(endings: list[CaseRecord]) -> None:
    assert (endings[1].status, endings[1].reason) == ("failed", "not over after 15 s (--limit)")


def test_a_run_that_fails_says_why(endings: list[CaseRecord]) -> None:
    assert [ending.status for ending in endings[3:5]] == ["failed", "failed"]
    assert "NeverReturned" in endings[3].reason
    assert endings[4].cells_lost == 18
    assert endings[5].status != "ok"
    assert endings[5].reason


def test_runs_after_those_end_as_if_they_had_been_alone(endings: list[CaseRecord]) -> None:
    assert endings[6].status == "ok"
    assert endings[6].digest == endings[7].digest is not None


def test_a_run_of_a_campaign_has_the_digest_and_the_parcels_of_mdms_run(tmp_path: Path) -> None:
    short = load_scene("noisy", [Override(("duration_s",), 0.1, ""), Override(("seed",), 9, "")])
    alone = run(short, RunOptions(transport="memory", output=tmp_path, picture=False), quiet=True).summary
    ending = run_case(short)
    assert (ending.status, ending.digest) == ("ok", alone.digest)
    assert [parcel.state for parcel in ending.parcels] == [parcel.state for parcel in alone.parcels]


def test_a_pool_without_workers_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("deploy.studies.campaign.pool.PRELOAD", ())
    monkeypatch.setattr("deploy.studies.campaign.pool.WorkerLoop", lambda *_: partial(int, "no number"))
    with (
        ExecutorPool(2, LIMIT_S, nothing) as pool,
        pytest.raises(WorkerError, match=r"end before their first run: .*no number"),
    ):
        list(pool.map([load_scene("motors")]))


def test_a_pool_whose_workers_cant_be_forked_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("deploy.studies.campaign.pool.PRELOAD", ("no_such_module",))
    with (
        ExecutorPool(1, LIMIT_S, nothing) as pool,
        pytest.raises(WorkerError, match="process that starts workers"),
    ):
        list(pool.map([load_scene("motors")]))
