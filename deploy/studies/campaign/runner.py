"""Campaign runner: from a campaign's specification to its report."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, final

from pydantic import TypeAdapter

from deploy.errors import DeployError, InputError
from deploy.studies.campaign.cases import with_seed
from deploy.studies.campaign.console import CampaignProgress
from deploy.studies.campaign.pool import Executor, ExecutorPool
from deploy.studies.campaign.report import CampaignReport, aggregate
from deploy.studies.campaign.result import CaseOutcome, CaseRecord, evaluate
from deploy.util.formatting import say, silent
from deploy.util.signals import Interrupted, Interruption

if TYPE_CHECKING:
    from deploy.scenes.scene import Scene
    from deploy.studies.campaign.cases import Case, Cases
    from deploy.studies.campaign.spec import CampaignSpec
    from deploy.workers.cluster import DaskCluster


FILE_NAME = "runs.jsonl"

_ENDING = TypeAdapter(CaseRecord)
_OUTCOME = TypeAdapter(CaseOutcome)


@final
class Journal:
    """Journal of completed runs, in the file and in memory.

    Each line is written in one call and flushed. However the campaign ends, at most the last line is incomplete; it is
    dropped when the file is opened again.

    Args:
        folder: Folder of the campaign, locked by the caller (``deploy.util.output_lock``).

    Raises:
        InputError: A line of the file makes no sense.
        DeployError: The file can't be opened.

    Attributes:
        runs: Outcome of each run, by the case's number and the seed.
        baselines: End of each baseline run, by its identifier.
    """

    def __init__(self, folder: Path) -> None:
        self.runs: dict[tuple[int, int], CaseOutcome] = {}
        self.baselines: dict[str, CaseRecord] = {}
        self._path = folder / FILE_NAME
        try:
            self._file = self._path.open("ab+", buffering=0)
        except OSError as error:
            raise DeployError(f"can't open {self._path}: {error.strerror or error}") from None
        try:
            self._read()
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def _read(self) -> None:
        self._file.seek(0)
        content = self._file.read()
        whole = content.rfind(b"\n") + 1
        self._file.truncate(whole)
        for number, line in enumerate(content[:whole].splitlines(), start=1):
            try:
                self._take(json.loads(line))
            except (ValueError, KeyError, TypeError) as error:
                raise InputError(
                    f"{self._path}: line {number} is not a run of a campaign: {error!r}"
                ) from None

    def _take(self, line: Mapping[str, Any]) -> None:
        if "baseline" in line:
            self.baselines[line["baseline"]] = _ENDING.validate_python(line["ending"])
        else:
            self.runs[line["case"], line["seed"]] = _OUTCOME.validate_python(line)

    def add_baseline(self, key: str, seed: int, ending: CaseRecord) -> None:
        """Keep how a baseline run ended.

        Raises:
            DeployError: It can't be written.
        """
        self._append({"baseline": key, "seed": seed, "ending": asdict(ending)})
        self.baselines[key] = ending

    def add_run(self, case: Case, seed: int, outcome: CaseOutcome) -> None:
        """Keep what a run came to.

        Raises:
            DeployError: It can't be written.
        """
        self._append({"case": case.number, "seed": seed, "values": case.values, **asdict(outcome)})
        self.runs[case.number, seed] = outcome

    def _append(self, line: Mapping[str, Any]) -> None:
        content = json.dumps(line, ensure_ascii=False, default=str).encode() + b"\n"
        try:
            while content:
                content = content[self._file.write(content) :]
        except OSError as error:
            raise DeployError(f"can't write {self._path}: {error.strerror or error}") from error


@final
@dataclass(frozen=True, slots=True)
class Campaign:
    """A campaign: its cases, and the folder of its results.

    Attributes:
        spec: Specification of the campaign.
        cases: Cases that the specification expands to.
        folder: Folder of results, including those of earlier runs; locked by the caller (``deploy.util.output_lock``).
        quiet: Show no progress and no warnings on stderr.
    """

    spec: CampaignSpec
    cases: Cases
    folder: Path
    quiet: bool = False

    def run(
        self, jobs: int, interruption: Interruption, cluster: DaskCluster | None = None
    ) -> CampaignReport:
        """Do all runs that are missing.

        Args:
            jobs: Runs at a time, without a cluster.
            interruption: Ends the campaign early; what is over by then is retained.
            cluster: Dask cluster that does the runs; None: worker processes of this machine.

        Returns:
            The report, of all runs that are over.

        Raises:
            InputError: A line of the file of runs that are over makes no sense, or a worker of the cluster would
                produce other bits.
            DeployError: No worker can be started, the cluster is lost, or a result can't be written.
        """
        with Journal(self.folder) as journal:
            status, reason = "ok", ""
            try:
                if len(journal.runs) < self.cases.runs:
                    if cluster is None:
                        self._run_parallel(journal, jobs, interruption)
                    else:
                        self._run_on_cluster(journal, cluster, interruption)
            except Interrupted:
                over, total = len(journal.runs), self.cases.runs
                status = "interrupted"
                reason = (
                    f"{over:,} of {total:,} runs are over; `mdms campaign --resume {self.folder}` resumes"
                )
            return self._report(journal, status, reason)

    def _run_parallel(self, journal: Journal, jobs: int, interruption: Interruption) -> None:
        # Workers import what they need while this process compiles kernels, or finds them compiled.
        with ExecutorPool(
            jobs, self.spec.limit_s, interruption.raise_if_requested, check=self.spec.check
        ) as pool:
            with interruption.interruptible():
                self._warm_up()
            self.execute(pool, journal)

    def _run_on_cluster(self, journal: Journal, cluster: DaskCluster, interruption: Interruption) -> None:
        from deploy.studies.campaign.cluster import ClusterError, ClusterExecutor

        with interruption.interruptible():
            executor = ClusterExecutor(
                cluster,
                self.cases.scene,
                self.spec.limit_s,
                interruption.raise_if_requested,
                check=self.spec.check,
                say=silent if self.quiet else say,
            )
            executor.warm(tuple(self._kinds()))
        try:
            self.execute(executor, journal)
        except ClusterError as error:
            raise DeployError(f"{error}: `mdms campaign --resume {self.folder}` resumes") from None

    def execute(self, executor: Executor, journal: Journal) -> None:
        """Execute all missing runs: first each baseline once, then the runs compared with a baseline.

        Args:
            executor: Executor of scenes.
            journal: Journal of completed runs, which is extended.
        """
        runs = [
            (case, seed)
            for case in self.cases.cases
            for seed in self.cases.seeds
            if (case.number, seed) not in journal.runs
        ]
        beside = {
            case.baseline_id(seed): with_seed(case.baseline, seed)
            for case, seed in runs
            if case.baseline is not None
        }
        missing = [(key, scene) for key, scene in beside.items() if key not in journal.baselines]
        failed = sum(one.status != "ok" for one in journal.runs.values())
        done = len(journal.runs)
        with CampaignProgress(self.cases.runs + len(missing), done, failed, quiet=self.quiet) as progress:
            for place, ending in executor.map(scene for _, scene in missing):
                key, scene = missing[place]
                journal.add_baseline(key, scene.seed, ending)
                progress.advance(failed=False)
            self._run_cases(executor, journal, runs, progress)

    def _run_cases(
        self,
        executor: Executor,
        journal: Journal,
        runs: Sequence[tuple[Case, int]],
        progress: CampaignProgress,
    ) -> None:
        for place, ending in executor.map(with_seed(case.scene, seed) for case, seed in runs):
            case, seed = runs[place]
            baseline = journal.baselines.get(case.baseline_id(seed))
            outcome = evaluate(ending, baseline, case.criterion)
            journal.add_run(case, seed, outcome)
            progress.advance(failed=outcome.status != "ok")

    def _warm_up(self) -> None:
        """Have kernels on disk before several processes look for them there."""
        from deploy.runs.setup import load_plant

        for scene in self._kinds():
            with suppress(InputError):  # every run of it will say so
                load_plant(scene, silent if self.quiet else say)

    def _kinds(self) -> Iterator[Scene]:
        """Yield a scene for each set of kernels."""
        seen: set[tuple[object, ...]] = set()
        for case in self.cases.cases:
            effects = case.scene.effects
            kind = (case.scene.solver.name, effects.clock is None, effects.motors is None)
            if kind not in seen:
                seen.add(kind)
                yield case.scene

    def _report(self, journal: Journal, status: str, reason: str) -> CampaignReport:
        outcomes = journal.runs
        if status == "ok" and all(one.status != "ok" for one in outcomes.values()):
            first = outcomes[min(outcomes)]
            status, reason = "failed", f"no run completed; the first: {first.status}: {first.reason}"
        rows = tuple(aggregate(self.cases, outcomes, self.spec.confidence))
        return CampaignReport(
            status=status,
            reason=reason,
            spec=self.spec,
            cases=self.cases,
            outcomes=outcomes,
            rows=rows,
            folder=self.folder,
        )
