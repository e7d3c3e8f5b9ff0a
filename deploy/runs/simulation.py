"""A scene as an object: opened, stepped or run to its end, saved and restored, closed."""

from __future__ import annotations

import time
import warnings
from types import TracebackType
from typing import TYPE_CHECKING, Self, final

from bus.errors import BusError
from bus.state import load_state, save_state
from deploy.errors import DeployError, InputError
from deploy.runs.backends import CellsBackend, InProcess
from deploy.runs.result import RunResult
from deploy.runs.setup import camera_of, cell_times, load_plant, sensor_schema
from deploy.scenes.fault_schedule import active, crash_wheel_policies, permanent_crashes
from deploy.scenes.scene import Scene
from deploy.util.formatting import say
from plant.errors import PlantError
from plant.process import PlantProcess
from plant.tick import DeathPolicy, RunClock, TickHooks, TickRecord

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from bus.fault import FaultInstance, FaultSpec
    from bus.lockstep.counters import Loss
    from plant.plant import Plant
    from plant.tick import LoopResult


@final
class Simulation:
    """A scene, ready to run: the plant, the cells, and the lockstep between them.

    ::

        with Simulation.open(load_scene("elliptic")) as simulation:
            result = simulation.run()

    Attributes:
        scene: The scene.
        plant: The plant, at ``time_s``.
        process: The tick loop.
        losses: Cells that were lost so far, in ticks that are over.
    """

    def __init__(self, scene: Scene, plant: Plant, cells: CellsBackend, process: PlantProcess) -> None:
        self.scene = scene
        self.plant = plant
        self.process = process
        self._cells = cells
        self._record: TickRecord | None = None
        self._result: RunResult | None = None
        self.losses: list[Loss] = []
        self._closed = False
        self.add_hooks(TickHooks(after_tick=(self._keep,)))

    @classmethod
    def open(
        cls,
        scene: Scene,
        cells: CellsBackend | None = None,
        *,
        hooks: TickHooks | None = None,
        plant: Plant | None = None,
        faults: Sequence[FaultInstance[FaultSpec]] | None = None,
        pace: Callable[[int], None] | None = None,
    ) -> Self:
        """Build the plant, start the cells, and connect them.

        Args:
            scene: The scene.
            cells: Backend of the cells; None: ``InProcess()``.
            hooks: Called around every tick; more can be added by ``add_hooks``.
            plant: The scene's plant at its start; None: it is built here.
            faults: The scene's faults that begin and end during the run, where the caller keeps them too; None: they
                are taken from the scene.
            pace: See ``plant.tick.RunClock``.

        Raises:
            InputError: It is no scene, or the plant refuses it.
            FirmwareError: The firmware can't be loaded or initialised.
            DeployError: A worker failed while it started.
            BusError: A shard was not ready in time.
        """
        if not isinstance(scene, Scene):  # pyright: ignore[reportUnnecessaryIsInstance] - users aren't type-checked
            raise InputError(f"scene {scene!r}: must be a scene that mdms.load_scene has returned")
        cells = InProcess() if cells is None else cells
        plant = load_plant(scene, say) if plant is None else plant
        sensors = sensor_schema(scene, plant.sense())
        port = cells.start(scene, plant.array, sensors)
        process = PlantProcess(
            plant,
            port,
            RunClock(
                scene.tick_ns, scene.duration_ns, cell_times(scene), pace, scene.bus.sense_to_drive_ticks
            ),
            DeathPolicy(
                permanent_crashes(scene),
                scene.stall,
                crash_wheel_policies(scene),
                stops_on_failure=scene.cells.on_failure == "stop",
            ),
            hooks,
            faults=active(scene, faults),
            camera=camera_of(scene, sensors),
        )
        return cls(scene, plant, cells, process)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        state = f"at {self.time_s:g} of {self.scene.duration_s:g} s"
        if self._result is not None and not self._result.ok:
            state += f", {self._result.status}: {self._result.reason}"
        elif self._closed:
            state = "closed"
        return f"<Simulation of {self.scene.name}, {len(self.plant.array)} cells, {state}>"

    @property
    def tick(self) -> int:
        """The next tick."""
        return self.process.tick

    @property
    def time_s(self) -> float:
        """Simulated time reached, s."""
        return self.process.time_ns * 1e-9

    @property
    def result(self) -> RunResult | None:
        """How the run ended; None while there is more of it."""
        return self._result

    def add_hooks(self, hooks: TickHooks) -> None:
        """Call more hooks around every tick, after those that are there."""
        self.process.hooks += hooks

    def step(self, *, warns: bool = True) -> TickRecord | None:
        """Run one tick.

        Args:
            warns: Whether a run that ends here before its duration is over, as where a program fails, is a
                ``RuntimeWarning`` too: a loop of steps would not notice it.

        Returns:
            Its record; None where the run is over: see ``result``.

        Raises:
            DeployError: The simulation is closed.
            PlantError: The plant could not advance.
            BusError: The bus broke.
        """
        if self._result is not None:
            return None
        self._check_open()
        self._record = None
        ended = self.process.step()
        self.process.report()
        if ended is not None:
            self._result = self._end(ended)
            if warns and not self._result.ok:
                why = f"{self._result.status}: {self._result.reason}"
                warnings.warn(f"the simulation has ended, {why}", RuntimeWarning, stacklevel=2)
        return self._record

    def run(self) -> RunResult:
        """Run to the end of the scene, or to what ends it before.

        Errors of the plant, the bus and the workers are the result's status and reason. What hooks raise is passed on.

        Raises:
            DeployError: The simulation is closed, and had not ended.
        """
        if self._result is not None:
            return self._result
        self._check_open()
        started = time.perf_counter()
        try:
            ended: LoopResult | Exception = self.process.run()
        except (BusError, DeployError, PlantError) as error:
            ended = error
        self._result = self._end(ended)
        self._result.wall_s = time.perf_counter() - started
        return self._result

    def _end(self, ended: LoopResult | Exception) -> RunResult:
        result, process = RunResult.of(self.plant), self.process
        if isinstance(ended, Exception):
            result.from_error(ended, process.tick, process.time_ns)
            result.losses = tuple(self.losses)
        else:
            cells, tick_ns = self.plant.array.lattice.cells, self.scene.tick_ns
            result.from_loop(ended, cells, process.tick, tick_ns, self.losses)
        return result

    def save_state(self) -> tuple[bytes, bytes]:
        """Return the states of the plant's side and of the cells, between two ticks.

        Raises:
            StateError: The backend can't, or a program's state can't be encoded.
        """
        return save_state(self.process), self._cells.save_state()

    def load_state(self, state: tuple[bytes, bytes]) -> None:
        """Restore what ``save_state`` returned, in this simulation or another of the same scene.

        Raises:
            StateError: The backend can't, or the bytes don't fit.
        """
        load_state(self.process, state[0])
        self._cells.load_state(state[1])
        self._result = None

    def close(self) -> None:
        """End the cells; a second call does nothing."""
        if not self._closed:
            self._closed = True
            counters = self._cells.stop("the run is over")
            if self._result is not None and counters is not None:
                self._result.counters = counters

    def _check_open(self) -> None:
        if self._closed:
            raise DeployError("the simulation is closed: its cells have ended")

    def _keep(self, record: TickRecord) -> None:
        self._record = record
        self.losses.extend(record.losses)
