"""Run of the whole system: cells, bus and plant in lockstep, with recording, summary and plots."""

from __future__ import annotations

import sys
import time
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, final

from deploy.checkpoints.checkpointer import checkpoint_metadata
from deploy.checkpoints.store import CheckpointStore
from deploy.control.client import advertise
from deploy.errors import DeployError
from deploy.recordings.digest import Digest
from deploy.recordings.run_log import RunLog
from deploy.recordings.writer import Recorder
from deploy.runs.output import (
    default_run,
    draw_or_interrupt,
    recording_header,
    write_or_fail,
)
from deploy.runs.output_folder import output_folder, remove_results
from deploy.runs.recorded import RecordedRun
from deploy.runs.rejections import RejectionMonitor
from deploy.runs.result import RunResult, summary_of
from deploy.runs.setup import RunSetup, load_plant, prepare_run
from deploy.runs.summary import Outcome, Summary
from deploy.util.output_lock import OutputLock
from deploy.util.progress import Progress
from deploy.util.signals import Interruption
from deploy.workers.plan import RunOptions
from deploy.workers.system import System

if TYPE_CHECKING:
    from deploy.checkpoints.checkpoint import Checkpoint
    from deploy.checkpoints.checkpointer import CheckpointMetadata
    from deploy.protocol_report.report import ProtocolReport
    from deploy.runs.checking import RunChecker
    from deploy.runs.picture_process import PictureProcess
    from deploy.scenes.scene import Scene
    from deploy.workers.plan import Plan
    from plant.plant import Plant


def run(
    scene: Scene,
    options: RunOptions | None = None,
    *,
    quiet: bool = False,
    interruption: Interruption | None = None,
    resumed: Checkpoint | None = None,
    lock: OutputLock | None = None,
) -> Outcome:
    """Run the whole system once, and again after each reset by an operator.

    Once the cells are started, the outcome's status and reason say how the run ended. On return, every started
    process has ended, and the recording is complete up to the end of the run.

    Args:
        scene: What to run.
        options: How to run it.
        quiet: Show no progress and no warnings on stderr.
        interruption: Signal handling of the caller, if the caller handles signals.
        resumed: Checkpoint to resume from, in ``options.output``; scene and options are the checkpoint's.
        lock: Lock of ``options.output``, if the caller took it to read the checkpoint.

    Raises:
        InputError: Bad input, such as a scene that the plant refuses, or an output folder to which another process
            is writing; nothing was started.
        Interrupted: SIGINT or SIGTERM came before the run had a recording.
    """
    interruption = interruption or Interruption()
    options = options or RunOptions()
    with interruption.handling():
        while True:
            begun = time.monotonic()
            with interruption.interruptible():
                setup = prepare_run(scene, options, resumed)
            with ExitStack() as locked:
                one = _Run(setup, interruption, begun, lock, locked, quiet=quiet)
                outcome = one.go()
            if not one.result.reset:
                return outcome
            options, resumed, lock = replace(options, output=_beside(options.output)), None, None


def _beside(folder: Path | None) -> Path | None:
    """Return a folder for the run after a reset: ``FOLDER-2``, or the next number that is free."""
    if folder is None:
        return None
    return next(path for i in count(2) if not (path := folder.with_name(f"{folder.name}-{i}")).exists())


def joining(plan: Plan, scene: Scene, join: str) -> str:
    """Say how processes of cells join a run that is waiting for them."""
    count = plan.partition.count
    which, values = f"--shard I/{count}", f"I from 0 to {count - 1}"
    if plan.setting == "each":
        which, values = "--cell ROW,COLUMN", f"for each of {count} cells"
    elif count == 1:
        which, values = "--shard 0/1", "one process"
    named = "" if plan.run == default_run(scene) else f" --run {plan.run}"
    return (
        f"run {plan.run} waits for cells: mdms cells {scene.name} {which} --connect {join}{named} ({values})"
    )


