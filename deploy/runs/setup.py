"""Setup of a run: inputs and options are loaded and checked before anything starts."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, final

import numpy as np

from bus.sensors import SensorSchema
from bus.state import StateFields
from cell_firmware.clocks import NOT_IN_WINDOW
from deploy.errors import InputError
from deploy.runs.compilation import compilation_reported, is_segmented
from deploy.runs.output import run_name
from deploy.scenes.fault_schedule import in_run_faults
from deploy.scenes.warnings import scene_warnings
from deploy.util.cell_ranges import select_cells
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
    from deploy.recordings.recording import Recording
    from deploy.scenes.scene import Scene
    from deploy.workers.plan import Plan, RunOptions
    from plant.effects.camera.camera import Camera
    from plant.observations import Sense
    from plant.plant import Plant


def warnings_of(scene: Scene) -> tuple[str, ...]:
    """Return a warning line for each valid but questionable setting of a scene.

    Raises:
        FirmwareError: The firmware's ``warnings`` raised; the message has its traceback.
    """
    from cell_firmware.loader import load

    firmware = load(scene.cells)
    of_firmware = tuple(firmware.warnings(scene.lattice()))
    return (*scene_warnings(scene), *of_firmware, *_processor(scene, talks=firmware.message is not None))


def report_warnings(scene: Scene, warn: Callable[[str], None]) -> tuple[str, ...]:
    """Report each warning of a scene in a line, and return the warnings.

    Raises:
        FirmwareError: The firmware's ``warnings`` raised; the message has its traceback.
    """
    warnings = warnings_of(scene)
    for line in warnings:
        warn(f"warning: {line}")
    return warnings


def _processor(scene: Scene, *, talks: bool) -> tuple[str, ...]:
    """Return a warning if the scene's boards would need more time than their processor has."""
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
        "the emulation ignores this load, but a real board would miss periods and bytes"
    )
    return (line,)


def _percent(least: float, most: float) -> str:
    low, high = round(100 * least), round(100 * most)
    return f"{low} %" if low == high else f"{low} to {high} %"


def register_warnings(scene: Scene) -> tuple[str, ...]:
    """Return a warning if not all of a program's variables can be recorded as registers."""
    from cell_firmware.cell import PerCellAdapter
    from cell_firmware.loader import load
    from cell_firmware.random_draws import CellStreams

    firmware = load(scene.cells)
    if not isinstance(firmware, PerCellAdapter):
        return ()
    try:
        cell = _first_cell(scene)
        if firmware.random:
            streams = CellStreams(firmware.random, scene.seed)
            cell = replace(cell, random=streams.at_start(cell.row, cell.column))
        problem = firmware.unrecorded(cell)
    except Exception:  # noqa: BLE001 - its cells fail as they begin, and say with what
        return ()
    return () if problem is None else (f"--registers: {Path(scene.cells.firmware).name}: {problem}",)


def _talks(scene: Scene) -> bool:
    """Whether the cells' program sends messages."""
    from cell_firmware.loader import load

    return load(scene.cells).message is not None


def check_conditions(scene: Scene) -> None:
    """Check that the program has conditions to be checked.

    Raises:
        InputError: It has none.
    """
    from cell_firmware.invariants import declares_invariants
    from cell_firmware.loader import load

    if not declares_invariants(load(scene.cells)):
        raise InputError(
            f"--check: the program {scene.cells.firmware} has no conditions: it defines neither invariants(view) nor "
            "eventually(view)"
        )


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
    """Timing of drives and readings for the plant, from the same clocks as ``cell_firmware.effects.clock.wrapper``.

    In tick k each cell reads at its instant r in window k. The reading is sent in tick k + 1, and the drive computed
    from it acts at r + W, in that tick.

    Args:
        clocks: Clocks of all cells.
    """

    state_fields: ClassVar[StateFields] = StateFields("_tick", "_count", "_read_ns")

    def __init__(self, clocks: CellClocks) -> None:
        self._clocks = clocks
        self._tick = 0
        self._count: Ints = np.zeros(len(clocks), dtype=np.int64)
        self._read_ns: Ints = np.full(len(clocks), NOT_IN_WINDOW)

    def __call__(self, tick: int) -> Timing:
        """Return when drives act and cells read in a tick; call for every tick in order."""
        assert tick == self._tick, "this is a bug: clocks are followed tick by tick"
        read_ns, clocks = self._read_ns, self._clocks
        acts_ns = np.where(read_ns == NOT_IN_WINDOW, NOT_IN_WINDOW, read_ns + clocks.window_ns)
        self._read_ns = clocks.due(tick, self._count)
        self._count = self._count + (self._read_ns != NOT_IN_WINDOW)
        self._tick += 1
        return Timing(acts_ns, self._read_ns)


