"""``mdms effects``: additions, cost and influence of every effect."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deploy.commands.completion import effect_names
from deploy.commands.options import (
    DurationOption,
    JsonOption,
    QuietOption,
    SeedOption,
    SetOption,
    SolverOption,
    ToleranceOption,
    load_scene,
)
from deploy.errors import InputError
from deploy.util.formatting import say, silent
from deploy.util.output_lock import locked_folder

if TYPE_CHECKING:
    from deploy.scenes.scene import Scene
    from deploy.studies.effects.ladder import RungResult

OnlyOption = Annotated[
    str | None,
    typer.Option(
        "--only",
        metavar="NAME,...",
        help="Only these effects, separated by commas.",
        autocompletion=effect_names,
    ),
]
OutputOption = Annotated[
    Path | None,
    typer.Option(
        "--output",
        metavar="DIR",
        help="Run the ladder of fidelity, and plot it as ladder.png in this folder.",
    ),
]


def effects(
    scene: Annotated[
        str | None,
        typer.Argument(
            metavar="[SCENE]", help="A scene file, or the name of a bundled scene. Default: list all effects."
        ),
    ] = None,
    *,
    sets: SetOption = None,
    seed: SeedOption = None,
    duration: DurationOption = None,
    solver: SolverOption = None,
    tolerance: ToleranceOption = None,
    only: OnlyOption = None,
    repeats: Annotated[
        int,
        typer.Option("--repeats", min=1, help="Rounds of timed runs; their range is the noise of the cost."),
    ] = 3,
    advise: Annotated[
        bool,
        typer.Option(
            "--advise",
            help="List the effects that can be left out, the time that this saves, and the effects that are missing.",
        ),
    ] = False,
    tolerance_mm: Annotated[
        float,
        typer.Option(
            "--tolerance-mm",
            help="With --advise: largest displacement of a corner, at any time, that counts as no influence.",
        ),
    ] = 1.0,
    ladder: Annotated[
        bool,
        typer.Option(
            "--ladder", help="Instead: run a ladder of models, from quasi-static motion to all effects."
        ),
    ] = False,
    output: OutputOption = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Show each effect's additions to a scene, its cost, and its influence on the result.

    Effects are toggled separately. An effect of the scene is left out; an effect that the scene lacks is added with
    typical settings. Both simulations run in this process under one solver, and are compared at every tick. The
    solver's own error, measured against a tolerance ten times as fine, shows how much of an influence is significant.
    The range of several rounds shows how much of a cost is.

    All effects; influence on a scene; two effects; advice on effects to leave out or add; cost against fidelity:

      [cyan]mdms effects[/cyan]
      [cyan]mdms effects prototype[/cyan]
      [cyan]mdms effects prototype --only encoder,pwm[/cyan]
      [cyan]mdms effects prototype --advise --tolerance-mm 1[/cyan]
      [cyan]mdms effects ladder --ladder --output study[/cyan]
    """
    from deploy.util.signals import Interruption

    if only is not None and (ladder or output is not None):
        raise InputError(
            f"--only {only}: not with the ladder (--ladder or --output), where each rung adds to those below it"
        )
    if advise and (ladder or output is not None):
        raise InputError("--advise: not with the ladder; leave out --ladder and --output")
    names = None if only is None else _names(only)
    if scene is None:
        given = {"--advise": advise, "--ladder": ladder, "--output": output is not None}
        for option in (option for option, value in given.items() if value):
            raise InputError(f"{option}: which SCENE? (`mdms scenes` lists the bundled ones)")
        _list(names, as_json=as_json)
        return
    if not 0.0 < tolerance_mm < float("inf"):
        raise InputError(f"--tolerance-mm {tolerance_mm:g}: must be greater than 0")
    found = load_scene(scene, sets, seed, duration, solver, tolerance)
    notify = silent if quiet else say
    interruption = Interruption()
    with interruption.handling(last=True), interruption.interruptible():
        from deploy.runs.setup import load_plant, report_warnings

        report_warnings(found, notify)
        load_plant(found, notify)  # whatever the plant refuses in the scene itself is bad input
        if ladder or output is not None:
            with locked_folder(output, notify) as folder:
                _ladder(found, repeats, folder, notify, as_json=as_json)
        else:
            _study(found, names, repeats, tolerance_mm if advise else None, notify, as_json=as_json)


def _names(text: str) -> list[str]:
    """Effects of ``--only``.

    Raises:
        InputError: One is unknown, or there is none.
    """
    from deploy.scenes.errors import nearest
    from deploy.studies.effects.ablation import effect_types

    names = [name for part in text.split(",") if (name := part.strip())]
    if not names:
        raise InputError("--only: must be names of effects, separated by commas (`mdms effects` lists them)")
    for name in names:
        if name not in effect_types():
            raise InputError(f"--only {text}: unknown effect {name}; {nearest(name, effect_types())}")
    return names


def _list(names: list[str] | None, *, as_json: bool) -> None:
    from deploy.studies.effects.report import declared, print_declared

    rows = [row for row in declared() if names is None or row["name"] in names]
    if as_json:
        _print_json({"rows": rows})
    else:
        print_declared(rows)


def _study(
    scene: Scene,
    names: list[str] | None,
    repeats: int,
    tolerance_mm: float | None,
    notify: Callable[[str], None],
    *,
    as_json: bool,
) -> None:
    from deploy.studies.effects.advice import advise
    from deploy.studies.effects.report import advice_json, row_json
    from deploy.studies.effects.study import EffectStudy

    study = EffectStudy(scene, repeats, notify)
    rows = study.rows(names)
    advice = None if tolerance_mm is None else advise(study, rows, 1e-3 * tolerance_mm)
    if as_json:
        found: dict[str, Any] = {
            "scene": scene.name,
            "repeats": repeats,
            "rows": [row_json(row) for row in rows],
        }
        _print_json(found if advice is None else {**found, "advice": advice_json(advice)})
        return
    from deploy.studies.effects.report import print_advice, print_rows

    print_rows(scene, rows, repeats)
    if advice is not None:
        print_advice(advice, rows)


def _ladder(
    scene: Scene, repeats: int, folder: Path | None, notify: Callable[[str], None], *, as_json: bool
) -> None:
    from deploy.studies.effects.ladder import run_ladder, rungs
    from deploy.studies.effects.report import ladder_json

    climbed = run_ladder(rungs(scene), repeats, notify)
    picture = None if folder is None else _draw(scene, climbed, folder)
    if as_json:
        _print_json(
            {
                "scene": scene.name,
                "repeats": repeats,
                "ladder": ladder_json(climbed),
                "picture": picture and str(picture),
            }
        )
        return
    from deploy.studies.effects.report import print_ladder

    print_ladder(scene, climbed)
    if picture:
        print(f"\n{picture}")


def _draw(scene: Scene, climbed: list[RungResult], folder: Path) -> Path:
    from deploy.studies.effects.plot import FILE_NAME, draw_ladder

    picture = folder / FILE_NAME
    draw_ladder(scene, climbed, picture)
    return picture


def _print_json(found: dict[str, Any]) -> None:
    print(json.dumps(found, indent=2, allow_nan=False))
