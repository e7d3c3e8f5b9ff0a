"""A run before anything of it is started: what is asked of it, looked up and checked."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, final

import numpy as np

from bus.sensors import SensorSchema
from bus.state import StateFields
from cell_firmware.clocks import NOT_IN_WINDOW
from deploy.errors import InputError
from deploy.runs.output import run_name
from deploy.scenes.fault_schedule import in_run_faults
from deploy.scenes.warnings import scene_warnings
from deploy.workers.plan import plan
from plant.errors import PlantError
from plant.sampling import Timing

if TYPE_CHECKING:
    from bus.fault import FaultInstance, FaultSpec
    from bus.lattice import Lattice
    from cell_firmware.clocks import CellClocks, Ints
    from cell_firmware.firmware import Cells
    from deploy.checkpoints.checkpoint import Checkpoint
    from deploy.protocol_report.reporter import Reporter
    from deploy.recordings.reader import Recording
    from deploy.scenes.scene import Scene
    from deploy.workers.plan import Plan, RunOptions
    from plant.effects.camera.camera import Camera
    from plant.observations import Sense
    from plant.plant import Plant


def warnings_of(scene: Scene) -> tuple[str, ...]:
    """Return a line for each thing that looks mistaken, or will go wrong, though nothing forbids it.

    Raises:
        FirmwareError: The firmware raised when it was asked; with its traceback.
    """
    from cell_firmware.loader import load

    firmware = load(scene.cells)
    of_firmware = tuple(firmware.warnings(scene.lattice()))
    return (*scene_warnings(scene), *of_firmware, *_processor(scene, talks=firmware.message is not None))


def tell_cautions(scene: Scene, tell: Callable[[str], None]) -> tuple[str, ...]:
    """Tell each caution of a scene in a line; returns them.

    Raises:
        FirmwareError: The firmware raised when it was asked; with its traceback.
    """
    cautions = warnings_of(scene)
    for line in cautions:
        tell(f"caution: {line}")
    return cautions


def _processor(scene: Scene, *, talks: bool) -> tuple[str, ...]:
    """A line where the scene's boards would need more time than their processor has."""
    from cell_firmware.processor_time import period_e, shares
    from deploy.scenes.motor_facts import motor_facts

    sides = int((scene.lattice().neighbours >= 0).sum(axis=1).max()) if talks else 0
    period_ns = scene.cells.period_ns
    takes = shares(scene.effects, motor_facts(scene.effects.motors), period_ns, sides)
    if not takes:
        return ()
    whole = period_e(period_ns)
    least, most = (
        sum(bound) / whole for bound in zip(*((one.least, one.most) for one in takes), strict=True)
    )
    if most <= 1.0:
        return ()
    parts = ", ".join(f"{one.what} {_percent(one.least / whole, one.most / whole)}" for one in takes)
    line = (
        f"an MC68HC11 would be busy for {_percent(least, most)} of a control period of {whole:,.0f} E: {parts}; "
        "the emulation takes no time for it, and a real board would miss periods and bytes"
    )
    return (line,)


def _percent(least: float, most: float) -> str:
    low, high = round(100 * least), round(100 * most)
    return f"{low} %" if low == high else f"{low} to {high} %"


def register_warnings(scene: Scene) -> tuple[str, ...]:
    """A line where registers are to be recorded and the program's variables can't be, or not all of them."""
    from cell_firmware.cell import PerCellAdapter
    from cell_firmware.loader import load

    firmware = load(scene.cells)
    if not isinstance(firmware, PerCellAdapter):
        return ()
    try:
        problem = firmware.unrecorded(_first_cell(scene))
    except Exception:  # noqa: BLE001 - its cells fail as they begin, and say with what
        return ()
    return () if problem is None else (f"--registers: {Path(scene.cells.firmware).name}: {problem}",)


def _first_cell(scene: Scene) -> Cells:
    from cell_firmware.firmware import Cells
    from plant.array import CellArray

    array = CellArray(scene.array)
    cells = Cells.of(
        array.lattice,
        array.positions_m,
        scene.cells.period_s,
        scene.array.sensors_m,
        pitch_m=array.pitch_m,
    )
    return cells.select(np.array([0]))


@final
class CellTimingSource:
    """The plant's side of ``cell_firmware.effects.clock.wrapper``, by the same clocks.

    In tick k cells read at their instants r in window k. They are told in tick k + 1, and what they answer acts
    at r + W, in that tick.

    Args:
        clocks: Of all cells.
    """

    remembers: ClassVar[StateFields] = StateFields("_tick", "_count", "_read_ns")

    def __init__(self, clocks: CellClocks) -> None:
        self._clocks = clocks
        self._tick = 0
        self._count: Ints = np.zeros(len(clocks), dtype=np.int64)
        self._read_ns: Ints = np.full(len(clocks), NOT_IN_WINDOW)

    def __call__(self, tick: int) -> Timing:
        """When drives act and cells read in a tick, which is one more than the last that was asked for."""
        assert tick == self._tick, "this is a bug: clocks are followed tick by tick"
        read_ns, clocks = self._read_ns, self._clocks
        acts_ns = np.where(read_ns == NOT_IN_WINDOW, NOT_IN_WINDOW, read_ns + clocks.window_ns)
        self._read_ns = clocks.due(tick, self._count)
        self._count = self._count + (self._read_ns != NOT_IN_WINDOW)
        self._tick += 1
        return Timing(acts_ns, self._read_ns)