def cell_times(scene: Scene) -> CellTimingSource | None:
    """Create the timing source of a scene; None for cells without local clocks."""
    clocks = scene.clocks()
    return None if clocks is None else CellTimingSource(clocks.clocks)


@final
@dataclass(frozen=True, slots=True)
class RunSetup:
    """Setup of a run: scene, options and everything prepared from them.

    Attributes:
        scene: Scene of the run.
        options: Options of the run.
        plan: Processes and endpoints to start.
        resumed: Checkpoint to resume from; None: the run starts at tick 0.
        in_run_faults: Faults of the scene that begin and end during the run.
        byte_accurate_links: Simulate serial lines byte by byte instead of message by message. Results are the same
            while nothing disturbs the lines; only byte-accurate lines accept faults injected at run time. Set by
            ``--realtime``, ``--paused`` and ``--replay``; a resumed run takes the checkpoint's value.
        warnings: Warnings to report before the start.
        reporter: Reporter of the protocol; None without a protocol report.
        replayed: Recording to repeat; None without one.
        script: Recorded commands and losses to repeat, from ``replayed``.
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
    """Prepare a run: plan the processes, collect warnings and load the replayed recording.

    Args:
        scene: Scene to run.
        options: Options of the run.
        resumed: Checkpoint to resume from; None: the run starts at tick 0.

    Raises:
        InputError: Bad input.
    """
    planned = plan(scene, options, options.name or run_name(scene, secrets.token_hex(4)))
    live = options.realtime is not None or options.paused or options.replay is not None
    warnings = warnings_of(scene)
    if options.messages is not None and not _talks(scene):
        raise InputError("--messages: the program of the cells sends no messages")
    if options.trace_messages is not None:
        if not _talks(scene):
            raise InputError("--trace-messages: the program of the cells sends no messages")
        select_cells(options.trace_messages, planned.partition.lattice.cells, "--trace-messages")
    if options.registers is not None:
        warnings += register_warnings(scene)
    if options.check is not None:
        check_conditions(scene)
    reporter = _reporter(scene, planned.partition.lattice, options.protocol_report)
    replayed, script = None, ()
    if options.replay is not None:
        from deploy.control.replay import commands_of
        from deploy.recordings.reader import load

        replayed = load(options.replay)
        if not replayed.header["sensors_m"]:
            raise InputError(
                f"--replay {options.replay}: is a recording of mdms simulate, which has no cells to repeat"
            )
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
        warnings,
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
    """Return the schema of the cells' sensors, from the scene and the first readings.

    Camera frames are included only if the program subscribes to the camera.
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
    """Create the camera whose frames the cells receive; None without camera frames."""
    if not readings.camera:
        return None
    from plant.factories import make_camera

    # cells with local clocks have read in the previous tick what a tick brings
    later = 0 if scene.effects.clock is None else 1
    return make_camera(scene.effects.of_plant(), scene.tick_ns, scene.seed, later)


def load_plant(scene: Scene, warn: Callable[[str], None]) -> Plant:
    """Load the plant of a scene with its kernels; ``warn`` is called with the progress of a long compilation.

    Raises:
        InputError: The plant refuses the scene.
    """
    from plant.plant import Plant

    with compilation_reported(scene.solver.name, warn):
        try:
            plant = Plant(scene.plant_spec())
        except PlantError as error:
            raise InputError(f"scene {scene.name}: {error}") from None
        if is_segmented(scene):
            plant.warm_up()
    return plant
