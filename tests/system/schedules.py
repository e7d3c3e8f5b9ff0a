"""Random schedules of what may happen to the processes of a run: kills, stops; and what must hold after."""

from __future__ import annotations

import contextlib
import io
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from unittest.mock import patch

import numpy as np
from rich.console import Console

from bus.random_streams import rng
from bus.spec import NO_LATENCY, BusSpec
from deploy.recordings.reader import load
from deploy.runs.run import run
from deploy.runs.summary import Outcome
from deploy.runs.summary_table import print_summary
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene
from deploy.workers.plan import RunOptions
from plant.process import PlantProcess

CELLS = 18
RUN_S = 0.4
"""Simulated, and at least as much on the wall clock."""
DEADLINE_S, LEASE_S = 1.2, 1.0

_STARTS = 3
"""Attempts to begin: on a busy machine a process may be held up for longer than the lease before the first tick."""

Action = Literal["kill", "stop", "stop the plant"]
_ACTIONS: tuple[Action, ...] = ("kill", "stop", "stop the plant")


@dataclass(frozen=True)
class Blow:
    """One thing that happens.

    Attributes:
        at_s: Wall time from the first tick on.
        action: What.
        worker: To whom; of no matter for the plant.
        for_s: How long a stop lasts.
    """

    at_s: float
    action: Action
    worker: int
    for_s: float


@dataclass(frozen=True)
class Schedule:
    """What happens to a run of 18 cells, one a process."""

    seed: int
    policy: str
    respawn: int
    blows: tuple[Blow, ...]
    bus: BusSpec = NO_LATENCY

    @classmethod
    def drawn(cls, seed: int) -> Schedule:
        """The schedule of a seed."""
        draw = rng(seed, "tests.schedules")
        policy = str(draw.choice(["coast", "brake", "hold", "abort"], p=[0.3, 0.3, 0.3, 0.1]))
        blows = [
            Blow(
                float(draw.uniform(0.0, RUN_S)),
                _ACTIONS[int(draw.choice(3, p=[0.55, 0.35, 0.1]))],
                int(draw.integers(CELLS)),
                float(draw.choice([0.03, 0.1, 0.3, 1.5])),
            )
            for _ in range(int(draw.integers(1, 6)))
        ]
        return cls(seed, policy, int(draw.choice([0, 0, 2, 6])), tuple(sorted(blows, key=lambda b: b.at_s)))

    def scene(self) -> Scene:
        """What runs."""
        changes: dict[tuple[str | int, ...], Any] = {
            ("duration_s",): RUN_S,
            ("seed",): self.seed,
            ("array", "rows"): 3,
            ("array", "columns"): 6,
            ("cells", "parameters", "held"): [{"columns": [0, 0], "speed_m_s": [0.3, 0.0]}],
            ("parcels", 0, "position_m"): [0.0, 0.0],
            ("bus",): self.bus.model_dump(),
            ("stall",): {
                "policy": self.policy,
                "deadline_s": DEADLINE_S,
                "lease_s": LEASE_S,
            },
        }
        return load_scene("heat", [Override(path, value, "") for path, value in changes.items()])


@dataclass(frozen=True)
class Verdict:
    """What came of a schedule.

    Attributes:
        status: Of the run.
        lost: Cells that were lost, each time counted.
        came_back: Cells that took part again, likewise.
        wrong: What does not hold that must, in words; empty where all does.
    """

    status: str
    lost: int
    came_back: int
    wrong: tuple[str, ...]


def carry_out(schedule: Schedule, folder: Path) -> Verdict:
    """Run, let it happen, and look whether all holds that must."""
    scene = schedule.scene()
    hand = _Hand(schedule)
    options = RunOptions(
        processes="each", output=folder / "real", picture=False, realtime=1.0, respawn=schedule.respawn
    )
    with hand.watching():
        outcome = run(scene, options, quiet=True)
    print_summary(outcome.summary, Console(file=io.StringIO()))  # whatever happened can be told
    wrong = [*_stated(outcome, schedule), *_left_behind(hand.seen), *_recorded(outcome, folder / "real")]
    replayed = RunOptions(
        processes=0, transport="memory", output=folder / "again", picture=False, replay=folder / "real"
    )
    again = run(scene, replayed, quiet=True)
    if again.summary.digest != outcome.summary.digest:
        wrong.append(f"the digest differs when the losses are injected: {outcome.summary.faults}")
    kinds = [fault["kind"] for fault in outcome.summary.faults]
    lost = sum(kind in ("disconnected", "timed_out") for kind in kinds)
    back = sum(len(f["cells"]) for f in outcome.summary.faults if f["kind"] == "respawn")
    return Verdict(outcome.summary.status, lost, back, tuple(wrong))