@final
class _Run:
    """One run of the whole system, from start-up to the plots."""

    def __init__(
        self,
        setup: RunSetup,
        interruption: Interruption,
        begun: float,
        lock: OutputLock | None,
        locked: ExitStack,
        *,
        quiet: bool,
    ) -> None:
        self.setup = setup
        self.interruption = interruption
        self.begun = begun
        self.lock = lock
        self.locked = locked
        self.quiet = quiet
        self.about: CheckpointMetadata | None = None
        self.result: RunResult
        self.checker: RunChecker | None = None
        self.picture: PictureProcess | None = None

    def go(self) -> Outcome:
        """Run, and write all outputs; see `run`."""
        setup = self.setup
        for line in setup.warnings:
            self._warn(f"warning: {line}")
        live = setup.byte_accurate_links
        with System(setup.plan, setup.scene, setup.options, live=live) as system:
            self._start_drawing()
            with self.interruption.interruptible():
                plant = load_plant(setup.scene, self._warn)
                self.about = checkpoint_metadata(
                    setup.scene,
                    setup.plan,
                    setup.options,
                    plant,
                    setup.resumed,
                    live=setup.byte_accurate_links,
                )
            system.open(self.interruption.raise_if_requested)
            if setup.plan.external and setup.options.cluster is None:
                self._warn(joining(setup.plan, setup.scene, system.join))
            if setup.options.listen is not None and system.locator:
                self._warn(f"listeners and operators connect to {system.locator}")
            self.interruption.raise_if_requested()
            folder = self._folder()
            run_log, refused = self._record(system, plant, folder)
        self._compare(run_log.digest)
        summary = summary_of(
            setup.scene,
            setup.plan,
            self.result,
            plant,
            run_log,
            refused,
            folder,
            warnings=setup.warnings,
            protocol=self._report(run_log),
            check=self.checker and self.checker.as_json(),
            resumed=() if self.about is None else self.about.resumed,
        )
        for leave in (self._write, self._write_report, self._illustrate):
            summary = write_or_fail(summary, folder, leave, self._warn)
        return Outcome(summary, self.result.detail)

    def _folder(self) -> Path:
        """Return the output folder, locked until the run is over."""
        scene, wanted = self.setup.scene, self.setup.options.output
        if self.setup.resumed is None:
            return self.locked.enter_context(output_folder(scene, wanted, self._warn))
        assert wanted is not None, "this is a bug: a run goes on in no folder"
        if self.lock is None:
            self.locked.enter_context(OutputLock(wanted, self._warn))
        return wanted

    def _record(self, system: System, plant: Plant, folder: Path) -> tuple[RunLog, RejectionMonitor]:
        """Execute the run and record it."""
        scene, resumed = self.setup.scene, self.setup.resumed
        run = self.setup.plan.run
        with (
            Recorder(
                folder,
                recording_header(run, scene, plant.array, plant.footprints_m),
                continued_from=None if resumed is None else resumed.recorded,
            ) as recorder,
            Progress(scene.duration_ns, quiet=self.quiet) as progress,
        ):
            if resumed is not None:  # not before its recording is whole: a full disk is to cost nothing
                remove_results(folder)
            warn = partial(self._warn, progress=progress)
            run_log = RunLog(
                plant.array.lattice.cells,
                scene.tick_ns,
                digest=Digest(scene.canonical()),
                recorder=recorder,
                progress=progress,
                policy=scene.stall.policy,
                warn=warn,
                injected=self.setup.in_run_faults,
            )
            refused = RejectionMonitor(system.refusals, warn)
            execution = RecordedRun(
                self.setup,
                self.about,
                system,
                plant,
                run_log,
                recorder,
                refused,
                self.interruption,
            )
            with advertise(run, system.locator, folder):
                self.result = execution.run(self.begun)
            self.checker = execution.checker
            self._close(recorder, run_log)
        return run_log, refused

    def _close(self, recorder: Recorder, run_log: RunLog) -> None:
        """End the recording; a write error fails the run."""
        try:
            recorder.close(self.result.status, run_log.digest, run_log.motion_digest)
        except DeployError as error:
            if self.result.status == "ok":
                self.result.end("failed", str(error))
            elif str(error) != self.result.reason:
                self._warn(str(error))

    def _compare(self, digest: str) -> None:
        """Compare the digest of a replay with the recording's; a difference fails the run."""
        replayed, path = self.setup.replayed, self.setup.options.replay
        if replayed is None or self.result.status != replayed.status:
            return
        if digest == replayed.digest:
            self._warn(f"the digest is equal to that of {path}")
        else:
            self.result.end("failed", f"the digest differs from that of {path}, {replayed.digest}")

    # --- outputs -----------------------------------------------------------------------------------

    def _write(self, summary: Summary, folder: Path) -> Summary:
        summary.write(folder)
        if self.about is not None and self.result.status == "ok":
            CheckpointStore(folder).clear()
        return summary

    def _start_drawing(self) -> None:
        """Start the process that draws the overview; with ``--realtime`` it would take time from the run."""
        options = self.setup.options
        if options.picture and options.realtime is None and self.setup.plan.workers:
            from deploy.runs.picture_process import PictureProcess

            self.picture = self.locked.enter_context(PictureProcess())

    def _illustrate(self, summary: Summary, folder: Path) -> Summary:
        if not self.setup.options.picture or summary.status == "interrupted":
            return summary
        from deploy.plots.overview import FILE_NAME, draw_overview
        from deploy.recordings.reader import load

        def draw() -> None:
            if self.picture is None or not self.picture.draw(folder):
                draw_overview(load(folder), folder / FILE_NAME)

        return draw_or_interrupt(summary, draw, folder, self.interruption)

    def _report(self, run_log: RunLog) -> ProtocolReport | None:
        """Return the protocol report; None without a reporter."""
        if self.setup.reporter is None:
            return None
        from deploy.protocol_report.reporter import deaths_of

        return self.setup.reporter.report(
            run_log.ticks, deaths_of(run_log.faults), self.result.counters.cell_counters
        )

    def _write_report(self, summary: Summary, folder: Path) -> Summary:
        """Write the protocol report's table, and its plot unless plots are off; do nothing without a report."""
        reporter = self.setup.reporter
        if reporter is None or summary.protocol is None:
            return summary
        from deploy.protocol_report.output import write_csv
        from deploy.protocol_report.plot import draw_protocol
        from deploy.protocol_report.report import CSV, PICTURE

        report = summary.protocol
        write_csv(reporter.residuals, folder / CSV)
        if not self.setup.options.picture or self.result.status == "interrupted":
            return summary
        path = folder / PICTURE
        return draw_or_interrupt(
            summary, lambda: draw_protocol(reporter, report, path), folder, self.interruption
        )

    def _warn(self, line: str, progress: Progress | None = None) -> None:
        if progress is not None:
            progress.say(line)
        elif not self.quiet:
            sys.stderr.write(f"mdms: {line}\n")
            sys.stderr.flush()
