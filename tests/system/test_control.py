"""A run is paused, stepped, moved in, reset and stopped from outside; pauses and steps change nothing of the result."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from deploy.errors import DeployError, InputError
from deploy.live.client import LiveRun
from deploy.live.frame import RunFrame
from deploy.recordings.reader import load
from deploy.runs.run import run
from deploy.runs.summary import Outcome
from deploy.workers.plan import Processes, RunOptions
from tests.system.test_live import TICKS, scene

pytestmark = [pytest.mark.slow, pytest.mark.timeout(120)]


class Controlled:
    """A run in a thread that begins paused, and its client."""

    def __init__(self, folder: Path, processes: Processes = 2, **options: Any) -> None:
        self.folder = folder
        self.outcome: Outcome | None = None
        chosen = RunOptions(processes=processes, output=folder, picture=False, paused=True, **options)
        self.thread = threading.Thread(target=self._run, args=(chosen,))
        self.thread.start()
        self.live = self._attached()

    def _run(self, options: RunOptions) -> None:
        self.outcome = run(scene(), options, quiet=True)

    def _attached(self) -> LiveRun:
        deadline = time.monotonic() + 60.0
        while True:
            try:
                return LiveRun.attach(self.folder)
            except (InputError, DeployError):
                assert time.monotonic() < deadline
                assert self.thread.is_alive()
                time.sleep(0.02)

    def end(self) -> Outcome:
        self.thread.join(60)
        self.live.close()
        assert self.outcome is not None
        return self.outcome


@pytest.mark.parametrize("processes", ["each", 2])
def test_pauses_and_steps_leave_the_digest_as_it_is(tmp_path: Path, processes: Processes) -> None:
    options = RunOptions(processes=processes, output=tmp_path / "plain", picture=False, registers=1)
    plain = run(scene(), options, quiet=True)
    controlled = Controlled(tmp_path / "controlled", processes, registers=1)
    live = controlled.live
    for tick in range(1, 101):
        assert live.step()["tick"] == tick
    frame = live.frame()
    assert (frame.tick, frame.state) == (100, "paused")
    readings = live.registers([(0, 0), (1, 2)])
    assert (readings.tick, sorted(readings.cells)) == (99, [(0, 0), (1, 2)])
    shown = readings.cells[1, 2]
    assert shown["message.sent"] == [True] * 4
    assert shown["message.vx_m_s"] == [shown["firmware.speed_m_s"][0]] * 4
    live.resume()
    outcome = controlled.end()
    assert outcome.summary.status == "ok"
    assert outcome.summary.digest == plain.summary.digest
    # registers that were shown once more are neither recorded nor counted again
    assert load(controlled.folder).register_tick.tolist() == list(range(TICKS))
    assert outcome.summary.messages == plain.summary.messages
    assert not any(name.startswith("message.") for name in load(controlled.folder).registers)
    kinds = [record["kind"] for record in load(controlled.folder).control]
    assert kinds == ["step"] * 100 + ["resume"]


def test_a_paused_run_suspends_its_deadlines(tmp_path: Path) -> None:
    short = scene(stall={"deadline_s": 0.5, "lease_s": 1.0, "policy": "abort"})
    outcomes: list[Outcome] = []
    options = RunOptions(processes=2, output=tmp_path / "run", picture=False, paused=True)
    thread = threading.Thread(target=lambda: outcomes.append(run(short, options, quiet=True)))
    thread.start()
    with wait_for(lambda: LiveRun.attach(tmp_path / "run")) as live:
        live.step(5)
        time.sleep(2.5)
        live.step(5)
        live.resume()
    thread.join(60)
    assert outcomes[0].summary.status == "ok"


def wait_for(attach: Callable[[], LiveRun]) -> LiveRun:
    deadline = time.monotonic() + 60.0
    while True:
        try:
            return attach()
        except (InputError, DeployError):
            assert time.monotonic() < deadline
            time.sleep(0.02)


def test_a_parcel_that_was_moved_by_hand_is_moved_again_by_a_replay(tmp_path: Path) -> None:
    controlled = Controlled(tmp_path / "moved")
    live = controlled.live
    live.step(20)
    live.move(0, 0.01, 0.02, 0.3)
    frame = live.frame()
    assert frame.parcels[0].tolist() == [0.01, 0.02, 0.3, 0.0, 0.0, 0.0]
    live.resume()
    first = controlled.end()
    again = run(
        scene(), RunOptions(output=tmp_path / "again", picture=False, replay=controlled.folder), quiet=True
    )
    assert (first.summary.status, again.summary.status) == ("ok", "ok")
    assert again.summary.digest == first.summary.digest
    assert load(tmp_path / "again").parcels[20, 0, :3].tolist() == [0.01, 0.02, 0.3]


def test_a_reset_begins_again_in_a_new_folder_and_a_stop_ends(tmp_path: Path) -> None:
    controlled = Controlled(tmp_path / "run")
    controlled.live.step(7)
    controlled.live.reset()
    controlled.live.close()
    with wait_for(lambda: LiveRun.attach(tmp_path / "run-2")) as live:
        assert live.status()["tick"] == 0
        live.step(3)
        live.stop()
    outcome = controlled.end()
    first = load(tmp_path / "run")
    assert (first.status, len(first.tick)) == ("interrupted", 8)
    assert outcome.summary.status == "interrupted"
    assert outcome.summary.reason == "stopped by an operator at 0.012288 s of simulated time"
    assert outcome.summary.output == str(tmp_path / "run-2")
    assert outcome.summary.ticks == 3


def test_a_fault_comes_once_with_the_frames_and_its_cell_is_lost(tmp_path: Path) -> None:
    controlled = Controlled(tmp_path / "run")
    live = controlled.live
    live.step(2)
    number = live.inject("crash", cell=[1, 2])
    live.step(2)
    frames = [live.frame() for _ in range(3)]
    assert [len(frame.faults) for frame in frames] == [1, 0, 0]
    cell = live.header["cells"].index([1, 2])
    assert [int(frame.health[cell]) for frame in frames] == [2, 2, 2]
    live.repair(number)
    live.step()
    assert live.frame().health[cell] == 0
    live.stop()
    controlled.end()


def shown(live: LiveRun) -> Iterator[RunFrame]:
    """All frames until the run ends."""
    with suppress(DeployError):
        while True:
            yield live.frame()


def test_viewers_that_look_all_the_time_change_nothing_of_the_result(tmp_path: Path) -> None:
    plain = run(scene(), RunOptions(processes=0, output=tmp_path / "plain", picture=False), quiet=True)
    controlled = Controlled(tmp_path / "seen")
    controlled.live.resume()
    frames = list(shown(controlled.live))
    outcome = controlled.end()
    assert outcome.summary.digest == plain.summary.digest
    ticks = [frame.tick for frame in frames]
    assert ticks == sorted(ticks)
    assert ticks[-1] <= TICKS
    recorded = load(tmp_path / "seen")
    for frame in frames[:: max(len(frames) // 20, 1)]:
        if frame.tick < TICKS:
            assert frame.parcels.tolist() == recorded.parcels[frame.tick].tolist()
    events = [event for frame in frames for event in frame.events]
    assert events == [dict(event) for event in recorded.events][: len(events)]
