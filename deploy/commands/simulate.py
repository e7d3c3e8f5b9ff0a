"""``mdms simulate``: the plant alone."""

from __future__ import annotations

import typer

from deploy.commands.options import (
    DurationOption,
    JsonOption,
    OutputOption,
    SceneArgument,
    SeedOption,
    SetOption,
    SolverOption,
    ToleranceOption,
    load_scene,
)
from deploy.commands.run import PictureOption, QuietOption


def simulate(
    scene: SceneArgument,
    *,
    sets: SetOption = None,
    seed: SeedOption = None,
    duration: DurationOption = None,
    solver: SolverOption = None,
    tolerance: ToleranceOption = None,
    output: OutputOption = None,
    picture: PictureOption = True,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Simulate a scene without cells: wheel speeds straight from its velocity field.

    This is the simulator of the papers: ideal wheels that run at the field's speed from the start. The scene's
    firmware must be velocity_field. Leaves summary.json and overview.png in the output folder.
    """
    import sys

    from deploy.commands.outcome import report
    from deploy.interruption import Interrupted, Interruption
    from deploy.simulate import simulate as simulate_scene

    found = load_scene(scene, sets, seed, duration, solver, tolerance)
    interruption = Interruption()
    with interruption.watching(last=True):
        try:
            outcome = simulate_scene(
                found, output=output, picture=picture, quiet=quiet, interruption=interruption
            )
        except Interrupted as interrupted:
            sys.stderr.write("mdms: interrupted before the simulation began\n")
            raise typer.Exit(interrupted.exit_code) from None
        raise typer.Exit(report(outcome, as_json=as_json))
