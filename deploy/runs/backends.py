"""Cells of a simulation: in the calling thread, or on the bus."""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol, final

import numpy as np

from bus.errors import StateError
from bus.lockstep.counters import Loss, MessageCounters
from bus.partition import Partition
from bus.state import load_state, save_state
from bus.wire.frames import DriveFrame, SenseFrame
from cell_firmware.agent import failures_of, report_text
from cell_firmware.loader import check_importable
from deploy.runs.output import run_name
from deploy.workers.plan import RunOptions, plan
from deploy.workers.worker import WorkerConfig, build_shard

if TYPE_CHECKING:
    from bus.fault import FaultInstance
    from bus.lockstep.registers import RegisterRequest
    from bus.sensors import SensorSchema
    from bus.wire.keys import WireFormat
    from cell_firmware.faults.base import CellFault
    from cell_firmware.shard import Shard
    from deploy.scenes.scene import Scene
    from deploy.workers.system import System
    from deploy.workers.worker import BuiltShard, ResumePoint
    from plant.array import CellArray
    from plant.tick import LockstepPort


class CellsBackend(Protocol):
    """The cells' side of a simulation."""

    def start(self, scene: Scene, array: CellArray, sensors: SensorSchema) -> LockstepPort:
        """Create the cells.

        Args:
            scene: The scene.
            array: The cells that exist.
            sensors: The sensors that the cells have.

        Raises:
            DeployError: A worker failed while it started.
            BusError: A shard was not ready in time.
            FirmwareError: The firmware can't be loaded or initialised.
        """
        ...

    def stop(self, reason: str) -> MessageCounters | None:
        """End the cells; a second call does nothing.

        Returns:
            Counters of all sides; None where there are none.
        """
        ...

    def save_state(self) -> bytes:
        """Return the state of all cells between two ticks.

        Raises:
            StateError: This backend can't, or a program's state can't be encoded.
        """
        ...

    def load_state(self, state: bytes) -> None:
        """Restore what ``save_state`` returned.

        Raises:
            StateError: This backend can't, or the bytes don't fit.
        """
        ...


@final
class InProcess:
    """All cells in one shard, which the plant's thread steps: no bus, no other thread, no process.

    A program that does not return blocks the caller; ``Workers`` notice that.

    Args:
        metered: Whether the cells count their messages.
    """

    def __init__(self, *, metered: bool = True) -> None:
        self._metered = metered
        self._port: _DirectPort | None = None
        self._built: BuiltShard | None = None
        self._records: tuple[type, ...] = ()

    def start(self, scene: Scene, array: CellArray, sensors: SensorSchema) -> LockstepPort:
        """Create the cells; see ``CellsBackend``."""
        self._partition = Partition.even(array.lattice, 1)
        config = WorkerConfig(
            scene=scene,
            array=array,
            partition=self._partition,
            wire="packed",
            run="in-process",
            connect="",
            sensors=sensors,
            register_requests=(),
            metered=self._metered,
            byte_accurate_links=False,
            joins_running=False,
            keys=(),
            own_process=False,
        )
        built = self._built = build_shard(config, 0)
        self._records = built.records
        self._port = _DirectPort(built.cells)
        return self._port

    def stop(self, reason: str) -> MessageCounters | None:
        """Count what the cells did; see ``CellsBackend``."""
        del reason
        if self._port is None:
            return None
        return MessageCounters(cell_counters=self._port.shard.counters())

    def save_state(self) -> bytes:
        """Return the state of all cells; see ``CellsBackend``."""
        return save_state(self._started().shard, self._records)

    def load_state(self, state: bytes) -> None:
        """Restore the state of all cells; see ``CellsBackend``."""
        load_state(self._started().shard, state, self._records)

    @property
    def shard(self) -> Shard:
        """The shard of all cells, for analysis and tests."""
        return self._started().shard

    def inject(self, fault: FaultInstance[CellFault]) -> None:
        """Inject a fault of cells or links, effective from the next tick at the earliest."""
        assert self._built is not None, "this is a bug: the cells have not been started"
        self._built.cells.inject(fault, self._built.site, self._partition.lattice)

    def _started(self) -> _DirectPort:
        assert self._port is not None, "this is a bug: the cells have not been started"
        return self._port


