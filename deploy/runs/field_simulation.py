"""The plant alone, wheel speeds straight from the scene's velocity field: the paper's simulator."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import NDArray

from deploy.errors import InputError
from deploy.faults.records import transition_records
from deploy.recordings.digest import Digest
from deploy.recordings.mishaps import Mishaps
from deploy.recordings.run_log import event_record
from deploy.recordings.trace import RunTrace, mask_absent
from deploy.recordings.trajectory import TrajectoryRecorder
from deploy.recordings.writer import Recorder
from deploy.runs.output import (
    draw_run_overview,
    exits,
    parcel_outcomes,
    recording_header,
    run_name,
    validity,
)
from deploy.runs.output_folder import output_folder
from deploy.runs.result import status_of
from deploy.runs.setup import load_plant, report_warnings
from deploy.runs.summary import Outcome, Summary
from deploy.scenes.fault_schedule import (
    active,
    cell_only_faults,
    crash_aborts,
    crash_wheel_policies,
    in_run_faults,
    of_plant,
    on_ideal_wheels,
    permanent_crashes,
)
from deploy.scenes.memory_limit import too_many_samples
from deploy.util.progress import Progress
from deploy.util.signals import Interrupted, Interruption
from plant.errors import PlantError, PlantHalted, PlantStopped

if TYPE_CHECKING:
    from deploy.scenes.scene import Scene
    from plant.observations import Event, Trajectory
    from plant.plant import Plant

Floats = NDArray[np.float64]

SLICE = 1_000
"""Samples a call of the plant: between two calls the progress is shown and a signal is heeded."""


def simulate(
    scene: Scene,
    *,
    output: Path | None = None,
    picture: bool = True,
    quiet: bool = False,
    interruption: Interruption | None = None,
) -> Outcome:
    """Simulate a scene without cells: every wheel runs at the field's speed from the start.

    Wheels are ideal: where the scene has motors they are left out, as the paper's simulator has none, and so are
    effects and faults of the cells; that is said. What the scene lets happen to wheels and modules happens, and a cell
    that it lets crash does what the fault or the stall policy says. The motion is sampled once a control period, and at
    the end.

    Args:
        scene: What to simulate; its firmware must be ``velocity_field``.
        output: Folder for recording, summary and picture; None: a new one under ``runs/``.
        picture: Whether to draw the overview.
        quiet: Show no progress and no warnings on stderr.
        interruption: The caller's, where it watches for signals itself.

    Raises:
        InputError: The scene's firmware has no field to simulate, the plant refuses the scene, or another process is
            writing to the output folder.
        Interrupted: SIGINT or SIGTERM came before the simulation began.
    """
    interruption = interruption or Interruption()
    with interruption.handling():
        return _FieldSimulation(scene, interruption, quiet=quiet).go(output, picture=picture)


def field_speeds(scene: Scene, positions_m: Floats) -> Floats:
    """The field's velocity at every cell, ``(n, 2)`` m/s.

    Raises:
        InputError: The scene's firmware is not ``velocity_field``.
    """
    from cell_firmware.loader import load
    from cell_firmware.protocols.velocity_field import VelocityField

    firmware = load(scene.cells)
    if not isinstance(firmware, VelocityField):
        raise InputError(
            f'scene {scene.name}: cells.firmware = "{scene.cells.firmware}": must be velocity_field: without cells '
            "the wheels run at a field's speed; `mdms run` runs any firmware"
        )
    return firmware.parameters.field.velocity(positions_m[:, 0], positions_m[:, 1])


def iterate_field_motion(
    scene: Scene,
    plant: Plant,
    speeds: Floats,
    *,
    check: Callable[[], None],
    fell: Callable[[int, Sequence[int]], None] | None = None,
    driven: Callable[[Floats], None] | None = None,
    samples: int = SLICE,
) -> Iterator[Trajectory]:
    """The trajectory of a plant under the field, from the start to the end, a sample a control period.

    What the scene lets happen to wheels and modules happens. Cells that crash do what the fault, or the stall policy
    says; under ``abort`` the trajectory ends there.

    Args:
        scene: What to simulate.
        plant: Its plant, at the start.
        speeds: ``(n, 2)`` of the wheels, m/s.
        check: Called before every part; may raise.
        fell: Told when faults begin or end: the tick, and who died in it for good or under ``abort``.
        driven: Called before every part with the drives of the part, ``(n, 2)``, m/s.
        samples: Of a part, at most.

    Raises:
        PlantUnstable: The motion of a parcel can't be followed; the part that was reached has been given.
        PlantStopped: The end of a part was requested; likewise.
    """
    from plant.dead_cells import DeadCells

    period_ns, end_ns, now_ns = scene.tick_ns, scene.duration_ns, 0
    schedule, faults, abort = permanent_crashes(scene), active(scene), scene.stall.policy == "abort"
    policy = "coast" if scene.stall.policy == "abort" else scene.stall.policy
    undriven = DeadCells(plant, len(speeds), policy, crash_wheel_policies(scene))
    ticks = {*schedule, *(() if faults is None else faults.transitions)}
    for tick in (*sorted(ticks), scene.ticks):
        until_ns = min(tick * period_ns, end_ns)
        while now_ns < until_ns:
            check()
            drives = undriven.override_drives(speeds)
            if driven is not None:
                driven(drives)
            try:
                part = plant.trajectory(drives, min(now_ns + samples * period_ns, until_ns), period_ns)
            except PlantHalted as halted:
                if halted.reached is not None:
                    yield halted.reached
                raise
            now_ns = int(part.time_ns[-1])
            yield part
        if now_ns >= end_ns:
            return
        dying = schedule.get(tick, ())
        wheel_faults = None if faults is None or tick < faults.next_transition else faults.at_transition(tick)
        if abort and wheel_faults is not None:
            dying = tuple(sorted({*dying, *undriven.about_to_die(wheel_faults)}))
        if fell is not None:
            fell(tick, dying)
        if abort and dying:
            return
        if wheel_faults is not None:
            undriven.on_transition(wheel_faults, speeds)
        undriven.mark_dead(dying, speeds)


@final
class _FieldSimulation:
    """One simulation, from the plant to the picture."""

    def __init__(self, scene: Scene, interruption: Interruption, *, quiet: bool) -> None:
        self.begun = time.monotonic()
        self.quiet = quiet
        self.interruption = interruption
        self.motors = scene.effects.motors is not None
        self.named = scene
        self.scene = without_cells(scene)
        self.status = "ok"
        self.reason: str | None = None
        self.times: list[NDArray[np.int64]] = []
        self.states: list[Floats] = []
        self.events: list[Event] = []
        self.faults: list[dict[str, Any]] = []
        self.cells_lost: list[tuple[int, int]] = []
        self.lasting = of_plant(in_run_faults(self.scene))
        self.time_ns = 0
        self.digest = Digest(b"simulate " + self.scene.canonical())
        self.ticks = 0
        self.aside_s = 0.0
        """Wall time of digest and recording so far, which counts for nothing in the speed of the simulation."""
        self._recording: TrajectoryRecorder | None = None
        self.warnings: tuple[str, ...] = ()

    def go(self, output: Path | None, *, picture: bool) -> Outcome:
        """Everything; see `simulate`."""
        with self.interruption.interruptible():
            from plant.array import CellArray

            rule = too_many_samples(self.scene.ticks, self.scene.parcel_count)
            if rule:
                raise InputError(f"scene {self.named.name}: duration_s = {self.named.duration_s:g}: {rule}")
            self.warnings = report_warnings(self.named, self._warn)

            array = CellArray(self.scene.array)
            speeds = field_speeds(self.scene, array.positions_m)
            plant = load_plant(self.scene, self._warn)
        if self.motors:
            left_out = " and effects.wheel_load are" if self.named.effects.wheel_load is not None else " is"
            self._warn(f"effects.motors{left_out} left out: mdms simulate has ideal wheels")
        for name, _ in self.named.effects.of_cells().enabled():
            self._warn(f"effects.{name} is left out: mdms simulate has no cells")
        for fault in cell_only_faults(self.named):
            self._warn(f"{fault} is left out: mdms simulate has no cells")
        self.interruption.raise_if_requested()
        with output_folder(self.named, output, self._warn) as folder:
            header = recording_header(
                run_name(self.named, "simulate"), self.scene, plant.array, plant.footprints_m
            )
            header["scene_name"], header["sensors_m"] = self.named.name, []
            with Recorder(folder, header) as recorder:
                self._recording = TrajectoryRecorder(recorder, len(plant.array))
                return Outcome(self._simulated(plant, speeds, folder, picture=picture))

    def _simulated(self, plant: Plant, speeds: Floats, folder: Path, *, picture: bool) -> Summary:
        """Simulate, and leave what came of it in the folder."""
        started = time.monotonic()
        with Progress(self.scene.duration_ns, quiet=self.quiet) as progress:
            try:
                self._advance(plant, speeds, progress)
            except (Interrupted, PlantStopped):
                self._end("interrupted", f"interrupted at {self.time_ns * 1e-9:g} s of simulated time")
            except PlantError as error:
                self._end(
                    status_of(error), f"{error}; the trajectory up to {self.time_ns * 1e-9:g} s is valid"
                )
        wall_s = time.monotonic() - started - self.aside_s
        summary = self._summary(plant, folder, wall_s, started - self.begun)
        self.recording.close(self.status, self.digest.hexdigest, self.digest.motion_hexdigest)
        summary.write(folder)
        if picture and self.status != "interrupted":
            track = self._track(plant)
            summary = draw_run_overview(summary, lambda: track, folder, self.interruption)
        return summary

    @property
    def recording(self) -> TrajectoryRecorder:
        """Recording of the simulation."""
        assert self._recording is not None, "this is a bug: the simulation has begun without its recording"
        return self._recording

    # --- the simulation itself --------------------------------------------------------------------

    def _advance(self, plant: Plant, speeds: Floats, progress: Progress) -> None:
        """Run from death to death and to the end, in slices; sets samples, events and status."""
        self._add(np.zeros(1, dtype=np.int64), plant.state[None], plant.wheel_speed)
        mishaps = Mishaps(progress.say)
        for part in iterate_field_motion(
            self.scene,
            plant,
            speeds,
            check=self.interruption.raise_if_requested,
            fell=self._on_transition,
            driven=self.recording.drive,
        ):
            self._take(part, plant.wheel_speed, progress)
            mishaps.take(part.events)

    def _take(self, part: Trajectory, wheel_speed: Floats, progress: Progress) -> None:
        self._add(part.time_ns[1:], part.state[1:], wheel_speed)
        self.events += part.events
        for event in part.events:
            self.recording.event(event_record(event))
        self.time_ns = int(part.time_ns[-1])
        progress.events = len(self.events)
        progress.update(self.ticks, self.time_ns)

    def _add(self, time_ns: NDArray[np.int64], states: Floats, wheel_speed: Floats) -> None:
        """Keep samples, record them, and add them to the digest: there are no senses and no drives to cover."""
        self.times.append(time_ns)
        self.states.append(states)
        begun = time.monotonic()
        nothing = np.zeros((0, 1), dtype=np.bool_)
        none: Floats = np.zeros((0, 2))
        for state in states:
            self.digest.tick(self.ticks, nothing, none, state)
            self.ticks += 1
        self.recording.rows(time_ns, states, wheel_speed)
        self.aside_s += time.monotonic() - begun

    def _on_transition(self, tick: int, dead: Sequence[int]) -> None:
        """Note what begins or ends now, as the scene says, and who dies."""
        names, period_ns = self.scene.lattice().cells, self.scene.tick_ns
        at_s, ended = tick * period_ns * 1e-9, bool(dead) and self.scene.stall.policy == "abort"
        turning = () if ended else self.lasting
        found = [record for one in turning for record in transition_records(one, tick, period_ns, names)]
        for cell in dead:
            self.cells_lost.append(names[cell])
            found.append({"time_s": at_s, "kind": "crash", "cell": list(names[cell]), "detail": "scheduled"})
        self.faults += found
        for fault in found:
            self.recording.fault(fault)
        if ended:
            self._end("failed", crash_aborts(names[dead[0]], at_s))

    def _end(self, status: str, reason: str) -> None:
        self.status, self.reason = status, reason

    # --- what it leaves ---------------------------------------------------------------------------

    def _track(self, plant: Plant) -> RunTrace:
        scene, array = self.scene, plant.array
        events = [event_record(event) for event in self.events]
        time_s = np.concatenate(self.times).astype(np.float64) * 1e-9
        return RunTrace(
            title=scene.title,
            scene=self.named.name,
            pitch_m=array.pitch_m,
            cells=array.lattice.cells,
            positions_m=array.positions_m,
            footprints_m=plant.footprints_m,
            time_s=time_s,
            parcels=mask_absent(np.concatenate(self.states), time_s, len(scene.parcels), events),
            wheel_speeds=plant.wheel_speed,
            exits=exits(scene),
            events=events,
            faults=self.faults,
            rails_m=scene.effects.rails_m(),
            status=self.status,
        )

    def _summary(self, plant: Plant, folder: Path, wall_s: float, startup_s: float) -> Summary:
        scene = self.scene
        return Summary(
            status=self.status,
            reason=self.reason,
            scene=self.named.name,
            seed=scene.seed,
            duration_s=scene.duration_s,
            simulated_s=self.time_ns * 1e-9,
            cells=len(plant.array),
            processes=0,
            transport=None,
            solver=scene.solver.accuracy(),
            ticks=self.ticks - 1,
            wall_s=wall_s,
            startup_s=startup_s,
            parcels=parcel_outcomes(plant),
            support_changes=plant.support_changes,
            **validity(plant, scene),
            faults=self.faults,
            cells_lost=self.cells_lost,
            feeders=plant.traffic(),
            warnings=self.warnings,
            digest=self.digest.hexdigest,
            motion_digest=self.digest.motion_hexdigest,
            output=str(folder),
        )

    def _warn(self, line: str) -> None:
        if not self.quiet:
            sys.stderr.write(f"mdms: {line}\n")
            sys.stderr.flush()


def without_cells(scene: Scene) -> Scene:
    """The scene without cells, and with wheels that run at the commanded speed at once."""
    left_out = ["motors", "wheel_load", *(name for name, _ in scene.effects.of_cells().enabled())]
    motors = scene.effects.motors
    changes: dict[str, Any] = {
        "effects": scene.effects.model_copy(update=dict.fromkeys(left_out)),
        "cells": scene.cells.model_copy(update={"speed_loop": None}),
    }
    if motors is not None:
        changes["faults"] = on_ideal_wheels(scene, motors)
    return scene.model_copy(update=changes)
