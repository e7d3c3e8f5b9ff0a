"""A campaign from what was asked to its report."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, final

from deploy.campaign.cases import with_seed
from deploy.campaign.journal import Journal
from deploy.campaign.outcome import judged
from deploy.campaign.pool import Executor, Pool
from deploy.campaign.progress import Progress
from deploy.campaign.report import Report
from deploy.campaign.rows import rows_of
from deploy.errors import InputError
from deploy.interruption import Interrupted, Interruption
from deploy.words import say, silent

if TYPE_CHECKING:
    from deploy.campaign.asked import Asked
    from deploy.campaign.cases import Case, Cases


@final
@dataclass(frozen=True, slots=True)
class Campaign:
    """What is run, and where its results go.

    Attributes:
        asked: What was asked for.
        cases: What that means.
        folder: Where results go, those of runs done before included; locked by the caller (``deploy.output_lock``).
        quiet: Show no progress and no warnings on stderr.
    """

    asked: Asked
    cases: Cases
    folder: Path
    quiet: bool = False

    def run(self, jobs: int, interruption: Interruption) -> Report:
        """Do all runs that are missing, in worker processes of this machine.

        Args:
            jobs: Runs at a time.
            interruption: Ends the campaign early; what is over by then is kept.

        Returns:
            The report, of all runs that are over.

        Raises:
            InputError: A line of the file of runs that are over makes no sense.
            DeployError: No worker can be started, or a result can't be written.
        """
        with Journal(self.folder) as journal:
            status, reason = "ok", ""
            try:
                if len(journal.runs) < self.cases.runs:
                    self._work(journal, jobs, interruption)
            except Interrupted:
                over, total = len(journal.runs), self.cases.runs
                status = "interrupted"
                reason = (
                    f"{over:,} of {total:,} runs are over; `mdms campaign --resume {self.folder}` goes on"
                )
            return self._report(journal, status, reason)

    def _work(self, journal: Journal, jobs: int, interruption: Interruption) -> None:
        # Workers import what they need while this process compiles kernels, or finds them compiled.
        with Pool(jobs, self.asked.limit_s, interruption.check) as pool:
            with interruption.allowed():
                self._make_ready()
            self.carry_out(pool, journal)

    def carry_out(self, executor: Executor, journal: Journal) -> None:
        """Do all runs that are missing: first the undisturbed ones, each once, then those that are judged by them.

        Args:
            executor: Who runs scenes.
            journal: Of the runs that are over; continued.
        """
        runs = [
            (case, seed)
            for case in self.cases.cases
            for seed in self.cases.seeds
            if (case.number, seed) not in journal.runs
        ]
        beside = {
            case.undisturbed_key(seed): with_seed(case.undisturbed, seed)
            for case, seed in runs
            if case.undisturbed is not None
        }
        missing = [(key, scene) for key, scene in beside.items() if key not in journal.undisturbed]
        failed = sum(one.status != "ok" for one in journal.runs.values())
        done = len(journal.runs)
        with Progress(self.cases.runs + len(missing), done, failed, quiet=self.quiet) as progress:
            for place, ending in executor.carry_out(scene for _, scene in missing):
                key, scene = missing[place]
                journal.add_undisturbed(key, scene.seed, ending)
                progress.advance(failed=False)
            self._judge(executor, journal, runs, progress)

    def _judge(
        self, executor: Executor, journal: Journal, runs: Sequence[tuple[Case, int]], progress: Progress
    ) -> None:
        for place, ending in executor.carry_out(with_seed(case.scene, seed) for case, seed in runs):
            case, seed = runs[place]
            undisturbed = journal.undisturbed.get(case.undisturbed_key(seed))
            outcome = judged(ending, undisturbed, case.criterion)
            journal.add_run(case, seed, outcome)
            progress.advance(failed=outcome.status != "ok")

    def _make_ready(self) -> None:
        """Have kernels on disk before several processes look for them there."""
        from deploy.plants import load_plant

        seen: set[tuple[object, ...]] = set()
        for case in self.cases.cases:
            effects = case.scene.effects
            kind = (case.scene.solver.name, effects.clock is None, effects.motors is None)
            if kind not in seen:
                seen.add(kind)
                with suppress(InputError):  # every run of it will say so
                    load_plant(case.scene, silent if self.quiet else say)

    def _report(self, journal: Journal, status: str, reason: str) -> Report:
        outcomes = journal.runs
        if status == "ok" and all(one.status != "ok" for one in outcomes.values()):
            first = outcomes[min(outcomes)]
            status, reason = "failed", f"no run came to its end; the first: {first.status}: {first.reason}"
        rows = tuple(rows_of(self.cases, outcomes, self.asked.confidence))
        return Report(
            status=status,
            reason=reason,
            asked=self.asked,
            cases=self.cases,
            outcomes=outcomes,
            rows=rows,
            folder=self.folder,
        )
