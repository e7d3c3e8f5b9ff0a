"""``mdms campaign``: many runs over seeds, faults and parameters, with a table and a plot."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from deploy.commands.completion import fault_kinds
from deploy.commands.options import (
    EXECUTION_PANEL,
    DurationOption,
    JsonOption,
    QuietOption,
    SceneUnlessArgument,
    SetOption,
)
from deploy.errors import InputError
from deploy.util.formatting import say, silent

if TYPE_CHECKING:
    from deploy.studies.campaign.report import CampaignReport
    from deploy.studies.campaign.spec import CampaignSpec
    from deploy.workers.cluster import DaskCluster

_VARIED, _JUDGED = "Variation", "Criterion"
_VALUES = "FROM:TO:STEP"

FaultOption = Annotated[
    str | None,
    typer.Option(
        "--fault",
        autocompletion=fault_kinds,
        rich_help_panel=_VARIED,
        metavar="KIND",
        help="Add a fault of this kind to the scene. Its keys are set by --set fault.KEY=VALUE and varied by "
        "--vary fault.KEY=VALUES. Without a key that selects cells, the fault affects all cells.",
    ),
]
ShareOption = Annotated[
    str | None,
    typer.Option(
        "--share",
        rich_help_panel=_VARIED,
        metavar=_VALUES,
        help="Shares of the cells that the fault affects, drawn by the seed: --vary fault.share=...",
    ),
]
VaryOption = Annotated[
    list[str] | None,
    typer.Option(
        "--vary",
        rich_help_panel=_VARIED,
        metavar="KEY=VALUES",
        help="Vary any value of the scene or the fault: FROM:TO:STEP, or TOML values with commas between them. "
        "Repeatable: every combination runs.",
    ),
]
AtOption = Annotated[
    float | None,
    typer.Option("--at", rich_help_panel=_VARIED, metavar="SECONDS", help="Start of the fault. Default: 0."),
]
UntilOption = Annotated[
    float | None,
    typer.Option(
        "--until",
        rich_help_panel=_VARIED,
        metavar="SECONDS",
        help="End of the fault. Default: it doesn't end.",
    ),
]
SeedsOption = Annotated[
    str | None,
    typer.Option(
        "--seeds",
        rich_help_panel=_VARIED,
        metavar="N",
        help="Run every combination with N seeds from the scene's seed on; or FROM:TO, or a list. Default: 10.",
    ),
]
AgainstOption = Annotated[
    list[str] | None,
    typer.Option(
        "--against",
        rich_help_panel=_JUDGED,
        metavar="KEY=VALUE",
        help="Value of the scene in the baseline run. Repeatable. Without --fault and --against there is no "
        "baseline run, and no error.",
    ),
]
WithinOption = Annotated[
    float | None,
    typer.Option(
        "--within",
        rich_help_panel=_JUDGED,
        metavar="METRES",
        help="Largest error of a success. Default: from the scene's \\[goal]; without either the campaign is refused.",
    ),
]
ConfidenceOption = Annotated[
    float | None,
    typer.Option(
        "--confidence",
        rich_help_panel=_JUDGED,
        metavar="SHARE",
        help="Confidence level of the intervals. Default: 0.95.",
    ),
]
LimitOption = Annotated[
    float | None,
    typer.Option(
        "--limit",
        rich_help_panel=EXECUTION_PANEL,
        metavar="SECONDS",
        help="Wall time after which a run is ended and counts as failed. Default: 600.",
    ),
]
JobsOption = Annotated[
    int | None,
    typer.Option(
        "--jobs",
        rich_help_panel=EXECUTION_PANEL,
        metavar="N",
        min=1,
        help="Number of simultaneous runs. Default: one per processor.",
    ),
]
ClusterOption = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        rich_help_panel=EXECUTION_PANEL,
        metavar="ADDRESS|local",
        help="Execute the runs on the Dask cluster with this scheduler, such as tls://10.0.0.5:8786, or its scheduler "
        "file; local: on one started here for this campaign, with --jobs workers.",
    ),
]
InsecureOption = Annotated[
    bool,
    typer.Option(
        "--insecure",
        rich_help_panel=EXECUTION_PANEL,
        help="With --cluster: accept a scheduler on another host without TLS.",
    ),
]
OutputOption = Annotated[
    Path | None,
    typer.Option(
        "--output",
        rich_help_panel=EXECUTION_PANEL,
        metavar="DIR",
        help="Folder for the results. Default: one under runs/.",
    ),
]
CheckOption = Annotated[
    bool,
    typer.Option(
        "--check",
        rich_help_panel=_JUDGED,
        help="Check the invariants of the cells' program after every tick; a run that breaks one fails.",
    ),
]
ResumeOption = Annotated[
    Path | None,
    typer.Option(
        "--resume",
        rich_help_panel=EXECUTION_PANEL,
        metavar="DIR",
        help="Resume the campaign in this folder: execute its missing runs. Needs no SCENE and no other option.",
    ),
]
OtherVersionsOption = Annotated[
    bool,
    typer.Option(
        "--other-versions",
        rich_help_panel=EXECUTION_PANEL,
        help="With --resume: accept that this program or a library it uses has another version than at the start.",
    ),
]
PictureOption = Annotated[
    bool,
    typer.Option(
        "--picture/--no-picture", rich_help_panel=EXECUTION_PANEL, help="Draw campaign.png at the end."
    ),
]


def campaign(
    scene: SceneUnlessArgument = None,
    *,
    sets: SetOption = None,
    duration: DurationOption = None,
    fault: FaultOption = None,
    share: ShareOption = None,
    vary: VaryOption = None,
    at: AtOption = None,
    until: UntilOption = None,
    seeds: SeedsOption = None,
    against: AgainstOption = None,
    within: WithinOption = None,
    confidence: ConfidenceOption = None,
    limit: LimitOption = None,
    check: CheckOption = False,
    jobs: JobsOption = None,
    cluster: ClusterOption = None,
    insecure: InsecureOption = False,
    output: OutputOption = None,
    resume: ResumeOption = None,
    other_versions: OtherVersionsOption = False,
    picture: PictureOption = True,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    r"""Run a scene many times, over seeds, faults and parameters: success, error and time with confidence intervals.

    Every run is the whole system, cells and messages included, in one process, with the digest of mdms run. There are
    as many simultaneous runs as processors. A run that fails, hangs or is killed is recorded with its seed, and the
    other runs continue. Writes runs.jsonl, campaign.csv, campaign.json and campaign.png.

    A run has succeeded if its status is ok; no parcel tipped, fell off the array other than through an exit, or was
    misrouted; every parcel that rests or has left in the baseline run also does so in this run (a parcel that should
    rest may also have left); and the error is at most --within, or the scene's \[goal] is met. The baseline run has
    the same scene and seed, without the campaign's fault. The error is the largest final distance of a parcel's corner
    from its place in the baseline run. Without a baseline run, the error is the largest distance of a parcel's
    centre of mass from the goal's place. The time is when the last parcel came to rest or left.

    Random deaths of cells; message loss; a parameter of the protocol:

      [cyan]mdms campaign align --fault crash --share 0:0.3:0.05 --seeds 50[/cyan]
      [cyan]mdms campaign noisy --vary effects.link_loss.probability=0:0.4:0.1 --seeds 20[/cyan]
      [cyan]mdms campaign heat --vary cells.parameters.diffusion_number=0.05:0.25:0.05 --seeds 1[/cyan]

    Resume an interrupted campaign:

      [cyan]mdms campaign --resume runs/align-campaign-20260301-120000[/cyan]

    On the workers of a Dask cluster:

      [cyan]mdms campaign align --fault crash --share 0:0.3:0.05 --cluster tls://10.0.0.5:8786[/cyan]
    """
    given: dict[str, Any] = {
        "scene": scene,
        "set": _texts(sets),
        "duration_s": duration,
        "fault": fault,
        "share": share,
        "vary": _texts(vary),
        "at_s": at,
        "until_s": until,
        "seeds": seeds,
        "against": _texts(against),
        "within_m": within,
        "limit_s": limit,
        "confidence": confidence,
        "check": check or None,
    }
    if resume is None:
        spec, text, folder = _new(given, output)
        programs = None
    else:
        if output is not None:
            raise InputError(
                f"--output {output}: --resume {resume} writes to its own folder; leave --output out"
            )
        spec, text, programs = _resumed(given, resume, other_versions=other_versions)
        folder = resume
    with ExitStack() as locked:
        execution = _Execution(jobs, cluster, insecure=insecure, quiet=quiet)
        report = _run(spec, text, folder, execution, locked, programs)
        _finish(report, picture=picture, as_json=as_json)


class _Execution(NamedTuple):
    """Execution of a campaign, without effect on results.

    Attributes:
        jobs: Simultaneous runs on this machine; None: one per processor.
        cluster: Dask cluster of the runs; None: processes of this machine.
        insecure: Accept a scheduler on another host without TLS.
        quiet: Show no progress and no warnings.
    """

    jobs: int | None
    cluster: str | None
    insecure: bool
    quiet: bool

    def check(self) -> None:
        """Refuse options that don't go together.

        Raises:
            InputError: Names them.
        """
        from deploy.workers.cluster import LOCAL

        if self.cluster not in (None, LOCAL) and self.jobs is not None:
            raise InputError(
                f"--jobs {self.jobs}: the workers of --cluster {self.cluster} decide how many runs go on at a time"
            )
        if self.insecure and self.cluster is None:
            raise InputError("--insecure: is for --cluster ADDRESS")


def _texts(options: list[str] | None) -> tuple[str, ...] | None:
    return tuple(options) if options else None


def _new(given: dict[str, Any], output: Path | None) -> tuple[CampaignSpec, str, Path | None]:
    from deploy.scenes.files import bundled_names, scene_text
    from deploy.studies.campaign.spec import read_options

    scene = given["scene"]
    if scene is None:
        raise InputError("campaign: which SCENE? (`mdms scenes` lists the bundled ones)")
    if output is not None:
        _check_new(output)
    text = scene_text(scene)
    folder = None if scene in bundled_names() else str(Path(scene).parent.resolve())
    return read_options({**given, "folder": folder}), text, output


def _check_new(folder: Path) -> None:
    from deploy.studies.campaign.spec import FILE_NAME

    if (folder / FILE_NAME).exists():
        raise InputError(f"--output {folder}: holds a campaign already; --resume {folder} resumes it")


def _resumed(
    given: dict[str, Any], folder: Path, *, other_versions: bool
) -> tuple[CampaignSpec, str, dict[str, str]]:
    """Return specification, scene and programs of a campaign that is gone on with."""
    from deploy.runs.output import versions
    from deploy.studies.campaign.spec import check_same, check_versions, read

    stored = read(folder)
    check_same(stored.spec, given, folder)
    if not other_versions:
        check_versions(stored.versions, versions(), folder)
    return stored.spec, stored.scene, stored.programs


def _run(
    spec: CampaignSpec,
    text: str,
    folder: Path | None,
    execution: _Execution,
    locked: ExitStack,
    programs: dict[str, str] | None,
) -> CampaignReport:
    """Carry out a campaign; its folder is locked until ``locked`` closes.

    ``programs`` are those that the campaign began with; None: it begins.
    """
    import time

    from deploy.runs.output import run_name, versions
    from deploy.runs.setup import check_conditions, warnings_of
    from deploy.scenes.fingerprint import program_fingerprint
    from deploy.studies.campaign.cases import cases_of
    from deploy.studies.campaign.runner import Campaign
    from deploy.studies.campaign.spec import check_programs, write
    from deploy.util.output_lock import OutputLock, locked_folder, new_folder
    from deploy.util.signals import Interruption
    from plant.solvers.thread_pool import processors

    execution.check()
    quiet, jobs = execution.quiet, execution.jobs or processors()
    interruption = Interruption()
    with interruption.handling(last=True):
        notify = silent if quiet else say
        with interruption.interruptible():
            cases = cases_of(spec, text)
            if spec.check:
                for case in cases.cases:
                    check_conditions(case.scene)
            for line in dict.fromkeys(line for case in cases.cases for line in warnings_of(case.scene)):
                notify(f"warning: {line}")
            cluster = _connect(execution, jobs, locked, notify)
        own = {case.scene.cells.firmware: program_fingerprint(case.scene) for case in cases.cases}
        if folder is None:
            folder = new_folder(run_name(cases.scene, f"campaign-{time.strftime('%Y%m%d-%H%M%S')}"))
        if programs is not None:
            locked.enter_context(OutputLock(folder, notify, named="--resume"))
            check_programs(programs, own, folder)
        else:
            locked.enter_context(locked_folder(folder, notify))
            _check_new(folder)  # another may have begun one since
            write(spec, text, versions(), own, folder)
        return Campaign(spec, cases, folder, quiet=quiet).run(jobs, interruption, cluster)


def _connect(
    execution: _Execution, jobs: int, held: ExitStack, notify: Callable[[str], None]
) -> DaskCluster | None:
    """Connect to the requested cluster, until ``held`` closes; None where none is requested."""
    if execution.cluster is None:
        return None
    from deploy.workers.cluster import DaskCluster, describe

    cluster = held.enter_context(DaskCluster(execution.cluster, jobs, insecure=execution.insecure))
    notify(describe(cluster))
    return cluster


def _finish(report: CampaignReport, *, picture: bool, as_json: bool) -> None:
    """Print and write a campaign's report, and exit with the matching status."""
    from deploy.commands.outcome import EXIT_STATUS
    from deploy.studies.campaign.console import print_report
    from deploy.studies.campaign.plot import FILE_NAME, draw_campaign, why_none

    if report.status != "interrupted":
        report.write()
        if picture and not why_none(report):
            draw_campaign(report, report.folder / FILE_NAME)
    if as_json:
        print(report.to_json())
    else:
        print_report(report)
        if report.status != "interrupted" and picture and why_none(report):
            print(f"No plot: {why_none(report)}.")
        print(f"\n{report.folder}")
    sys.stdout.flush()
    if report.status != "ok":
        sys.stderr.write(f"mdms: {report.status}: {report.reason}\n")
        raise typer.Exit(EXIT_STATUS[report.status])
