"""Options that several commands share, each defined once."""

from __future__ import annotations

import functools
import inspect
import math
import socket
from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields
from inspect import Parameter, Signature
from pathlib import Path
from typing import Annotated, Any, Final, final, get_type_hints

import typer

from deploy.commands.completion import scene_keys, scenes
from deploy.errors import InputError
from deploy.scenes.files import load_scene as load
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene

DEFAULT_PORT: Final = 7447
"""Port at which a plant and a router listen by default."""
EXECUTION_PANEL: Final = "Execution"
"""Heading of options that don't change the simulated system."""

_SCENE: Final = "A scene file, or the name of a bundled scene."

SceneArgument = Annotated[str, typer.Argument(metavar="SCENE", help=_SCENE, autocompletion=scenes)]
SceneUnlessArgument = Annotated[
    str | None, typer.Argument(metavar="SCENE", help=_SCENE, autocompletion=scenes)
]
"""Optional scene, for commands with a mode without a scene."""
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        autocompletion=scene_keys,
        help="Set any value of the scene: KEY is a dotted path (list items by number), VALUE is TOML. Repeatable.",
    ),
]
SeedOption = Annotated[int | None, typer.Option("--seed", help="Seed; replaces the scene's seed.")]
DurationOption = Annotated[
    float | None,
    typer.Option("--duration", metavar="SECONDS", help="Simulated time; replaces the scene's duration_s."),
]
SolverOption = Annotated[
    str | None,
    typer.Option(
        "--solver",
        metavar="NAME",
        help="Solver; replaces the scene's solver.name: exact, implicit, quasi_static, fixed_step, scipy or heyoka. "
        "Settings of the scene's solver that NAME doesn't have are left out.",
    ),
]
ToleranceOption = Annotated[
    float | None,
    typer.Option("--tolerance", metavar="METRES", help="Tolerance; replaces the scene's solver.tolerance."),
]
StepOption = Annotated[
    float | None,
    typer.Option(
        "--step", metavar="SECONDS", help="Step; replaces solver.step_s of a solver that has steps."
    ),
]
OutputOption = Annotated[
    Path | None, typer.Option("--output", metavar="DIR", help="Folder for all files of the run.")
]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print one JSON object on stdout, and everything else on stderr.")
]
OperatorKeysOption = Annotated[
    Path | None,
    typer.Option(
        "--keys",
        metavar="DIR",
        help="Folder of the run's keys, or of the operator's keys, for a run that was started with --keys.",
    ),
]
RunningAtOption = Annotated[
    str | None,
    typer.Option(
        "--connect",
        metavar="ENDPOINT",
        help="Endpoint at which the run's plant listens (--listen of the run). Default: found by --run.",
    ),
]
RunningAsOption = Annotated[
    str | None,
    typer.Option(
        "--run",
        metavar="DIR|NAME",
        help="Output folder of the run; with --connect, or at the default endpoint of mdms plant, the run's name, "
        "where a router carries several. Default: the latest run below runs/ that has not ended, or else the only "
        "one at that endpoint.",
    ),
]


def _waited(timeout: float) -> float:
    """Return a valid value of ``--timeout``."""
    if not 0 < timeout < float("inf"):
        raise InputError(f"--timeout {timeout:g}: must be greater than 0")
    return timeout


TimeoutOption = Annotated[
    float,
    typer.Option(
        "--timeout", metavar="SECONDS", help="Longest wait for an answer, wall time.", callback=_waited
    ),
]
PictureOption = Annotated[bool, typer.Option("--picture/--no-picture", help="Draw overview.png at the end.")]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no warnings on stderr.")]


@dataclass(frozen=True, slots=True)
class SceneOptions:
    """Options common to ``run`` and ``simulate``, an option a field."""

    scene: SceneArgument
    sets: SetOption = None
    seed: SeedOption = None
    duration: DurationOption = None
    solver: SolverOption = None
    tolerance: ToleranceOption = None
    output: OutputOption = None
    picture: PictureOption = True
    as_json: JsonOption = False
    quiet: QuietOption = False

    def load(self, *, step: float | None = None) -> Scene:
        """The requested scene; see `load_scene`."""
        return load_scene(self.scene, self.sets, self.seed, self.duration, self.solver, self.tolerance, step)


@final
@dataclass(frozen=True, slots=True)
class RunSceneOptions(SceneOptions):
    """Options of ``run``, in which a resumed run can provide the scene."""

    scene: Annotated[str, typer.Argument(metavar="[SCENE]", help=_SCENE, autocompletion=scenes)] = ""

    @property
    def changes(self) -> dict[str, object]:
        """Given options, by name, that are allowed only for a run from its beginning."""
        given = {
            "SCENE": self.scene,
            "--set": self.sets,
            "--seed": self.seed,
            "--duration": self.duration,
            "--solver": self.solver,
            "--tolerance": self.tolerance,
            "--output": self.output,
        }
        return {name: value for name, value in given.items() if value not in (None, "", [])}


