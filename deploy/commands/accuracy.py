"""``mdms accuracy``: cost of accuracy on a scene, solver by solver."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deploy.commands.options import (
    DurationOption,
    JsonOption,
    QuietOption,
    SceneUnlessArgument,
    SetOption,
    load_scene,
)
from deploy.errors import InputError
from deploy.util.formatting import say, silent
from deploy.util.output_lock import locked_folder

if TYPE_CHECKING:
    from deploy.studies.accuracy.report import AccuracyReport

DocsOption = Annotated[
    Path | None,
    typer.Option(
        "--docs",
        metavar="[DIR]",
        help="Instead of a scene: measure every figure of the accuracy page, and write accuracy.md and its plots "
        "to DIR (default: docs). Takes minutes.",
    ),
]
OutputOption = Annotated[
    Path | None,
    typer.Option(
        "--output",
        metavar="DIR",
        help="Folder for accuracy.json, accuracy.csv and the plots. Default: nothing is written.",
    ),
]
TargetOption = Annotated[
    float | None,
    typer.Option(
        "--target",
        metavar="METRES",
        help="Print in one line the cheapest solver and setting whose error is at most METRES; of settings whose times "
        "can't be told apart, the loosest. Exit status 1: none.",
    ),
]
QuickOption = Annotated[
    bool, typer.Option("--quick", help="Few settings and few runs: under 30 s once every solver is compiled.")
]
RepeatsOption = Annotated[
    int | None,
    typer.Option(
        "--repeats",
        metavar="N",
        min=1,
        help="Rounds of timed runs, in which settings take turns. Default: 5, with --quick 3; fewer for long runs.",
    ),
]
SamplingOption = Annotated[
    bool,
    typer.Option("--sampling/--no-sampling", help="Also run the whole system at several control periods."),
]


def accuracy(
    scene: SceneUnlessArgument = None,
    *,
    sets: SetOption = None,
    duration: DurationOption = None,
    docs: DocsOption = None,
    target: TargetOption = None,
    quick: QuickOption = False,
    repeats: RepeatsOption = None,
    sampling: SamplingOption = True,
    output: OutputOption = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Measure the cost of accuracy in time: every solver that claims the scene, coarse to fine.

    Each solver is compared with a reference of another method (heyoka if the extra accuracy is installed). A third
    method and, where it exists, a closed form check the reference. The scene is simulated as by mdms simulate: ideal
    wheels at the field's speed. The first lines name the cheapest setting for several errors, with the noise of the
    times. --output DIR also writes tables and plots.

    A quick study; a full study; the cheapest solver for a target:

      [cyan]mdms accuracy elliptic --quick[/cyan]
      [cyan]mdms accuracy elliptic --output study[/cyan]
      [cyan]mdms accuracy elliptic --target 1e-6[/cyan]

    Repeat all measurements of the documentation's accuracy page:

      [cyan]mdms accuracy --docs[/cyan]
    """
    from dataclasses import replace

    from deploy.runs.setup import report_warnings
    from deploy.studies.accuracy.study import StudyPlan, study
    from deploy.util.signals import Interruption

    if target is not None and not 0.0 < target < float("inf"):
        raise InputError(f"--target {target}: must be > 0, metres")
    if docs is not None:
        _write_page(scene, docs, repeats, silent if quiet else say)
        return
    if scene is None:
        raise InputError("accuracy: which SCENE? (`mdms scenes` lists the bundled ones)")
    found = load_scene(scene, sets, duration=duration)
    interruption = Interruption()
    with interruption.handling(last=True), interruption.interruptible():
        plan = replace(StudyPlan.of(quick=quick, repeats=repeats), sampling=sampling and target is None)
        notify = silent if quiet else say
        report_warnings(found, notify)
        with locked_folder(output, notify) as folder:  # before the work: it would be for nothing
            report = study(found, plan, say=notify, poll=interruption.raise_if_requested)
            if folder is not None:
                from deploy.studies.accuracy.plots import write_report

                write_report(report, folder)
    _print(report, target, folder, as_json=as_json)


def _write_page(scene: str | None, docs: Path, repeats: int | None, say: Callable[[str], None]) -> None:
    from deploy.studies.accuracy.page import REPEATS, write
    from deploy.util.signals import Interruption

    if scene is not None:
        raise InputError(f"--docs {docs}: takes no SCENE: the page has its own scenes; leave SCENE out")
    interruption = Interruption()
    with interruption.handling(last=True), interruption.interruptible(), locked_folder(docs, say):
        print(write(docs, repeats=REPEATS if repeats is None else repeats, say=say))


def _print(report: AccuracyReport, target: float | None, folder: Path | None, *, as_json: bool) -> None:
    from deploy.studies.accuracy.console import answer, print_report

    if as_json:
        print(report.to_json(target))
    elif target is not None:
        print(answer(report, target))
    else:
        print_report(report)
        if folder is not None:
            print(f"\n{folder}")
    if target is not None and report.cheapest(target) is None:
        raise typer.Exit(1)
