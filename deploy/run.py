"""The whole system: cells, bus and plant in lockstep; a recording, a summary and a picture at the end."""

from __future__ import annotations

import os
import secrets
import sys
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

from bus.counts import Counts
from bus.errors import BusError, MemoryRefusedError
from bus.keys import plant_key
from bus.registers import Wanted
from deploy.cautions import cautions_of
from deploy.cell_times import cell_times
from deploy.checkpoints.store import Store
from deploy.conduct import Conduct
from deploy.digest import Digest
from deploy.errors import DeployError, InputError
from deploy.faults.schedule import active, crash_aborts, deaths, lasting, rests
from deploy.interruption import Interrupted, Interruption
from deploy.ledger import Ledger
from deploy.live.address import Address
from deploy.output import drawn, header, illustrate, left, output_folder, parcel_outcomes, run_name
from deploy.processes.plan import RunOptions, plan
from deploy.processes.system import System
from deploy.processes.worker import Resumed
from deploy.progress import Progress
from deploy.readings import camera_of, readings_of
from deploy.recordings.format import EVENTS
from deploy.recordings.recorder import Recorder
from deploy.refused import DENIED, MALFORMED, MESSAGE, Refused, total
from deploy.summary import Messages, Summary
from plant.errors import PlantError, PlantUnstable

if TYPE_CHECKING:
    from bus.lockstep import Host
    from deploy.checkpoints.checkpoint import Checkpoint
    from deploy.checkpoints.keeper import About, Keeper
    from deploy.live.console import Console
    from deploy.processes.respawn import Respawn
    from deploy.protocol_report.report import ProtocolReport
    from deploy.protocol_report.reporter import Reporter
    from deploy.recordings.replay import Recording
    from deploy.scene import Scene
    from plant.plant import Plant
    from plant.process import Ended, PlantProcess


@final
@dataclass(frozen=True, slots=True)
class Outcome:
    """What a run came to.

    Attributes:
        summary: For programs and people.
        detail: Several lines on what went wrong, such as a firmware's traceback; empty where all is well.
    """

    summary: Summary
    detail: str = ""


def run(
    scene: Scene,
    options: RunOptions | None = None,
    *,
    quiet: bool = False,
    interruption: Interruption | None = None,
    resumed: Checkpoint | None = None,
) -> Outcome:
    """Run the whole system once.

    Once the cells are started, whatever ends the run is told by the outcome's status and reason. However this
    ends, every process that was started has ended, and what was recorded is complete up to there.

    Args:
        scene: What to run.
        options: How to run it.
        quiet: Show no progress and no warnings on stderr.
        interruption: The caller's, where it watches for signals itself.
        resumed: From which to go on, in ``options.output``: scene and options are its own.

    Raises:
        InputError: Bad input, such as a scene that the plant refuses; nothing was started.
        Interrupted: SIGINT or SIGTERM came before the run had a recording.
    """
    interruption = interruption or Interruption()
    with interruption.watching():
        return _Run(scene, options or RunOptions(), interruption, resumed, quiet=quiet).go()


