"""A run in one call stack, tick by tick, with its digest."""

from __future__ import annotations

from typing import Any

from deploy.recordings.digest import Digest
from deploy.runs.backends import InProcess
from deploy.runs.simulation import Simulation
from deploy.scenes.scene import Scene
from plant.tick import TickHooks, TickRecord


class DirectRun:
    """A simulation, its digest and its events."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.digest = Digest(scene.canonical())
        self.events: list[Any] = []
        cells = InProcess()
        self.simulation = Simulation.open(scene, cells, hooks=TickHooks(after_tick=(self._observe,)))
        self.process = self.simulation.process
        self.shard = cells.shard

    def _observe(self, record: TickRecord) -> None:
        self.digest.tick(record.tick, record.sense.presence, record.drives, record.after)
        self.events += record.events

    def go(self, ticks: int) -> DirectRun:
        """Run so many ticks."""
        for _ in range(ticks):
            assert self.simulation.step() is not None
        return self

    def remember(self) -> tuple[bytes, bytes, bytes, bytes]:
        """Plant, cells, digest."""
        return (*self.simulation.save_state(), self.digest.value, self.digest.motion)

    def recall(self, memory: tuple[bytes, bytes, bytes, bytes]) -> DirectRun:
        """Go back, in a new run."""
        self.simulation.load_state(memory[:2])
        self.digest.value, self.digest.motion = memory[2:]
        return self
