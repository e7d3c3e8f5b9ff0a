"""``mdms view``: a page for a run in progress or a recording."""

from __future__ import annotations

import signal
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from deploy.commands.completion import scenes
from deploy.commands.options import (
    DurationOption,
    OperatorKeysOption,
    RunningAsOption,
    RunningAtOption,
    SeedOption,
    SetOption,
    load_scene,
    target_of,
)
from deploy.errors import DeployError, InputError
from deploy.util.formatting import say

if TYPE_CHECKING:
    from collections.abc import Callable

    from deploy.control.client import Address
    from deploy.view.source import RunSource

SubjectArgument = Annotated[
    str | None,
    typer.Argument(
        metavar="[SCENE|RECORDING]",
        autocompletion=scenes,
        help="A scene, which is run; or a recording or its folder. Default: the latest run in progress below runs/.",
    ),
]
PortOption = Annotated[int, typer.Option("--port", help="TCP port of the page; 0 selects a free port.")]
BrowserOption = Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in a browser.")]
RealtimeOption = Annotated[
    float, typer.Option("--realtime", metavar="FACTOR", help="Speed of the run at its start, of a scene.")
]


def view(
    subject: SubjectArgument = None,
    *,
    sets: SetOption = None,
    seed: SeedOption = None,
    duration: DurationOption = None,
    realtime: RealtimeOption = 1.0,
    port: PortOption = 0,
    browser: BrowserOption = True,
    connect: RunningAtOption = None,
    run: RunningAsOption = None,
    keys: OperatorKeysOption = None,
) -> None:
    """Show a run in progress or a recording in the browser.

    The page is served on a loopback address of this machine. Ctrl-C ends the page, and the run if this command has
    started it.

    Run a scene and watch it; watch the latest run in progress; replay a recording:

      [cyan]mdms view elliptic[/cyan]
      [cyan]mdms view[/cyan]
      [cyan]mdms view runs/NAME[/cyan]
    """
    if not 0 <= port < 65_536:
        raise InputError(f"--port {port}: must be a number from 0 to 65535")
    from deploy.view.server import PageServer, check_port

    check_port(port)
    source, end, on_open, folder = _open(subject, sets, seed, duration, realtime, connect, run, keys)
    try:
        server = PageServer(source, port, on_open)

        def stop(number: int, frame: object) -> None:
            del number, frame
            server.stop()

        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, stop)
        print(server.url, flush=True)
        say(
            "Ctrl-C ends the page"
            if folder is None
            else f"Ctrl-C ends the page and the run, which writes to {folder}"
        )
        if browser:
            _open_browser(server.url)
        server.run()
    finally:
        end()


def _nothing() -> None:
    """End nothing."""


class Opened(NamedTuple):
    """Subject of the page.

    Attributes:
        source: The run or recording.
        end: Ends what was started for the page.
        on_open: Called when the page is first opened; None: nothing happens then.
        folder: Output folder of the run that was started for the page; None: none was.
    """

    source: RunSource
    end: Callable[[], None] = _nothing
    on_open: Callable[[], None] | None = None
    folder: Path | None = None


def _open(
    subject: str | None,
    sets: list[str] | None,
    seed: int | None,
    duration: float | None,
    realtime: float,
    connect: str | None,
    run: str | None,
    keys: Path | None,
) -> Opened:
    """Return the source of the page, what ends that which was started for it, and what the first viewer sets off."""
    changes = {"--set": sets, "--seed": seed, "--duration": duration}
    given = [name for name, value in changes.items() if value not in (None, [])]
    path = None if subject is None else Path(subject)
    recorded = path is not None and (path.is_dir() or path.suffix == ".mcap")
    if (subject is None or recorded) and given:
        raise InputError(f"{', '.join(given)}: only a scene that is run can be changed")
    if subject is not None and (connect is not None or run is not None):
        raise InputError("--connect and --run name a run in progress: leave out SCENE and RECORDING")
    if path is not None and recorded:
        return Opened(_open_recorded(path, keys))
    if subject is not None:
        return _launch(subject, sets, seed, duration, realtime, keys)
    return Opened(_attach(lambda: target_of(connect, run, keys), keys))


def _open_recorded(path: Path, keys: Path | None) -> RunSource:
    """Return the recording in a folder, or the run that writes there now."""
    from deploy.control.client import discover

    if path.is_dir():
        try:
            discover(path)
        except InputError:
            pass
        else:
            return _attach(lambda: _place(discover(path)), keys)
    from deploy.recordings.reader import load
    from deploy.view.replay import ReplaySource

    recording = load(path)
    if not len(recording.tick):
        raise InputError(f"{recording.path}: the recording has no instant to show")
    return ReplaySource(recording)


def _place(address: Address) -> tuple[str, str]:
    """Return endpoint and name of a run."""
    return address.connect, address.run


def _attach(find: Callable[[], tuple[str, str]], keys: Path | None) -> RunSource:
    """Return the source over a run in progress, once it has begun; ``find`` returns its endpoint and its name."""
    from deploy.live.client import LiveRun, RunWaitsError
    from deploy.view.live import LiveSource

    def connect() -> LiveRun:
        endpoint, name = find()
        return LiveRun(endpoint, keys, run=name)

    said = ""
    while True:
        try:
            return LiveSource(connect)
        except RunWaitsError as error:  # of mdms plant, whose cells are commands of their own
            if str(error) != said:
                said = str(error)
                say(f"{said}; the page begins with the run")


def _launch(
    scene: str,
    sets: list[str] | None,
    seed: int | None,
    duration: float | None,
    realtime: float,
    keys: Path | None,
) -> Opened:
    """Start a run of a scene, paused until it has a viewer."""
    from deploy.runs.output import run_name
    from deploy.util.output_lock import new_folder
    from deploy.view.launch import LaunchedRun

    if not 0 < realtime < float("inf"):
        raise InputError(f"--realtime {realtime:g}: must be greater than 0")
    loaded = load_scene(scene, sets, seed, duration)  # what is wrong with it is said before anything starts
    folder = new_folder(run_name(loaded, time.strftime("%Y%m%d-%H%M%S")))
    arguments = [
        scene,
        "--realtime",
        repr(realtime),
        "--paused",
        "--quiet",
        *(f"--set={text}" for text in sets or ()),
    ]
    arguments += [] if seed is None else ["--seed", str(seed)]
    arguments += [] if duration is None else ["--duration", repr(duration)]
    arguments += [] if keys is None else ["--keys", str(keys)]
    launched = LaunchedRun(arguments, folder)
    try:
        source = _attach(lambda: _place(launched.address()), keys)
        return Opened(source, launched.end, lambda: _resume(source), folder)
    except BaseException:
        launched.end()
        raise


def _resume(source: RunSource) -> None:
    """Let a run that waits for its first viewer go on."""
    try:
        source.request({"op": "resume"})
    except DeployError as error:
        say(f"the run waits, paused: {error}")


def _open_browser(url: str) -> None:
    """Open a page in the person's browser, if there is one."""
    import webbrowser

    webbrowser.open(url)
