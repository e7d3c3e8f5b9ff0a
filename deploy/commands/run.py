"""``mdms run``: the whole system, once."""

from __future__ import annotations

import json
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

import typer

from bus.wire.keys import WireFormat
from deploy.commands.options import EXECUTION_PANEL, RunSceneOptions, expand_dataclass
from deploy.commands.outcome import execute
from deploy.errors import InputError
from deploy.util.formatting import say, silent
from deploy.workers.plan import Plan, Processes, RunOptions, plan

if TYPE_CHECKING:
    from deploy.checkpoints.checkpoint import Checkpoint
    from deploy.runs.summary import Outcome
    from deploy.scenes.scene import Scene
    from deploy.util.output_lock import OutputLock
    from deploy.util.signals import Interruption

ProcessesOption = Annotated[
    str | None,
    typer.Option(
        "--processes",
        rich_help_panel=EXECUTION_PANEL,
        metavar="N|each|0",
        help="Number of worker processes for the cells; each: one per cell; 0: run everything in this process.",
    ),
]
TransportOption = Annotated[
    Literal["zenoh", "memory"],
    typer.Option(
        "--transport",
        rich_help_panel=EXECUTION_PANEL,
        help="Transport of the messages; memory needs --processes 0.",
    ),
]
WireOption = Annotated[
    WireFormat | None,
    typer.Option(
        "--wire",
        rich_help_panel=EXECUTION_PANEL,
        help="packed: one array per worker and border; relayed: one payload per worker each way, messages to "
        "neighbours pass the plant; per_cell: one key per cell and link, for use with any Zenoh tool. Default: that of "
        "--keys; else relayed with several processes; else packed. With --listen or --join packed, and per_cell with "
        "--processes each.",
    ),
]
ListenOption = Annotated[
    str | None,
    typer.Option(
        "--listen",
        rich_help_panel=EXECUTION_PANEL,
        metavar="ENDPOINT",
        help="Endpoint for listeners and operators (mdms fault, mdms registers), such as tcp/127.0.0.1:7447; port 0 "
        "selects a free port. Default: a free loopback port.",
    ),
]
JoinOption = Annotated[
    str | None,
    typer.Option(
        "--join",
        rich_help_panel=EXECUTION_PANEL,
        metavar="ENDPOINT",
        help="Endpoint for processes of cells, such as tls/10.0.0.5:7448 for cells on other hosts. Default: a socket "
        "that only you can open; with --keys a free loopback port.",
    ),
]
KeysOption = Annotated[
    Path | None,
    typer.Option(
        "--keys",
        rich_help_panel=EXECUTION_PANEL,
        metavar="DIR",
        help="Admit only processes with keys from this folder, with their role's permissions. mdms keys makes keys.",
    ),
]
InsecureOption = Annotated[
    bool,
    typer.Option(
        "--insecure",
        rich_help_panel=EXECUTION_PANEL,
        help="Allow endpoints that anybody can use without keys: whoever reaches --join can drive the run.",
    ),
]
RealtimeOption = Annotated[
    float | None,
    typer.Option(
        "--realtime",
        rich_help_panel=EXECUTION_PANEL,
        metavar="[FACTOR]",
        help="Keep pace with the wall clock, or FACTOR times as fast. Default: as fast as possible.",
    ),
]
ClusterOption = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        rich_help_panel=EXECUTION_PANEL,
        metavar="ADDRESS",
        help="Run each of --processes N on its own worker of the Dask cluster with this scheduler, such as "
        "tls://10.0.0.5:8786, or its scheduler file. Workers on other hosts need --join and --keys.",
    ),
]
MessagesOption = Annotated[
    int | None,
    typer.Option(
        "--messages",
        rich_help_panel=EXECUTION_PANEL,
        metavar="[TICKS]",
        help="Record the messages between cells every TICKS ticks (default: every tick), up to 1 GB.",
    ),
]
TraceMessagesOption = Annotated[
    list[str] | None,
    typer.Option(
        "--trace-messages",
        rich_help_panel=EXECUTION_PANEL,
        metavar="[CELLS]",
        help="Trace the messages of these cells (default: all), up to 1 GB: what their programs send and read in every "
        "tick. CELLS: a cell such as 3,4, or a rectangle such as 3,0-3,9; repeat the option for more. The "
        "run is slower then.",
    ),
]
PausedOption = Annotated[
    bool,
    typer.Option(
        "--paused",
        rich_help_panel=EXECUTION_PANEL,
        help="Begin paused; mdms control resume, or a viewer, lets the run go on.",
    ),
]
RegistersOption = Annotated[
    int | None,
    typer.Option(
        "--registers",
        rich_help_panel=EXECUTION_PANEL,
        metavar="[TICKS]",
        help="Record registers every TICKS ticks (default: every tick): variables of the program, registers and "
        "counters of the board.",
    ),
]
ProtocolReportOption = Annotated[
    int | None,
    typer.Option(
        "--protocol-report",
        rich_help_panel=EXECUTION_PANEL,
        metavar="[TICKS]",
        help="Report on the cells' protocol every TICKS ticks (default: every tick): residuals of its field, measured "
        "and theoretical rate, load of the links. Writes a table (protocol.csv) and a plot (protocol.png).",
    ),
]
CheckOption = Annotated[
    Literal["stop", "count"] | None,
    typer.Option(
        "--check",
        rich_help_panel=EXECUTION_PANEL,
        metavar="[stop|count]",
        help="Check the invariants of the cells' program after every tick: stop at the first violation (the default), "
        "or count violations. A run with a violation fails.",
    ),
]
RespawnOption = Annotated[
    int,
    typer.Option(
        "--respawn",
        rich_help_panel=EXECUTION_PANEL,
        metavar="N",
        help="Restart worker processes that ended or fell silent, at most N times in total. Their cells rejoin at a "
        "tick boundary and start as after power-on.",
    ),
]
ReplayOption = Annotated[
    Path | None,
    typer.Option(
        "--replay",
        rich_help_panel=EXECUTION_PANEL,
        metavar="DIR",
        help="Replay a recorded run of this scene: inject its live faults at their ticks, and crash every cell that "
        "the run lost. Reports whether the digests agree.",
    ),
]
CheckpointOption = Annotated[
    float | None,
    typer.Option(
        "--checkpoint",
        rich_help_panel=EXECUTION_PANEL,
        metavar="SECONDS",
        help="Write a checkpoint to the output folder every SECONDS of wall time. Default: no checkpoints.",
    ),
]
ResumeOption = Annotated[
    Path | None,
    typer.Option(
        "--resume",
        rich_help_panel=EXECUTION_PANEL,
        metavar="DIR",
        help="Resume the run with this output folder from its last checkpoint, to the digest of an uninterrupted run. "
        "Scene, processes and similar options come from the checkpoint.",
    ),
]
PlanOption = Annotated[
    bool,
    typer.Option(
        "--plan", rich_help_panel=EXECUTION_PANEL, help="Print the processes that would be started, and exit."
    ),
]


