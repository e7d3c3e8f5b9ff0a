"""One run of a variant in this process, with the path of every parcel tick by tick."""

# pyright: reportUnknownMemberType=false
# (numba leaves the arguments of its events untyped.)

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.errors import FirmwareError
from deploy.errors import DeployError
from deploy.recordings.trace import mask_absent
from deploy.runs.field_simulation import field_speeds
from deploy.runs.result import RunResult, status_of
from deploy.runs.setup import load_plant
from deploy.runs.simulation import Simulation
from plant.errors import PlantError
from plant.tick import TickHooks, TickRecord

if TYPE_CHECKING:
    from deploy.scenes.scene import Scene
    from plant.observations import Event
    from plant.plant import Plant
    from plant.wheels import Floats


@final
@dataclass(frozen=True, slots=True)
class TracedRun:
    """Result of a run, and the parcels' path.

    Attributes:
        result: Result of the run, with all events.
        time_ns: ``(T,)`` ends of the ticks that are over, ns.
        path: ``(T, m, 6)`` x, y, angle and their rates of every parcel at these instants, m, rad and s. NaN while a
            parcel waits to be fed, and after it has left.
    """

    result: RunResult
    time_ns: NDArray[np.int64]
    path: Floats


def run_variant(scene: Scene, *, cells: bool, notify: Callable[[str], None]) -> TracedRun:
    """Run a scene to its end.

    Without cells the bits of the motion are those that it has with cells, if
    `deploy.runs.headless.needs_cells` is false. The plant advances tick by tick in either case.

    Args:
        scene: Scene to run.
        cells: Whether the cells run too, in this thread, without a bus.
        notify: Called with one line when kernels must be compiled.

    Raises:
        InputError: The plant refuses the scene.
    """
    instants: list[int] = []
    states: list[Floats] = []
    events: list[Event] = []
    # What a firmware prints in this process is no part of what the command prints.
    with contextlib.redirect_stdout(sys.stderr), compilation_announced(notify):
        plant = load_plant(scene, notify)
        if cells:
            result = _with_cells(scene, plant, instants, states, events)
        else:
            result = _plant_alone(scene, plant, instants, states, events)
    result.events = tuple(events)
    time_ns = np.array(instants, dtype=np.int64)
    traffic = [event._asdict() for event in events if event.kind in ("fed", "left")]
    path = np.reshape(states, (len(states), *plant.state.shape))
    return TracedRun(
        result, time_ns, mask_absent(path, time_ns.astype(np.float64) * 1e-9, len(scene.parcels), traffic)
    )


def _plant_alone(
    scene: Scene, plant: Plant, instants: list[int], states: list[Floats], events: list[Event]
) -> RunResult:
    speeds = field_speeds(scene, plant.array.positions_m)
    period_ns, end_ns = scene.tick_ns, scene.duration_ns
    failure: PlantError | None = None
    started = time.perf_counter()
    try:
        for tick in range(scene.ticks):
            until_ns = min((tick + 1) * period_ns, end_ns)
            _, happened = plant.advance(speeds, until_ns)
            events += happened
            instants.append(until_ns)
            states.append(plant.state)
    except PlantError as error:
        failure = error
    wall_s = time.perf_counter() - started
    result = RunResult.of(plant)
    if failure is not None:
        result.end(status_of(failure), str(failure))
    result.wall_s = wall_s
    return result


def _with_cells(
    scene: Scene, plant: Plant, instants: list[int], states: list[Floats], events: list[Event]
) -> RunResult:
    def after_tick(record: TickRecord) -> None:
        instants.append(record.until_ns)
        states.append(record.after)
        events.extend(record.events)

    try:
        simulation = Simulation.open(scene, hooks=TickHooks(after_tick=(after_tick,)), plant=plant)
    except (DeployError, FirmwareError) as error:
        result = RunResult.of(plant)
        result.end("failed", str(error))
        return result
    with simulation:
        return simulation.run()


@contextlib.contextmanager
def compilation_announced(notify: Callable[[str], None]) -> Generator[None]:
    """Announce the first compilation of a kernel in here: it is the longest part of a first run."""
    from numba.core import event

    class Announcement(event.Listener):
        said = False

        def on_start(self, event: event.Event) -> None:
            del event
            if not self.said:
                self.said = True
                notify("compiling kernels (once for each combination of effects) ...")

        def on_end(self, event: event.Event) -> None:
            del event

    with event.install_listener("numba:compile", Announcement()):
        yield