@final
class _DirectPort:
    """The lockstep as calls of one shard."""

    lookahead = 0

    def __init__(self, shard: Shard) -> None:
        self.shard = shard
        self._senses: SenseFrame | None = None
        self._index = {cell: i for i, cell in enumerate(shard.cells)}

    def publish(self, frame: SenseFrame) -> None:
        """Store the senses until the drives are requested."""
        self._senses = frame

    def gather(self, tick: int) -> tuple[DriveFrame, Sequence[Loss]]:
        """Step all cells; programs that fail are losses."""
        senses = self._senses
        assert senses is not None, "this is a bug: no senses were published"
        try:
            outputs = self.shard.step(
                tick,
                senses.presence,
                senses.encoder_m,
                None,
                senses.level,
                label=senses.label,
                camera=senses.picture,
            )
        except Exception as error:  # noqa: BLE001 - whatever a step raises is a failure of its cells
            failures = failures_of(self.shard, tick, error)
            self.shard.retire(failure.cell for failure in failures)
            drive = np.zeros((len(self.shard), 2))
        else:
            failures, drive = outputs.failures, outputs.drive.copy()
        losses = [
            Loss(self._index[failure.cell], tick, "failed", report_text(failure)) for failure in failures
        ]
        return DriveFrame(tick, drive), sorted(losses, key=lambda loss: loss.cell)

    def mark_dead(self, cells: Sequence[int], tick: int) -> None:
        """Step these cells no more, from ``tick`` on."""
        del tick
        self.shard.retire(self.shard.cells[cell] for cell in cells)


@final
class Workers:
    """Cells in worker processes, over Zenoh on this machine.

    Args:
        processes: Number of worker processes; ``each``: one a cell.
        wire: Wire format; None: see ``RunOptions``.
    """

    def __init__(self, processes: int | Literal["each"] = 1, wire: WireFormat | None = None) -> None:
        self._options = RunOptions(processes=processes, wire=wire)
        self._system: System | None = None

    def start(self, scene: Scene, array: CellArray, sensors: SensorSchema) -> LockstepPort:
        """Start the processes and wait until all cells are ready; see ``CellsBackend``."""
        from deploy.workers.system import System

        check_importable(scene.cells.firmware)
        run = run_name(scene, secrets.token_hex(4))
        system = self._system = System(plan(scene, self._options, run), scene, self._options)
        try:
            system.open()
            return BusCells(system).start(scene, array, sensors)
        except BaseException:
            system.stop()
            raise

    def stop(self, reason: str) -> MessageCounters | None:
        """Stop the processes and collect the counters of all shards; see ``CellsBackend``."""
        return None if self._system is None else self._system.stop(reason)

    def save_state(self) -> bytes:
        """Refuse: the state of cells on the bus is a snapshot, which takes a tick."""
        raise StateError("cells in worker processes are saved by checkpoints: RunOptions(checkpoint_s=...)")

    def load_state(self, state: bytes) -> None:
        """Refuse; see ``save_state``."""
        del state
        raise StateError("cells in worker processes resume from checkpoints: mdms run --resume DIR")


@final
@dataclass(slots=True, eq=False)
class BusCells:
    """Cells of an opened system: in worker processes, or in a thread of this process where its plan has no workers.

    Attributes:
        system: Opened endpoints and the processes to start; closed by whoever opened them.
        register_requests: Registers that the cells publish.
        metered: Whether the cells count their messages.
        snapshots: Whether the coordinator may request snapshots.
        messages: Whether the cells publish their messages as registers.
        traced: Whether the cells record what their programs read and send, as registers.
        resume: State in which the cells resume; None: they begin.
        counters: Counters of all sides at that time.
    """

    system: System
    register_requests: tuple[RegisterRequest, ...] = ()
    metered: bool = False
    snapshots: bool = False
    messages: bool = False
    traced: bool = False
    resume: ResumePoint | None = None
    counters: MessageCounters | None = None

    def start(self, scene: Scene, array: CellArray, sensors: SensorSchema) -> LockstepPort:
        """Start the cells and wait until all are ready; see ``CellsBackend``."""
        del scene  # the system's own
        return self.system.start(
            array,
            sensors,
            self.register_requests,
            metered=self.metered,
            keeps=self.snapshots,
            messages=self.messages,
            traced=self.traced,
            resumed=self.resume,
            counted=self.counters,
        )

    def stop(self, reason: str) -> MessageCounters | None:
        """Stop the cells and collect the counters of all shards; see ``CellsBackend``."""
        return self.system.stop(reason)

    def save_state(self) -> bytes:
        """Refuse: the state of cells on the bus is a snapshot, which takes a tick."""
        raise StateError("cells in worker processes are saved by checkpoints: RunOptions(checkpoint_s=...)")

    def load_state(self, state: bytes) -> None:
        """Refuse; see ``save_state``."""
        del state
        raise StateError("cells in worker processes resume from checkpoints: mdms run --resume DIR")