@final
class _Run:
    """One run, from the plan to the picture."""

    def __init__(
        self,
        scene: Scene,
        options: RunOptions,
        interruption: Interruption,
        resumed: Checkpoint | None,
        *,
        quiet: bool,
    ) -> None:
        self.begun = time.monotonic()
        self.scene = scene
        self.options = options
        self.interruption = interruption
        self.quiet = quiet
        self.resumed = resumed
        self.about: About | None = None
        self.keeper: Keeper | None = None
        self.plan = plan(scene, options, run_name(scene, secrets.token_hex(4)))
        self.cautions: tuple[str, ...] = ()
        self.reporter: Reporter | None = None
        self.lasting = lasting(scene)
        # what keeps pace with a clock is what somebody watches, and has time for lines that carry bytes
        self.live = options.realtime is not None or options.replay is not None
        if resumed is not None:
            self.live = resumed.options["live"]
        self.replayed: Recording | None = None
        self.script: Sequence[Mapping[str, Any]] = ()
        self.digest = Digest(scene.canonical())
        self.status = "ok"
        self.reason: str | None = None
        self.detail = ""
        self.counts: Counts | None = None
        self.refused: Refused | None = None
        self.startup_s = 0.0
        self.wall_s = 0.0

    def go(self) -> Outcome:
        """Everything; see `run`."""
        with self.interruption.allowed():
            self.cautions = cautions_of(self.scene)
            self.reporter = self._reporter()
            if self.options.replay is not None:
                from deploy.live.script import script_of
                from deploy.recordings.replay import load

                self.replayed = load(self.options.replay)
                self.script = script_of(self.replayed, self.scene)
        for line in self.cautions:
            self._warn(f"caution: {line}")
        with System(self.plan, self.scene, self.options.listen, self.options.keys) as system:
            with self.interruption.allowed():
                plant = load_plant(self.scene, self._warn)
                self.about = self._about(plant)
            system.open()
            self.interruption.check()
            folder = output_folder(self.scene, self.options.output)
            if self.resumed is None:
                Store(folder).clear()
            with (
                Recorder(
                    folder,
                    header(self.plan.run, self.scene, plant.array, plant.footprints_m),
                    kept=None if self.resumed is None else self.resumed.recorded,
                ) as recorder,
                Progress(self.scene.duration_ns, quiet=self.quiet) as progress,
            ):
                ledger = Ledger(
                    plant.array.lattice.cells,
                    self.scene.tick_ns,
                    digest=self.digest,
                    recorder=recorder,
                    progress=progress,
                    policy=self.scene.stall.policy,
                    warn=lambda line: self._warn(line, progress),
                    injected=self.lasting,
                )
                self.refused = Refused(system.refusals, lambda line: self._warn(line, progress))
                with self._announced(system, folder):
                    self._lockstep(system, plant, ledger, recorder)
                self._close(recorder)
        self._compare()
        summary = self._summary(plant, ledger, folder)
        for leave in (self._write, self._write_report, self._illustrate):
            summary = left(summary, folder, leave, self._warn)
        return Outcome(summary, self.detail)

    def _compare(self) -> None:
        """Say whether a run that was to repeat another came to the same."""
        if self.replayed is None or self.status != self.replayed.status:
            return
        if self.digest.hexdigest == self.replayed.digest:
            self._warn(f"the digest is that of {self.options.replay}")
        else:
            self._end(
                "failed", f"the digest differs from that of {self.options.replay}, {self.replayed.digest}"
            )

    @contextmanager
    def _announced(self, system: System, folder: Path) -> Generator[None]:
        """Leave a note, while the run goes on, of where it can be spoken to."""
        if not system.locator:
            yield
            return
        address = Address(self.plan.run, system.locator, os.getpid())
        address.write(folder)
        try:
            yield
        finally:
            address.remove(folder)

    # --- the run itself ---------------------------------------------------------------------------

    def _lockstep(self, system: System, plant: Plant, ledger: Ledger, recorder: Recorder) -> None:
        """Start the cells, run to whatever end, stop the cells; sets status, reason and times."""
        process: PlantProcess | None = None
        started = time.monotonic()
        try:
            with self.interruption.allowed():
                process = self._process(system, plant, ledger, recorder)
            started = time.monotonic()
            self.startup_s = started - self.begun
            self.interruption.waits = lambda: process.waiting
            self._take(process.run(), ledger)
        except Interrupted:
            self._end("interrupted", f"interrupted at {ledger.time_ns * 1e-9:g} s of simulated time")
        except (BusError, DeployError) as error:
            self._end("failed", str(error))
        except PlantError as error:
            self._end(status_of(error), f"{error} (tick {ledger.ticks})")
        finally:
            self.interruption.waits = lambda: False
            self.wall_s = time.monotonic() - started
            if self.resumed is not None:
                self.wall_s += self.resumed.wall_s
            if self.keeper is not None:
                self.keeper.close()
            if self.status == "failed" or ledger.cells_lost:
                self.detail = "\n".join(text for text in (self.detail, system.explain()) if text)
            self.counts = system.stop(self.reason or "the run is over")
            assert self.refused is not None
            self.refused.look(self.counts or Counts())
        if process is not None and self.status != "unstable" and not recorder.broken:
            recorder.tick(
                process.tick, process.time_ns, process.sense.presence, None, plant.wheel_speed, plant.state
            )

    def _process(self, system: System, plant: Plant, ledger: Ledger, recorder: Recorder) -> PlantProcess:
        from plant.process import PlantProcess

        assert self.refused is not None
        reporter, resumed = self.reporter, self.resumed
        wanted = () if self.options.registers is None else (Wanted(self.options.registers),)
        if reporter is not None:
            wanted = (*wanted, *reporter.wanted)
        readings = readings_of(self.scene, plant.sense())
        host = system.start(
            plant.array,
            readings,
            wanted,
            metered=reporter is not None,
            live=self.live,
            keeps=self.about is not None,
            resumed=resumed and Resumed(resumed.tick, resumed.dead, resumed.states),
            counted=resumed and resumed.all_counts(),
        )
        self.keeper = self._keeper(host, ledger, recorder)
        conduct = Conduct(
            host,
            ledger,
            self.interruption,
            self.scene.effects.cop is not None,
            self.options.registers,
            self.refused,
            reporter,
            self._console(system, host, ledger),
            self._respawn(system, host, ledger),
            self.keeper,
        )
        process = PlantProcess(
            plant,
            host,
            tick_ns=self.scene.tick_ns,
            duration_ns=self.scene.duration_ns,
            schedule=deaths(self.scene),
            stall=self.scene.stall,
            timing=cell_times(self.scene),
            camera=camera_of(self.scene, readings),
            faults=active(self.scene, self.lasting),
            rests=rests(self.scene),
            observer=conduct.observe,
            pace=None if self.options.realtime is None else pacer(self.options.realtime),
            attend=conduct.attend if conduct.attends else None,
        )
        conduct.process = process
        if conduct.console is not None:
            conduct.console.attach(process)
        if resumed is not None:
            self._go_on(resumed, process, ledger)
        return process

    # --- checkpoints ------------------------------------------------------------------------------

    def _about(self, plant: Plant) -> About | None:
        """What all checkpoints of the run have in common; None where there are to be none.

        Raises:
            InputError: The run can't be kept, or can't go on from the one that it is to go on from.
        """
        if self.options.checkpoint_s is None:
            return None
        from bus.memory import remember
        from deploy.checkpoints.keeper import About
        from deploy.checkpoints.resume import bound, check, told

        try:
            remember(plant)
        except MemoryRefusedError as error:
            raise InputError(f"--checkpoint: this plant can't be kept: {error}") from None
        about = About(
            scene_name=self.scene.name,
            scene=self.scene.model_dump(mode="json"),
            bound=bound(self.scene),
            options=told(self.plan, self.options, live=self.live),
        )
        if self.resumed is None:
            return about
        check(self.resumed, about.bound)
        resumed = (*self.resumed.resumed, self.resumed.tick)
        return replace(about, resumed=resumed, wall_s=self.resumed.wall_s)

    def _keeper(self, host: Host, ledger: Ledger, recorder: Recorder) -> Keeper | None:
        """What takes checkpoints; None where there are to be none."""
        if self.about is None or self.options.checkpoint_s is None:
            return None
        from deploy.checkpoints.keeper import Keeper

        store = Store(recorder.path.parent)
        if self.resumed is not None:
            store.keep(self.resumed)
        return Keeper(
            self.options.checkpoint_s,
            host,
            ledger,
            recorder,
            self.reporter,
            store,
            self.about,
            patience_s=self.scene.stall.deadline_s,
            warn=ledger.warn,
        )

    def _go_on(self, resumed: Checkpoint, process: PlantProcess, ledger: Ledger) -> None:
        """Let all of this process be as it was."""
        from bus.memory import recall

        recall(process, resumed.process)
        recall(ledger, resumed.ledger)
        ledger.show(resumed.recorded.get(EVENTS, 0))
        if self.reporter is not None and resumed.reporter is not None:
            recall(self.reporter, resumed.reporter)

    def _respawn(self, system: System, host: Host, ledger: Ledger) -> Respawn | None:
        """What starts lost workers anew; None where they are not to be."""
        if not self.options.respawn:
            return None
        from deploy.processes.respawn import Respawn

        return Respawn(system, host, self.plan.partition, self.options.respawn, ledger.warn)

    def _console(self, system: System, host: Host, ledger: Ledger) -> Console | None:
        """What takes requests while the run goes on; None where nobody can ask anything."""
        questions = system.questions(plant_key(self.plan.run, "operator"))
        if questions is None and self.replayed is None:
            return None
        from deploy.live.console import Console

        return Console(
            self.scene,
            self.plan.run,
            self.lasting,
            host.control,
            ledger,
            questions,
            self.script,
            lines=self.live,
        )

    def _take(self, ended: Ended, ledger: Ledger) -> None:
        """Tell why the policy ``abort`` ended the run, if it did."""
        if ended.died:
            ledger.died(ledger.ticks, ended.died)
            cell = ledger.cells_lost[-len(ended.died)]
            self._end("failed", crash_aborts(cell, ledger.time_ns * 1e-9))
        elif ended.losses:
            ledger.lost(ended.losses)
            self._end(ended.status, f"{ledger.describe(ended.losses)}; stall.policy is abort")
            self.detail = next((loss.detail for loss in ended.losses if loss.detail), "")

    def _end(self, status: str, reason: str) -> None:
        self.status, self.reason = status, reason

    def _close(self, recorder: Recorder) -> None:
        """End the recording; what can't be written of it fails the run."""
        try:
            recorder.close(self.status, self.digest.hexdigest)
        except DeployError as error:
            if self.status == "ok":
                self._end("failed", str(error))
            elif str(error) != self.reason:
                self._warn(str(error))

    # --- what it leaves ---------------------------------------------------------------------------

    def _write(self, summary: Summary, folder: Path) -> Summary:
        summary.write(folder)
        if self.about is not None and self.status == "ok":
            Store(folder).clear()
        return summary

    def _illustrate(self, summary: Summary, folder: Path) -> Summary:
        if not self.options.picture or summary.status == "interrupted":
            return summary
        from deploy.recordings.replay import load

        return illustrate(summary, lambda: load(folder), folder, self.interruption)

    def _summary(self, plant: Plant, ledger: Ledger, folder: Path) -> Summary:
        scene, counts = self.scene, self.counts or Counts()
        assert self.refused is not None
        refused = self.refused.rows(counts)
        messages = Messages(
            sent=counts.sent,
            delivered=counts.delivered,
            lost=counts.lost,
            late=counts.late,
            denied=total(refused, DENIED, MESSAGE),
            malformed=total(refused, MALFORMED),
        )
        return Summary(
            status=self.status,
            reason=self.reason,
            scene=scene.name,
            seed=scene.seed,
            duration_s=scene.duration_s,
            simulated_s=ledger.time_ns * 1e-9,
            cells=len(plant.array),
            firmware=_firmware(scene),
            processes=self.plan.workers,
            transport=self.plan.transport,
            solver=scene.solver.accuracy(),
            ticks=ledger.ticks,
            wall_s=self.wall_s,
            startup_s=self.startup_s,
            parcels=parcel_outcomes(plant),
            support_changes=plant.support_changes,
            messages=messages,
            refused=refused,
            faults=ledger.faults,
            cells_lost=ledger.cells_lost,
            feeders=plant.traffic(),
            cautions=self.cautions,
            effects=_of_effects(counts.tally),
            protocol=self._report(ledger),
            digest=self.digest.hexdigest,
            resumed=() if self.about is None else self.about.resumed,
            output=str(folder),
        )

    def _reporter(self) -> Reporter | None:
        """What watches the protocol, where that is asked for."""
        if self.options.protocol_report is None:
            return None
        from deploy.protocol_report.reporter import Reporter

        return Reporter(self.scene, self.plan.partition.lattice, self.options.protocol_report)

    def _report(self, ledger: Ledger) -> ProtocolReport | None:
        """What the protocol did, where that is asked for."""
        if self.reporter is None:
            return None
        from deploy.protocol_report.reporter import deaths_of

        tally = dict[str, int]() if self.counts is None else self.counts.tally
        return self.reporter.report(ledger.ticks, deaths_of(ledger.faults), tally)

    def _write_report(self, summary: Summary, folder: Path) -> Summary:
        """The report's table, and its picture unless there are to be none; nothing where none was asked for."""
        if summary.protocol is None:
            return summary
        from deploy.protocol_report.files import write_csv
        from deploy.protocol_report.picture import draw_protocol
        from deploy.protocol_report.report import CSV, PICTURE

        assert self.reporter is not None
        reporter, report = self.reporter, summary.protocol
        write_csv(reporter.residuals, folder / CSV)
        if not self.options.picture or self.status == "interrupted":
            return summary
        path = folder / PICTURE
        return drawn(summary, lambda: draw_protocol(reporter, report, path), folder, self.interruption)

    def _warn(self, line: str, progress: Progress | None = None) -> None:
        if progress is not None:
            progress.say(line)
        elif not self.quiet:
            sys.stderr.write(f"mdms: {line}\n")
            sys.stderr.flush()


