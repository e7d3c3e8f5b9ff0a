"""Signals as they were after every test; a small made-up run, and ways to record it."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from deploy.recordings.format import Header
from deploy.recordings.writer import Recorder

PERIOD_NS = 4_096_000


@pytest.fixture(autouse=True)
def signals_again() -> Iterator[None]:
    """A command that is interrupted ignores further signals for good, and so would every process started after it."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@dataclass
class MadeUpRun:
    """Numbers of a run that never was: ``ticks`` intervals of a few cells and parcels."""

    ticks: int = 12
    rows: int = 3
    columns: int = 4
    sensors: int = 2
    parcels: int = 1
    wheels_change: bool = False
    wheels_follow: bool = False
    """Whether wheels run at the speed of the drives before, once there were any."""
    events: list[dict[str, Any]] = field(default_factory=list)
    faults: list[dict[str, Any]] = field(default_factory=list)
    extra: dict[str, Any] = field(default_factory=dict)
    """Of the header, what not every recording has."""

    def __post_init__(self) -> None:
        draw = np.random.default_rng(5)
        n, instants = self.rows * self.columns, self.ticks + 1
        self.presence: NDArray[np.bool_] = draw.random((instants, n, self.sensors)) < 0.5
        steps = instants if self.wheels_change else 1
        self.drives = np.resize(draw.standard_normal((steps, n, 2)), (instants, n, 2))
        self.wheel_speeds = np.resize(draw.standard_normal((steps, n, 2)), (instants, n, 2))
        if self.wheels_follow:
            self.wheel_speeds[1:] = self.drives[:-1]
        self.states = np.cumsum(draw.standard_normal((instants, self.parcels, 6)) * 0.02, axis=0)

    @property
    def header(self) -> Header:
        made = Header(
            run="r1",
            title="A made-up run",
            scene_name="made_up",
            scene={"duration_s": 1.0},
            versions={"python": "3.11"},
            period_ns=PERIOD_NS,
            pitch_m=0.1,
            cells=[[r, c] for r in range(self.rows) for c in range(self.columns)],
            positions_m=[[0.1 * c, 0.1 * r] for r in range(self.rows) for c in range(self.columns)],
            sensors_m=[[0.0, 0.01 * s] for s in range(self.sensors)],
            footprints_m=[[[-0.1, -0.05], [0.1, -0.05], [0.1, 0.05], [-0.1, 0.05]]] * self.parcels,
        )
        made.update(self.extra)  # type: ignore[typeddict-item]
        return made

    def feed(self, recorder: Recorder, *, end: bool = True) -> None:
        """Record all of it, except how it ended."""
        for tick in range(self.ticks + end):
            recorder.tick(
                tick,
                tick * PERIOD_NS,
                self.presence[tick],
                self.drives[tick] if tick < self.ticks else None,
                self.wheel_speeds[tick],
                self.states[tick],
            )
        for event in self.events:
            recorder.event(event)
        for fault in self.faults:
            recorder.fault(fault)

    def record(self, folder: Path, status: str = "ok", digest: str | None = "ab" * 32) -> Path:
        """Record all of it and return the file."""
        recorder = Recorder(folder, self.header)
        self.feed(recorder)
        recorder.close(status, digest)
        return recorder.path


@pytest.fixture
def made_up_run() -> Callable[..., MadeUpRun]:
    """Makes runs of the size asked for."""
    return MadeUpRun


@pytest.fixture
def recorder(tmp_path: Path) -> Iterator[Recorder]:
    """An open recorder of the ordinary made-up run."""
    with Recorder(tmp_path / "open", MadeUpRun().header) as opened:
        yield opened
