"""Cells of a lab in this process: stepped with given presence bits, or with a plant."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol, cast, final

import numpy as np
from numpy.typing import NDArray

from bus.sensors import SensorSchema
from bus.wire.frames import SenseFrame
from cell_firmware.faults.base import CellFault
from deploy.errors import InputError
from deploy.runs.backends import InProcess
from deploy.runs.simulation import Simulation
from deploy.scenes.fault_schedule import permanent_crashes
from plant.array import CellArray
from plant.effects.registry import PlantEffects
from plant.faults.base import PlantFault

if TYPE_CHECKING:
    from bus.fault import FaultInstance, FaultSpec
    from bus.lockstep.counters import Loss
    from cell_firmware.shard import Shard
    from deploy.scenes.scene import Scene

Presence = NDArray[np.bool_]


class LabCells(Protocol):
    """The cells of a lab, before tick ``tick``."""

    drive: NDArray[np.float64]
    """Drives of the last tick, ``(n, 2)``."""

    @property
    def tick(self) -> int:
        """The next tick."""
        ...

    @property
    def shard(self) -> Shard:
        """The shard of all cells."""
        ...

    def step(self, presence: Presence) -> Sequence[Loss]:
        """Run one tick, and return the cells with failed programs."""
        ...

    def inject(self, fault: FaultInstance[FaultSpec]) -> None:
        """Add a fault that begins with the next tick."""
        ...

    def replan(self) -> None:
        """Take note of changed ends of faults."""
        ...

    def save(self) -> tuple[bytes, ...]:
        """Return the state of everything."""
        ...

    def load(self, state: tuple[bytes, ...], tick: int) -> None:
        """Restore what ``save`` returned before ``tick``."""
        ...


@final
class CellsAlone:
    """Cells without a plant: the presence bits are given.

    Args:
        scene: The scene; parcels, friction and solver are not used.

    Raises:
        InputError: The scene has effects of the plant.
    """

    def __init__(self, scene: Scene) -> None:
        for name, _ in scene.effects.enabled():
            if name in PlantEffects.model_fields:
                raise InputError(f"effects.{name}: needs the plant: Lab.of(scene, plant=True)")
        self._deaths = permanent_crashes(scene)
        array = CellArray(scene.array)
        self._cells = InProcess(metered=False)
        self._port = self._cells.start(scene, array, SensorSchema(len(scene.array.sensors_m)))
        self.tick = 0
        self.drive = np.zeros((len(array), 2))

    @property
    def shard(self) -> Shard:
        """The shard of all cells."""
        return self._cells.shard

    def step(self, presence: Presence) -> Sequence[Loss]:
        """Run one tick, and return the cells with failed programs."""
        tick = self.tick
        self._port.publish(SenseFrame(tick, presence, None))
        if self._deaths and tick in self._deaths:
            self._port.mark_dead(self._deaths[tick], tick)
        frame, losses = self._port.gather(tick)
        self.drive = frame.drive
        self.tick = tick + 1
        return losses

    def inject(self, fault: FaultInstance[FaultSpec]) -> None:
        """Add a fault that begins with the next tick."""
        if not isinstance(fault.fault, CellFault):
            raise InputError(f"kind {fault.fault.kind_name}: needs the plant: Lab.of(scene, plant=True)")
        self._cells.inject(cast("FaultInstance[CellFault]", fault))

    def replan(self) -> None:
        """Do nothing: cells look at a fault's end in every tick."""

    def save(self) -> tuple[bytes, ...]:
        """Return the state of the cells."""
        return (self._cells.save_state(),)

    def load(self, state: tuple[bytes, ...], tick: int) -> None:
        """Restore what ``save`` returned before ``tick``."""
        self._cells.load_state(state[0])
        self.tick = tick


@final
class CellsOnPlant:
    """Cells on the scene's plant, in this process.

    Args:
        scene: The scene.

    Raises:
        InputError: The plant refuses the scene.
    """

    def __init__(self, scene: Scene) -> None:
        self._cells = InProcess()
        self.simulation = Simulation.open(scene, self._cells)
        self.drive = np.zeros((len(self.simulation.plant.array), 2))

    @property
    def tick(self) -> int:
        """The next tick."""
        return self.simulation.tick

    @property
    def shard(self) -> Shard:
        """The shard of all cells."""
        return self._cells.shard

    def step(self, presence: Presence) -> Sequence[Loss]:
        """Run one tick, and return the cells with failed programs.

        Raises:
            InputError: The scene is over.
        """
        del presence  # the plant's
        record = self.simulation.step(warns=False)
        if record is None:
            result = self.simulation.result
            if result is not None and result.last_losses:
                return result.last_losses
            raise InputError(f"duration_s {self.simulation.scene.duration_s:g}: the scene is over")
        self.drive = record.drives
        return record.losses

    def inject(self, fault: FaultInstance[FaultSpec]) -> None:
        """Add a fault that begins with the next tick."""
        if isinstance(fault.fault, PlantFault):
            self.simulation.process.inject(cast("FaultInstance[Any]", fault))
        if isinstance(fault.fault, CellFault):
            self._cells.inject(cast("FaultInstance[CellFault]", fault))

    def replan(self) -> None:
        """Plan the plant's faults again, after the end of one has changed."""
        self.simulation.process.replan()

    def save(self) -> tuple[bytes, ...]:
        """Return the states of plant and cells."""
        return self.simulation.save_state()

    def load(self, state: tuple[bytes, ...], tick: int) -> None:
        """Restore what ``save`` returned before ``tick``."""
        del tick  # it is in the plant's state
        self.simulation.load_state((state[0], state[1]))