def cell_times(scene: Scene) -> CellTimingSource | None:
    """Those of a scene; None where its cells step at once."""
    clocks = scene.clocks()
    return None if clocks is None else CellTimingSource(clocks.clocks)


@final
@dataclass(frozen=True, slots=True)
class RunSetup:
    """What is to be run.

    Attributes:
        scene: What runs.
        options: How.
        plan: What will be started.
        resumed: From which it goes on; None: it begins.
        lasting: The scene's faults that begin and end on the way.
        live: Whether lines carry bytes: what keeps pace with a clock, or repeats what did, is what somebody watches,
            and has time for them.
        cautions: What is said before it begins.
        reporter: Watches the protocol, where that is asked for.
        replayed: The recording that it is to repeat, where there is one.
        script: What was done to the run that it repeats.
    """

    scene: Scene
    options: RunOptions
    plan: Plan
    resumed: Checkpoint | None
    in_run_faults: tuple[FaultInstance[FaultSpec], ...]
    byte_accurate_links: bool
    warnings: tuple[str, ...]
    reporter: Reporter | None
    replayed: Recording | None
    script: Sequence[Mapping[str, Any]]


def prepare_run(scene: Scene, options: RunOptions, resumed: Checkpoint | None) -> RunSetup:
    """Look up what a run needs besides its processes.

    Args:
        scene: What to run.
        options: How to run it.
        resumed: From which to go on.

    Raises:
        InputError: Bad input.
    """
    planned = plan(scene, options, run_name(scene, secrets.token_hex(4)))
    live = options.realtime is not None or options.replay is not None
    cautions = warnings_of(scene)
    if options.registers is not None:
        cautions += register_warnings(scene)
    reporter = _reporter(scene, planned.partition.lattice, options.protocol_report)
    replayed, script = None, ()
    if options.replay is not None:
        from deploy.control.replay import commands_of
        from deploy.recordings.reader import load

        replayed = load(options.replay)
        if options.output is not None and options.output.resolve() == replayed.path.parent.resolve():
            raise InputError(
                f"--replay {options.replay}: would be overwritten by --output {options.output}: name another folder"
            )
        script = commands_of(replayed, scene)
    return RunSetup(
        scene,
        options,
        planned,
        resumed,
        in_run_faults(scene),
        live if resumed is None else resumed.options["live"],
        cautions,
        reporter,
        replayed,
        script,
    )


def _reporter(scene: Scene, lattice: Lattice, every: int | None) -> Reporter | None:
    if every is None:
        return None
    from deploy.protocol_report.reporter import Reporter

    return Reporter(scene, lattice, every)


def sensor_schema(scene: Scene, sense: Sense) -> SensorSchema:
    """What there is to read, from the scene and from what its cells sense first.

    A camera is there for programs that subscribe to it: nobody is shown its pictures otherwise.
    """
    from cell_firmware.loader import load

    effects = scene.effects
    exits = () if effects.feeders is None else effects.feeders.exits
    subscribed = effects.camera is not None and load(scene.cells).uses_camera()
    return SensorSchema(
        len(scene.array.sensors_m),
        encoders=sense.encoder_m is not None,
        levels=sense.level is not None,
        labels=0 if sense.label is None else max(1, len(exits)),
        camera=scene.parcel_count if subscribed else 0,
    )


def camera_of(scene: Scene, readings: SensorSchema) -> Camera | None:
    """What takes the pictures that these cells are shown; None where nothing does."""
    if not readings.camera:
        return None
    from plant.factories import make_camera

    # where cells have clocks of their own, what a tick brings them they read in the tick before
    later = 0 if scene.effects.clock is None else 1
    return make_camera(scene.effects.of_plant(), scene.tick_ns, scene.seed, later)


def load_plant(scene: Scene, warn: Callable[[str], None]) -> Plant:
    """The plant of a scene, its kernels compiled or loaded; says so where that takes long.

    Raises:
        InputError: The plant refuses the scene.
    """
    from plant.kernels.common.cache import folder
    from plant.plant import Plant
    from plant.solvers.registry import is_compiled

    motors = scene.effects.motors
    divided = scene.effects.clock is not None or (motors is not None and motors.first_order.static_v > 0.0)
    if not is_compiled(scene.solver, divided=divided):
        _, lasting = folder()
        once = "once" if lasting else "every time: the cache folder can't be written, see NUMBA_CACHE_DIR"
        warn(f"compiling the solver ({once}) ...")
    try:
        plant = Plant(scene.plant_spec())
    except PlantError as error:
        raise InputError(f"scene {scene.name}: {error}") from None
    if divided:
        plant.warm_up()
    return plant
