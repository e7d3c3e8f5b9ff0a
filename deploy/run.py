"""The whole system: cells, bus and plant in lockstep; a recording, a summary and a picture at the end."""

from __future__ import annotations

import os
import secrets
import sys
import time
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

from bus.counts import Counts
from bus.errors import BusError
from bus.keys import plant_key
from bus.registers import Wanted
from deploy.cautions import cautions_of
from deploy.cell_times import cell_times
from deploy.checkpoints.keeping import about_run, go_on, keeper_of
from deploy.checkpoints.store import Store
from deploy.conduct import Conduct, pacer
from deploy.digest import Digest
from deploy.ending import Ending, summary_of
from deploy.errors import DeployError
from deploy.faults.schedule import active, crash_aborts, deaths, lasting, rests
from deploy.interruption import Interrupted, Interruption
from deploy.ledger import Ledger
from deploy.live.address import Address
from deploy.output import drawn, header, illustrate, left, output_folder, run_name
from deploy.plants import load_plant, status_of
from deploy.processes.plan import RunOptions, plan
from deploy.processes.system import System
from deploy.processes.worker import Resumed
from deploy.progress import Progress
from deploy.readings import camera_of, readings_of
from deploy.recordings.recorder import Recorder
from deploy.refused import Refused
from deploy.summary import Outcome, Summary
from plant.errors import PlantError

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
        self.ending = Ending()
        self.refused: Refused | None = None

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
                self.about = about_run(
                    self.scene, self.plan, self.options, plant, self.resumed, live=self.live
                )
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
        assert self.refused is not None
        summary = summary_of(
            self.scene,
            self.plan,
            self.ending,
            plant,
            ledger,
            self.refused,
            folder,
            cautions=self.cautions,
            protocol=self._report(ledger),
            resumed=() if self.about is None else self.about.resumed,
        )
        for leave in (self._write, self._write_report, self._illustrate):
            summary = left(summary, folder, leave, self._warn)
        return Outcome(summary, self.ending.detail)

    def _compare(self) -> None:
        """Say whether a run that was to repeat another came to the same."""
        if self.replayed is None or self.ending.status != self.replayed.status:
            return
        if self.digest.hexdigest == self.replayed.digest:
            self._warn(f"the digest is that of {self.options.replay}")
        else:
            self.ending.by(
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
            self.ending.startup_s = started - self.begun
            self.interruption.waits = lambda: process.waiting
            self._take(process.run(), ledger)
        except Interrupted:
            self.ending.by("interrupted", f"interrupted at {ledger.time_ns * 1e-9:g} s of simulated time")
        except (BusError, DeployError) as error:
            self.ending.by("failed", str(error))
        except PlantError as error:
            self.ending.by(status_of(error), f"{error} (tick {ledger.ticks})")
        finally:
            self.interruption.waits = lambda: False
            self.ending.wall_s = time.monotonic() - started
            if self.resumed is not None:
                self.ending.wall_s += self.resumed.wall_s
            if self.keeper is not None:
                self.keeper.close()
            if self.ending.status == "failed" or ledger.cells_lost:
                self.ending.detail = "\n".join(
                    text for text in (self.ending.detail, system.explain()) if text
                )
            counts = system.stop(self.ending.reason or "the run is over")
            self.ending.counts = counts or Counts()
            assert self.refused is not None
            self.refused.look(self.ending.counts)
        if process is not None and self.ending.status != "unstable" and not recorder.broken:
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
        self.keeper = keeper_of(
            self.about,
            self.options,
            host,
            ledger,
            recorder,
            reporter,
            resumed,
            self.scene.stall.deadline_s,
        )
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
            go_on(resumed, process, ledger, reporter)
        return process

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
            self.ending.by("failed", crash_aborts(cell, ledger.time_ns * 1e-9))
        elif ended.losses:
            ledger.lost(ended.losses)
            self.ending.by(ended.status, f"{ledger.describe(ended.losses)}; stall.policy is abort")
            self.ending.detail = next((loss.detail for loss in ended.losses if loss.detail), "")

    def _close(self, recorder: Recorder) -> None:
        """End the recording; what can't be written of it fails the run."""
        try:
            recorder.close(self.ending.status, self.digest.hexdigest)
        except DeployError as error:
            if self.ending.status == "ok":
                self.ending.by("failed", str(error))
            elif str(error) != self.ending.reason:
                self._warn(str(error))

    # --- what it leaves ---------------------------------------------------------------------------

    def _write(self, summary: Summary, folder: Path) -> Summary:
        summary.write(folder)
        if self.about is not None and self.ending.status == "ok":
            Store(folder).clear()
        return summary

    def _illustrate(self, summary: Summary, folder: Path) -> Summary:
        if not self.options.picture or summary.status == "interrupted":
            return summary
        from deploy.recordings.replay import load

        return illustrate(summary, lambda: load(folder), folder, self.interruption)

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

        return self.reporter.report(ledger.ticks, deaths_of(ledger.faults), self.ending.counts.tally)

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
        if not self.options.picture or self.ending.status == "interrupted":
            return summary
        path = folder / PICTURE
        return drawn(summary, lambda: draw_protocol(reporter, report, path), folder, self.interruption)

    def _warn(self, line: str, progress: Progress | None = None) -> None:
        if progress is not None:
            progress.say(line)
        elif not self.quiet:
            sys.stderr.write(f"mdms: {line}\n")
            sys.stderr.flush()