@expand_dataclass
def run(
    scene_options: RunSceneOptions,
    *,
    processes: ProcessesOption = None,
    transport: TransportOption = "zenoh",
    wire: WireOption = None,
    listen: ListenOption = None,
    join: JoinOption = None,
    keys: KeysOption = None,
    insecure: InsecureOption = False,
    cluster: ClusterOption = None,
    realtime: RealtimeOption = None,
    paused: PausedOption = False,
    registers: RegistersOption = None,
    messages: MessagesOption = None,
    trace_messages: TraceMessagesOption = None,
    protocol_report: ProtocolReportOption = None,
    check: CheckOption = None,
    respawn: RespawnOption = 0,
    replay: ReplayOption = None,
    checkpoint: CheckpointOption = None,
    resume: ResumeOption = None,
    show_plan: PlanOption = False,
) -> None:
    """Run a scene as a whole system: cells with their firmware, the plant, and messages between them.

    Writes recording.mcap, summary.json and overview.png to the output folder. Ctrl-C ends the run early; the
    recording is complete up to that time.

    One process per cell; twelve seconds in real time; a cell that crashes:

      [cyan]mdms run prototype --processes each[/cyan]
      [cyan]mdms run elliptic --duration 12 --realtime[/cyan]
      [cyan]mdms run elliptic --set 'faults=[{ at_s = 1, cell = [9, 9] }]'[/cyan]

    Compare a protocol's convergence with theory:

      [cyan]mdms run heat --protocol-report[/cyan]

    Write a checkpoint every 10 s, then resume after an interruption:

      [cyan]mdms run large --checkpoint 10 --output big[/cyan]
      [cyan]mdms run --resume big[/cyan]
    """
    options = RunOptions(
        processes=parse_processes(processes),
        transport=transport,
        wire=wire,
        listen=listen,
        join=join,
        keys=keys,
        insecure=insecure,
        external=cluster is not None,
        cluster=cluster,
        realtime=realtime,
        paused=paused,
        output=scene_options.output,
        picture=scene_options.picture,
        registers=registers,
        messages=messages,
        trace_messages=None if not trace_messages else " ".join(trace_messages),
        protocol_report=protocol_report,
        check=check,
        respawn=respawn,
        replay=replay,
        checkpoint_s=checkpoint,
    )
    with ExitStack() as held:
        started = prepare(scene_options, options, resume, held, read_only=show_plan)
        if show_plan:
            print_plan(plan(started.scene, started.options, "RUN"), as_json=scene_options.as_json)
            return

        work = partial(started.run, quiet=scene_options.quiet)
        execute("the run", work, as_json=scene_options.as_json)