def _firmware(scene: Scene) -> dict[str, str | int]:
    """What the cells ran, for the summary."""
    from cell_firmware.loader import load

    firmware = load(scene.cells)
    size = 0 if firmware.message is None else firmware.message.itemsize
    return {"name": scene.cells.firmware.rpartition("/")[2], "form": firmware.form, "message_bytes": size}


def _of_effects(tally: Mapping[str, int]) -> dict[str, int]:
    """What effects counted; what cells count of their messages is for the protocol's report."""
    return {name: number for name, number in sorted(tally.items()) if not name.startswith("messages.")}


def load_plant(scene: Scene, warn: Callable[[str], None]) -> Plant:
    """The plant of a scene, its kernels compiled or loaded; says so where that takes long.

    Raises:
        InputError: The plant refuses the scene.
    """
    from plant.kernels.cache import folder
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
        plant.make_ready()
    return plant


def status_of(error: PlantError) -> str:
    """``unstable`` where the numbers ran away, else ``failed``."""
    return "unstable" if isinstance(error, PlantUnstable) else "failed"


def pacer(factor: float) -> Callable[[int], None]:
    """Something that waits, before a tick, until its simulated time has come on the wall clock.

    Args:
        factor: Simulated seconds a wall second.
    """
    begun: float | None = None

    def pace(start_ns: int) -> None:
        nonlocal begun
        now = time.monotonic()
        if begun is None:
            begun = now - start_ns * 1e-9 / factor
        ahead = begun + start_ns * 1e-9 / factor - now
        if ahead > 0:
            time.sleep(ahead)

    return pace