def _stated(outcome: Outcome, schedule: Schedule) -> list[str]:
    """A run ends well, by the policy that says so, or since no cell is left; either names a cell."""
    status, reason = outcome.summary.status, outcome.summary.reason or ""
    if status == "ok":
        return []
    if schedule.policy == "abort" and status in ("failed", "stalled") and "stall.policy is abort" in reason:
        return []
    if len(outcome.summary.cells_lost) == CELLS and reason.startswith("no cell was alive at the end: cell"):
        return [] if status == "failed" else [f"{status}, though no cell was left"]
    return [f"{status}: {reason}\n{outcome.detail}"]


def _left_behind(seen: set[int]) -> list[str]:
    """No process that the run started is left."""
    deadline = time.monotonic() + 5.0
    left = set(seen)
    while left and time.monotonic() < deadline:
        left = {pid for pid in left if _runs(pid)}
        time.sleep(0.01)
    return [f"process {pid} is left" for pid in sorted(left)]


def _recorded(outcome: Outcome, folder: Path) -> list[str]:
    """The recording can be read, and has every tick once."""
    recording = load(folder)
    ticks = np.arange(outcome.summary.ticks + 1)
    if not np.array_equal(recording.tick, ticks):
        return [f"the recording has ticks {recording.tick.tolist()}, not 0..{outcome.summary.ticks}"]
    if recording.digest != outcome.summary.digest or recording.status != outcome.summary.status:
        return [f"the recording says {recording.status}, {recording.digest}"]
    return []


class _Hand:
    """Carries a schedule out from the first tick on."""

    def __init__(self, schedule: Schedule) -> None:
        self._schedule = schedule
        self.seen: set[int] = set()
        self.begun = False
        self._over = threading.Event()

    def watching(self) -> Any:
        """Wait for the plant's process to begin."""
        begin, hand = PlantProcess.run, self

        def run_and_strike(process: PlantProcess) -> Any:
            hand.begun = True
            thread = threading.Thread(target=hand._strike, daemon=True)
            thread.start()
            try:
                return begin(process)
            finally:
                hand._over.set()
                thread.join()
                hand.seen |= set(_family().values())

        return patch.object(PlantProcess, "run", run_and_strike)

    def _strike(self) -> None:
        begun = time.monotonic()
        waking: list[tuple[float, int]] = []
        blows = list(self._schedule.blows)
        while not self._over.wait(0.002):
            now = time.monotonic() - begun
            for pid in [pid for at, pid in waking if at <= now]:
                _signal(pid, signal.SIGCONT)
            waking = [(at, pid) for at, pid in waking if at > now]
            while blows and blows[0].at_s <= now:
                self._one(blows.pop(0), now, waking)
        for _, pid in waking:
            _signal(pid, signal.SIGCONT)

    def _one(self, blow: Blow, now: float, waking: list[tuple[float, int]]) -> None:
        if blow.action == "stop the plant":
            own = str(os.getpid())
            code = f"import os,time; os.kill({own},19); time.sleep({blow.for_s}); os.kill({own},18)"
            subprocess.run([sys.executable, "-S", "-c", code], check=False, timeout=10)
            return
        workers = _family()
        self.seen |= set(workers.values())
        pid = workers.get(blow.worker)
        if pid is None:
            return  # it has gone already
        _signal(pid, signal.SIGKILL if blow.action == "kill" else signal.SIGSTOP)
        if blow.action == "stop":
            waking.append((now + blow.for_s, pid))


def _family() -> dict[int, int]:
    """Process ids of this process's workers, by their place in the lattice; -1 is the process that forks them."""
    parents: dict[int, int] = {}
    names: dict[int, str] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                text = (entry / "stat").read_text()
            except OSError:
                continue
            pid = int(entry.name)
            names[pid] = text[text.index("(") + 1 : text.rindex(")")]
            parents[pid] = int(text[text.rindex(")") :].split()[2])
    found: dict[int, int] = {}
    for pid, parent in parents.items():
        if parents.get(parent) == os.getpid() and names[pid].startswith("cell "):
            row, column = names[pid].removeprefix("cell ").split(",")
            found[6 * int(row) + int(column)] = pid
            found[-1] = parent
    return found


def _signal(pid: int, number: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, number)


def _runs(pid: int) -> bool:
    try:
        text = (Path("/proc") / str(pid) / "stat").read_text()
    except OSError:
        return False
    return text[text.rindex(")") + 2] != "Z"
