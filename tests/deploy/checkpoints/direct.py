"""A whole run in one call stack: the plant's process, all cells in one shard, and nothing between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from bus.lockstep.counters import Loss
from bus.partition import Partition
from bus.state import load_state, save_state
from bus.wire.frames import DriveFrame, SenseFrame
from cell_firmware.cell import records_of
from cell_firmware.loader import load
from cell_firmware.shard import Shard
from deploy.recordings.digest import Digest
from deploy.runs.setup import process_of, sensor_schema
from deploy.scenes.scene import Scene
from deploy.workers.worker import WorkerConfig, build_shard
from plant.plant import Plant
from plant.process import TickRecord


@dataclass
class DirectHost:
    """Hands what the plant says to the shard, and what the cells do back."""

    shard: Shard
    frame: SenseFrame | None = None

    def publish(self, frame: SenseFrame) -> None:
        self.frame = frame

    def gather(self, tick: int) -> tuple[DriveFrame, Sequence[Loss]]:
        sense = self.frame
        assert sense is not None
        done = self.shard.step(
            tick,
            sense.presence,
            sense.encoder_m,
            None,
            sense.level,
            label=sense.label,
            camera=sense.picture,
        )
        assert not done.failures
        return DriveFrame(tick, done.drive), []

    def mark_dead(self, cells: Sequence[int], tick: int) -> None:
        del tick
        self.shard.retire(self.shard.cells[cell] for cell in cells)


class DirectRun:
    """A scene's run, tick by tick."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        plant = Plant(scene.plant_spec())
        readings = sensor_schema(scene, plant.sense())
        partition = Partition.even(plant.array.lattice, 1)
        order = WorkerConfig(
            scene=scene,
            array=plant.array,
            partition=partition,
            wire="packed",
            run="direct",
            connect="",
            sensors=readings,
            register_requests=(),
            metered=True,
            byte_accurate_links=False,
            joins_running=False,
            keys=(),
            own_process=False,
        )
        self.shard, _ = build_shard(order, 0)
        self.digest = Digest(scene.canonical())
        self.events: list[Any] = []
        self.process = process_of(scene, plant, DirectHost(self.shard), readings, self._observe)

    def _observe(self, record: TickRecord) -> None:
        self.digest.tick(record.tick, record.sense.presence, record.drives, record.after)
        self.events += record.events

    def go(self, ticks: int) -> DirectRun:
        """Run so many ticks."""
        for _ in range(ticks):
            assert self.process.time_ns < self.scene.duration_ns
            self.process.step()
        self.process.report()
        return self

    def remember(self) -> tuple[bytes, bytes, bytes]:
        """Plant, cells, digest."""
        records = records_of(load(self.scene.cells))
        return save_state(self.process), save_state(self.shard, records), self.digest.value

    def recall(self, memory: tuple[bytes, bytes, bytes]) -> DirectRun:
        """Go back, in a run made anew."""
        load_state(self.process, memory[0])
        load_state(self.shard, memory[1], records_of(load(self.scene.cells)))
        self.digest.value = memory[2]
        return self