def load_scene(
    scene: str,
    sets: list[str] | None = None,
    seed: int | None = None,
    duration: float | None = None,
    solver: str | None = None,
    tolerance: float | None = None,
    step: float | None = None,
) -> Scene:
    """Load a scene and apply the options, validated together.

    Args:
        scene: A scene file, or the name of a bundled scene.
        sets: ``KEY=VALUE`` of every ``--set``, in the order given.
        seed: Value of ``--seed``.
        duration: Value of ``--duration``, s.
        solver: Value of ``--solver``.
        tolerance: Value of ``--tolerance``, m.
        step: Value of ``--step``, s.

    Raises:
        InputError: What is wrong, all of it at once, one line each.
    """
    overrides = [Override.parse(text) for text in sets or ()]
    shorthands = (
        ("--seed", ("seed",), seed),
        ("--duration", ("duration_s",), duration),
        ("--solver", ("solver", "name"), solver),
        ("--tolerance", ("solver", "tolerance"), tolerance),
        ("--step", ("solver", "step_s"), step),
    )
    for option, path, value in shorthands:
        if value is not None:
            overrides.append(Override(path, value, f"{option} {value}"))
    return load(scene, overrides)


def target_of(connect: str | None, run: str | None, keys: Path | None = None) -> tuple[str, str]:
    """Return endpoint and name of the running system that a command is to speak to.

    Without ``--connect`` it is a run that writes on this host, or else whoever listens where ``mdms plant`` and
    ``mdms router`` do by default.

    Args:
        connect: Value of ``--connect``.
        run: Value of ``--run``: a name if there is an endpoint, else a folder, or the name of a run at the default
            endpoint.
        keys: Value of ``--keys``.

    Raises:
        InputError: The name can't be one, or no run goes on there.
    """
    from bus.errors import RunNameError
    from bus.wire.keys import check_run
    from deploy.control.client import ANY_RUN, discover

    if connect is None:
        try:
            found = discover(None if run is None else Path(run))
        except InputError as error:
            connect = default_endpoint(keys, role="operator")
            if run is not None and Path(run).exists():
                raise
            if not _listens(connect):
                raise InputError(f"{error}; and nobody listens at {connect}") from None
        else:
            return found.connect, found.run
    try:
        return connect, ANY_RUN if run is None else check_run(run)
    except RunNameError as error:
        raise InputError(f"--run: with --connect it is the name of a run: {error}") from None


def default_endpoint(keys: Path | None, *, role: str | None = None) -> str:
    """Return the endpoint on loopback at which a plant or a router listens unless another is named.

    Args:
        keys: Folder of the run's keys, or of a role's.
        role: Role whose folder it may be; None: it must be the run's.

    Raises:
        InputError: The folder has no keys.
    """
    protocol = "tcp"
    if keys is not None:
        from deploy.security.keyring import kind_of

        protocol = "tls" if kind_of(keys, role) == "certificate" else "tcp"
    return f"{protocol}/127.0.0.1:{DEFAULT_PORT}"


def _listens(endpoint: str) -> bool:
    """Whether anybody listens at a TCP endpoint of this host."""
    host, _, port = endpoint.partition("/")[2].rpartition(":")
    with socket.socket() as probe:
        probe.settimeout(1.0)
        return probe.connect_ex((host, int(port))) == 0


ParcelOption = Annotated[int, typer.Option("--parcel", metavar="N", help="Number of the parcel, from 0.")]


def check_parcel(scene: Scene, parcel: int) -> None:
    """Refuse a parcel that the scene doesn't have.

    Raises:
        InputError: It doesn't.
    """
    if not 0 <= parcel < len(scene.parcels):
        has = f"parcels 0..{len(scene.parcels) - 1}" if scene.parcels else "no parcels"
        raise InputError(f"scene {scene.name}: --parcel {parcel}: the scene has {has}")


def numbers(option: str, text: str, form: str) -> list[float]:
    """The value of an option that is several numbers.

    Args:
        option: Its name.
        text: Its value.
        form: What it should be, such as ``X,Y``: as many numbers as this has parts between commas.

    Raises:
        InputError: It is something else.
    """
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        found = []
    if len(found) != len(form.split(",")) or not all(math.isfinite(number) for number in found):
        raise InputError(f"{option} {text}: must be {form}, numbers")
    return found


def expand_dataclass(command: Callable[..., None]) -> Callable[..., None]:
    """Return the command with its first parameter, a dataclass of options, expanded to one parameter a field.

    Args:
        command: Takes an instance of a dataclass with typer's annotations, and options of its own by keyword.
    """
    hints = get_type_hints(command, include_extras=True)
    first, *own = inspect.signature(command).parameters.values()
    options: type[Any] = hints[first.name]
    shared = get_type_hints(options, include_extras=True)
    parameters = [
        Parameter(
            field.name,
            Parameter.KEYWORD_ONLY,
            default=Parameter.empty if field.default is MISSING else field.default,
            annotation=shared[field.name],
        )
        for field in fields(options)
    ] + [parameter.replace(annotation=hints[parameter.name]) for parameter in own]

    @functools.wraps(command)
    def called(**given: Any) -> None:
        chosen = {field.name: given.pop(field.name) for field in fields(options)}
        command(options(**chosen), **given)

    called.__signature__ = Signature(parameters)  # pyright: ignore[reportAttributeAccessIssue]
    called.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return called
