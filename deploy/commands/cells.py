"""``mdms cells``: the cells of one shard, for a plant that is started elsewhere."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deploy.commands.options import (
    DEFAULT_PORT,
    DurationOption,
    QuietOption,
    SceneArgument,
    SeedOption,
    SetOption,
    SolverOption,
    ToleranceOption,
    load_scene,
)
from deploy.errors import InputError
from deploy.util.formatting import say, silent
from deploy.util.signals import Interrupted, Interruption

if TYPE_CHECKING:
    from bus.lattice import Lattice
    from bus.partition import Partition
    from bus.transports.zenoh import Identity

_SHARD = re.compile(r"(\d{1,9})/(\d{1,9})")
_CELL = re.compile(r"(\d{1,9}),(\d{1,9})")

ShardOption = Annotated[
    str | None,
    typer.Option(
        "--shard",
        metavar="I/N",
        help="Number of the shard, from 0, and number of shards, the plant's --shards.",
    ),
]
CellOption = Annotated[
    str | None,
    typer.Option("--cell", metavar="ROW,COLUMN", help="The one cell of a plant with --shards each."),
]
ConnectOption = Annotated[
    str | None,
    typer.Option(
        "--connect",
        metavar="ENDPOINT",
        help="Endpoint of the plant (its --listen) or of the router. Default: tcp/127.0.0.1:7447, tls with "
        "certificates.",
    ),
]
KeysOption = Annotated[
    Path | None,
    typer.Option(
        "--keys",
        metavar="DIR",
        help="Folder of the run's keys, or of this role's keys alone (cells-2, cell-3-4).",
    ),
]
NameOption = Annotated[
    str | None,
    typer.Option("--run", metavar="NAME", help="Name of the run, as the plant's. Default: the scene's name."),
]


def cells(
    scene: SceneArgument,
    *,
    shard: ShardOption = None,
    cell: CellOption = None,
    connect: ConnectOption = None,
    keys: KeysOption = None,
    run: NameOption = None,
    sets: SetOption = None,
    seed: SeedOption = None,
    duration: DurationOption = None,
    solver: SolverOption = None,
    tolerance: ToleranceOption = None,
    quiet: QuietOption = False,
) -> None:
    """Run the cells of one shard, and join the run of a plant that is started elsewhere (mdms plant).

    Plant and cells may be started in any order, and wait for each other up to stall.start_s (30 s). The scene
    and its --set, --seed and the like must be the plant's: the plant names what differs. The process ends with the
    run. It ends with exit status 1 if the plant has gone or has dropped the cells; started again, it rejoins a
    run that has --respawn.

    The second of two shards; one cell of a plant with --shards each; for a plant on another host:

      [cyan]mdms cells heat --shard 1/2[/cyan]
      [cyan]mdms cells prototype --cell 0,0[/cyan]
      [cyan]mdms cells heat --shard 1/2 --connect tls/10.0.0.5:7447 --keys cells-1[/cyan]
    """
    from deploy.runs.output import default_run
    from deploy.workers.shard_process import ShardProcess, check_name

    made = load_scene(scene, sets, seed, duration, solver, tolerance)
    partition, number = _place(shard, cell, made.lattice())
    name = default_run(made) if run is None else check_name(run)
    identity = None if keys is None else _identity(keys, partition, number, each=cell is not None)
    if connect is None:
        tls = identity is not None and identity.kind == "certificate"
        connect = f"{'tls' if tls else 'tcp'}/127.0.0.1:{DEFAULT_PORT}"
    check_protocol(connect, identity)
    process = ShardProcess(made, partition, number, name, connect, identity, silent if quiet else say)
    interruption = Interruption()
    with interruption.handling(last=True):
        try:
            ended = process.work(interruption)
        except Interrupted as interrupted:
            sys.stderr.write("mdms: interrupted\n")
            raise typer.Exit(interrupted.exit_code) from None
    if not quiet:
        ticks, why = (0, "the run ended before it began") if ended is None else (ended.ticks, ended.detail)
        say(f"{process.name}: ended after {ticks:,} ticks: {why}")


def _place(shard: str | None, cell: str | None, lattice: Lattice) -> tuple[Partition, int]:
    """Return the partition, and the number of the shard in it.

    Raises:
        InputError: Neither or both are given, or there is no such shard or cell.
    """
    from bus.errors import PartitionError
    from bus.partition import Partition

    if (shard is None) == (cell is None):
        raise InputError("mdms cells: name the cells by --shard I/N, such as 0/2, or by --cell ROW,COLUMN")
    if cell is not None:
        match = _CELL.fullmatch(cell)
        place = None if match is None else (int(match[1]), int(match[2]))
        if place is None or place not in lattice:
            raise InputError(f"--cell {cell}: must be row and column of a cell of the scene, such as 0,0")
        return Partition.each(lattice), lattice.index(place)
    match = _SHARD.fullmatch(shard or "")
    if match is None or int(match[1]) >= int(match[2]):
        raise InputError(f"--shard {shard}: must be I/N, I from 0 to N - 1, such as 0/2")
    try:
        return Partition.even(lattice, int(match[2])), int(match[1])
    except PartitionError:
        raise InputError(
            f"--shard {shard}: the scene has {len(lattice)} cells, and as many shards at most"
        ) from None


def _identity(keys: Path, partition: Partition, shard: int, *, each: bool) -> Identity:
    from deploy.security.keyring import cells_identity

    row, column = partition.lattice.cells[int(partition.cells(shard)[0])]
    return cells_identity(keys, f"cell-{row}-{column}" if each else f"cells-{shard}")


def check_protocol(connect: str, identity: Identity | None) -> None:
    """Refuse an endpoint whose protocol doesn't go with the keys.

    Raises:
        InputError: It doesn't, or it is no endpoint.
    """
    if "/" not in connect:
        raise InputError(f"--connect {connect}: must be PROTOCOL/ADDRESS, such as tcp/127.0.0.1:7447")
    if connect.startswith("tls/") != (identity is not None and identity.kind == "certificate"):
        raise InputError(f"--connect {connect}: tls/ goes with certificates (--keys DIR), and only with them")