class PreparedRun(NamedTuple):
    """A run to execute.

    Attributes:
        scene: Scene of the run.
        options: Options of the run; those of the checkpoint where it resumes.
        checkpoint: Checkpoint to resume from; None: the run begins at time 0.
        lock: Lock of the output folder; None: the run takes it.
    """

    scene: Scene
    options: RunOptions
    checkpoint: Checkpoint | None
    lock: OutputLock | None

    def named(self, name: str) -> PreparedRun:
        """Return the same run with a name on the bus."""
        return self._replace(options=replace(self.options, name=name))

    def run(self, interruption: Interruption, *, quiet: bool) -> Outcome:
        """Execute the run until its end, or until it is interrupted."""
        from deploy.runs.run import run

        return run(
            self.scene,
            self.options,
            quiet=quiet,
            interruption=interruption,
            resumed=self.checkpoint,
            lock=self.lock,
        )


def prepare(
    scene_options: RunSceneOptions,
    options: RunOptions,
    resume: Path | None,
    held: ExitStack,
    *,
    read_only: bool,
    command: str = "mdms run",
) -> PreparedRun:
    """Load the scene of a new run, or the checkpoint of a resumed one.

    Args:
        scene_options: Scene, and options of its output.
        options: Options of the run.
        resume: Output folder of the run to resume; None: the run is new.
        held: Releases the lock of that folder.
        read_only: Whether the folder is only read, which needs no lock.
        command: The command, for messages.

    Raises:
        InputError: No scene is named, the scene is refused, or the run can't be resumed.
    """
    if resume is None:
        if not scene_options.scene:
            raise InputError(f"{command}: name a SCENE, or a run to resume: --resume DIR")
        return PreparedRun(scene_options.load(), options, None, None)
    check_unchanged(resume, scene_options)
    lock = None if read_only else held.enter_context(lock_of(resume, quiet=scene_options.quiet))
    return PreparedRun(*taken_up(resume, options), lock)


def check_unchanged(folder: Path, scene_options: RunSceneOptions) -> None:
    """Refuse options that would change a resumed run.

    Raises:
        InputError: Names the options.
    """
    if scene_options.changes:
        given = ", ".join(scene_options.changes)
        raise InputError(f"--resume {folder}: a resumed run keeps its scene and folder: leave out {given}")


def lock_of(folder: Path, *, quiet: bool) -> OutputLock:
    """Lock the folder of a run before its checkpoint is read: until then another process may write there.

    Raises:
        InputError: There is no such folder, or another process is writing there.
    """
    from deploy.util.output_lock import OutputLock

    if not folder.is_dir():
        raise InputError(f"--resume {folder}: there is no such folder")
    return OutputLock(folder, silent if quiet else say, named="--resume")


def taken_up(folder: Path, options: RunOptions) -> tuple[Scene, RunOptions, Checkpoint]:
    """The run in a folder, to go on with it.

    Raises:
        InputError: It can't be taken up, or not like this.
    """
    from deploy.checkpoints.store import find_checkpoint, options_of, scene_of

    checkpoint = find_checkpoint(folder)
    return scene_of(checkpoint), replace(options_of(checkpoint, options), output=folder), checkpoint


def parse_processes(text: str | None) -> Processes | None:
    """The value of ``--processes``.

    Raises:
        InputError: Neither ``each`` nor a number of processes.
    """
    if text is None or text == "each":
        return text
    if text.isascii() and text.isdigit():
        return int(text)
    raise InputError(f"--processes {text}: must be each, or a number of processes from 0")


def print_plan(made: Plan, *, as_json: bool) -> None:
    """Print the processes that would be started."""
    if as_json:
        print(json.dumps(made.as_json(), indent=2))
        return
    from rich.console import Console
    from rich.table import Table

    console = Console(highlight=False)
    plant, first = made.processes[0], made.processes[1]
    console.print(f"[bold]{made.scene}[/bold]  {made.transport}, wire format {made.wire}")
    table = Table.grid(padding=(0, 2))
    for process in made.processes:
        table.add_row(f"[cyan]{process.name}[/cyan]", process.where, _span(process.cells))
    console.print(table)
    if plant.listen is not None:
        console.print(f"Cells join the plant at {plant.join}.", soft_wrap=True)
        console.print(f"Listeners and operators connect to {plant.listen}.", soft_wrap=True)
    console.print(f"Cells are ready when: {first.ready}.", soft_wrap=True)
    console.print(f"The run begins when: {plant.ready}.", soft_wrap=True)


def _span(cells: tuple[tuple[int, int], ...]) -> str:
    """``18: 0,0 to 5,4``."""
    if not cells:
        return ""
    first, last = (f"{row},{column}" for row, column in (cells[0], cells[-1]))
    return first if len(cells) == 1 else f"{len(cells):,}: {first} to {last}"
