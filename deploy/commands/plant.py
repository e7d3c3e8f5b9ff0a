"""``mdms plant``: the plant of a run whose cells are started elsewhere."""

from __future__ import annotations

from contextlib import ExitStack
from functools import partial
from typing import Annotated

import typer

from deploy.commands.options import EXECUTION_PANEL, RunSceneOptions, default_endpoint, expand_dataclass
from deploy.commands.outcome import execute
from deploy.commands.run import (
    CheckOption,
    CheckpointOption,
    InsecureOption,
    KeysOption,
    MessagesOption,
    PausedOption,
    ProtocolReportOption,
    RealtimeOption,
    RegistersOption,
    ResumeOption,
    TraceMessagesOption,
    WireOption,
    parse_processes,
    prepare,
)
from deploy.errors import InputError
from deploy.runs.output import default_run
from deploy.workers.plan import Processes, RunOptions
from deploy.workers.shard_process import check_name

ShardsOption = Annotated[
    str,
    typer.Option(
        "--shards",
        rich_help_panel=EXECUTION_PANEL,
        metavar="N|each",
        help="Number of processes of cells that join: neighbouring rows together; each: one per cell.",
    ),
]
ListenOption = Annotated[
    str | None,
    typer.Option(
        "--listen",
        rich_help_panel=EXECUTION_PANEL,
        metavar="ENDPOINT",
        help="Endpoint at which cells join and operators connect, such as tls/10.0.0.5:7447; port 0 selects a free "
        "port. Beyond loopback with --keys only. Default: tcp/127.0.0.1:7447, tls with certificates.",
    ),
]
ConnectOption = Annotated[
    str | None,
    typer.Option(
        "--connect",
        rich_help_panel=EXECUTION_PANEL,
        metavar="ENDPOINT",
        help="Router (mdms router) that carries all messages, in place of --listen.",
    ),
]
NameOption = Annotated[
    str | None,
    typer.Option(
        "--run",
        rich_help_panel=EXECUTION_PANEL,
        metavar="NAME",
        help="Name of the run, the same for plant and cells. Default: the scene's name.",
    ),
]
RespawnOption = Annotated[
    int,
    typer.Option(
        "--respawn",
        rich_help_panel=EXECUTION_PANEL,
        metavar="N",
        help="Let cells of lost processes rejoin, N times in total: start the same mdms cells again. They begin as "
        "after power-on, at a tick boundary.",
    ),
]


@expand_dataclass
def plant(
    scene_options: RunSceneOptions,
    *,
    shards: ShardsOption = "1",
    listen: ListenOption = None,
    connect: ConnectOption = None,
    keys: KeysOption = None,
    run: NameOption = None,
    wire: WireOption = None,
    insecure: InsecureOption = False,
    realtime: RealtimeOption = None,
    paused: PausedOption = False,
    registers: RegistersOption = None,
    messages: MessagesOption = None,
    trace_messages: TraceMessagesOption = None,
    protocol_report: ProtocolReportOption = None,
    check: CheckOption = None,
    respawn: RespawnOption = 0,
    checkpoint: CheckpointOption = None,
    resume: ResumeOption = None,
) -> None:
    """Run the plant of a scene, and wait for cells that are started elsewhere: by hand, on other hosts, in containers.

    Plant and cells may be started in any order, and wait for each other up to stall.start_s (30 s). Then the plant
    names the missing cells and ends. It admits cells with the same scene, versions, processor level and program
    only, and names what differs. The rest is as of mdms run: the recording, the digest, the exit status.

    A plant and two processes of cells, each in a terminal; then who is here, from another:

      [cyan]mdms plant heat --shards 2[/cyan]
      [cyan]mdms cells heat --shard 0/2[/cyan]
      [cyan]mdms cells heat --shard 1/2[/cyan]
      [cyan]mdms status[/cyan]

    For people who need more than 30 s; on the cells as well:

      [cyan]mdms plant heat --shards 2 --set stall.start_s=600[/cyan]

    From another host, with keys:

      [cyan]mdms keys secret heat --processes 2 --host 10.0.0.5[/cyan]
      [cyan]mdms plant heat --shards 2 --listen tls/10.0.0.5:7447 --keys secret[/cyan]
      [cyan]mdms cells heat --shard 0/2 --connect tls/10.0.0.5:7447 --keys cells-0[/cyan]
    """
    if listen is not None and connect is not None:
        raise InputError("--listen and --connect: give one of the two")
    options = RunOptions(
        processes=None if resume is not None and shards == "1" else parse_shards(shards),
        wire=wire,
        join=(listen or default_endpoint(keys)) if connect is None else None,
        router=connect,
        external=True,
        name=None if run is None else check_name(run),
        keys=keys,
        insecure=insecure,
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
        checkpoint_s=checkpoint,
    )
    with ExitStack() as held:
        started = prepare(scene_options, options, resume, held, read_only=False, command="mdms plant")
        if started.options.name is None:
            started = started.named(default_run(started.scene))
        work = partial(started.run, quiet=scene_options.quiet)
        execute("the run", work, as_json=scene_options.as_json)


def parse_shards(text: str) -> Processes:
    """The value of ``--shards``.

    Raises:
        InputError: Neither ``each`` nor a number of processes.
    """
    try:
        found = parse_processes(text)
    except InputError:
        found = 0
    if not found:
        raise InputError(f"--shards {text}: must be each, or a number of processes from 1")
    return found
