"""``mdms warm``: compile kernels ahead of the first run."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from typing import Annotated, NamedTuple

import typer

from deploy.commands.completion import scenes
from deploy.commands.options import JsonOption, SetOption, load_scene
from deploy.errors import DeployError, InputError
from deploy.scenes.files import bundled_names
from deploy.scenes.scene import Scene
from deploy.util.formatting import say, silent
from deploy.util.own_python import module_command

_POLL_S = 0.05

ScenesArgument = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[SCENE]...",
        help="Scene files, or names of bundled scenes. Default: all bundled scenes.",
        autocompletion=scenes,
    ),
]
SolverOption = Annotated[
    str | None,
    typer.Option(
        "--solver", metavar="NAME", help="Only scenes with this solver, as bundled or as --set has it."
    ),
]
ProcessesOption = Annotated[
    int | None,
    typer.Option(
        "--processes", metavar="N", help="Compilers side by side, 0.5 GB each. Default: one per processor."
    ),
]


def warm(
    names: ScenesArgument = None,
    *,
    sets: SetOption = None,
    solver: SolverOption = None,
    processes: ProcessesOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compile the kernels that scenes need ahead of their first run.

    A solver's kernels are compiled once for each combination of effects that changes them, and kept in the user's
    cache folder (NUMBA_CACHE_DIR, else ~/.cache). A run compiles missing kernels by itself, which takes up to a
    minute. This command does so before, several scenes side by side. Compiled kernels are only loaded, which takes
    a second a scene. A wheel brings the kernels of the bundled scenes for one version of Python and of numba.

    Everything that the bundled scenes need; one scene with an effect of your own; all scenes of a solver:

      [cyan]mdms warm[/cyan]
      [cyan]mdms warm coulomb --set effects.load_transfer.centre_of_mass_height_m=0.05[/cyan]
      [cyan]mdms warm --solver implicit[/cyan]

    Ctrl-C ends it; what is compiled by then stays.
    """
    if processes is not None and processes < 1:
        raise InputError(f"--processes {processes}: must be 1 or more")
    wanted = names or bundled_names()
    loaded = {name: load_scene(name, sets) for name in dict.fromkeys(wanted)}
    chosen = [name for name, scene in loaded.items() if solver in (None, scene.solver.name)]
    if not chosen:
        raise InputError(f"--solver {solver}: no scene has it")
    started = time.perf_counter()
    if len(chosen) == 1:
        from deploy.runs.compile_ahead import compile_scene

        compiled = {chosen[0]: compile_scene(loaded[chosen[0]], silent if as_json else say)}
    else:
        side_by_side = min(processes or os.cpu_count() or 1, len(chosen))
        alike = {name: _kernels(loaded[name]) for name in chosen}
        compiled = _compile_all(alike, sets or [], side_by_side, silent if as_json else say)
    seconds = time.perf_counter() - started
    if as_json:
        print(json.dumps({"compiled": compiled, "seconds": round(seconds, 3)}))
    else:
        print(f"{sum(compiled.values())} entry points compiled for {len(compiled)} scenes in {seconds:.0f} s")


def _kernels(scene: Scene) -> str:
    """Return a name for the kernels of a scene: two scenes with the same name are not compiled at the same time."""
    effects = scene.plant_spec().effects
    present = [
        name
        for name, value in effects
        if value is not None and value != type(effects).model_fields[name].default
    ]
    return " ".join([scene.solver.name, scene.friction.law, *sorted(present)])


class _Compiler(NamedTuple):
    """Process that compiles for one scene."""

    scene: str
    process: subprocess.Popen[str]


def _compile_all(
    kernels: Mapping[str, str], sets: Sequence[str], side_by_side: int, report: Callable[[str], None]
) -> dict[str, int]:
    """Compile for each scene in a process of its own. Returns how many entry points, by scene.

    Args:
        kernels: which a scene needs; scenes with the same wait for each other.
        sets: values of ``--set``.
        side_by_side: how many processes at a time.
        report: called with each line of progress.
    """
    waiting, running, done = list(kernels), list[_Compiler](), dict[str, int]()
    options = [f"--set={one}" for one in sets]
    try:
        while waiting or running:
            free = [name for name in waiting if kernels[name] not in {kernels[one.scene] for one in running}]
            if free and len(running) < side_by_side:
                waiting.remove(free[0])
                with _interrupted_after():
                    running.append(_start(free[0], options))
            for compiler in [one for one in running if one.process.poll() is not None]:
                running.remove(compiler)
                done[compiler.scene] = count = _result(compiler)
                state = f"{count} entry points compiled" if count else "was compiled"
                rest = ", ".join(one.scene for one in running)
                report(f"{len(done)} of {len(kernels)}: {compiler.scene} {state}{rest and f'; now {rest}'}")
            time.sleep(_POLL_S)
    finally:
        for compiler in running:
            compiler.process.terminate()
        for compiler in running:
            compiler.process.communicate()
    return done


@contextlib.contextmanager
def _interrupted_after() -> Generator[None]:
    """Have Ctrl-C wait for the end of the block: a process that begins in it is known by then."""
    came: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: came.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if came:
            signal.raise_signal(signal.SIGINT)


def _start(name: str, options: Sequence[str]) -> _Compiler:
    command = module_command("deploy.cli", "warm", name, *options, "--json")
    # a session of its own: Ctrl-C is for this process, which ends the others
    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    return _Compiler(name, process)


def _result(compiler: _Compiler) -> int:
    stdout, stderr = compiler.process.communicate()
    if compiler.process.returncode:
        raise DeployError(f"scene {compiler.scene} could not be compiled:\n{stderr.rstrip()}")
    return json.loads(stdout)["compiled"][compiler.scene]
