"""``mdms keys``: certificates and permissions of a run's processes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from bus.wire.keys import WireFormat
from deploy.commands.options import JsonOption, SceneArgument, SetOption, load_scene
from deploy.commands.run import ProcessesOption, parse_processes
from deploy.errors import InputError
from deploy.workers.plan import RunOptions, plan

if TYPE_CHECKING:
    from deploy.security.manifest import KeyManifest

_MOST_DAYS = 3650
_ROLES = 8
"""Roles listed one by one; of more, the first and the last."""

FolderArgument = Annotated[Path, typer.Argument(metavar="DIR", help="New folder for the keys.")]
WireOption = Annotated[
    WireFormat | None,
    typer.Option("--wire", help="Wire format of the runs. Default: as for mdms run."),
]
HostOption = Annotated[
    list[str] | None,
    typer.Option(
        "--host",
        metavar="NAME",
        help="Name or address of the plant's host, in addition to loopback. Repeatable.",
    ),
]
DaysOption = Annotated[int, typer.Option("--days", metavar="N", help="Validity of the certificates, days.")]
PasswordsOption = Annotated[
    bool,
    typer.Option(
        "--passwords", help="Users and passwords instead of certificates; messages are not encrypted."
    ),
]
ForceOption = Annotated[bool, typer.Option("--force", help="Replace existing keys.")]


def keys(
    folder: FolderArgument,
    scene: SceneArgument,
    *,
    sets: SetOption = None,
    processes: ProcessesOption = None,
    wire: WireOption = None,
    host: HostOption = None,
    days: DaysOption = 30,
    passwords: PasswordsOption = False,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Make the keys of a scene's runs: a certificate for the plant, for each process of cells and for operators.

    Only processes with keys can join a run, and each role has its own permissions: a process of cells publishes only
    drives and messages of its own cells, and reads only their senses and their neighbours' messages; only the plant
    publishes senses and control records; only operators send live commands. The signing key is discarded at once, so
    that no more certificates can be made.

    Keys are valid for one division of the cells into processes:

      [cyan]mdms keys secret prototype --processes each[/cyan]
      [cyan]mdms run prototype --processes each --keys secret --listen tls/127.0.0.1:7447[/cyan]
      [cyan]mdms registers 0,0 --connect tls/127.0.0.1:7447 --keys secret[/cyan]
    """
    if not 1 <= days <= _MOST_DAYS:
        raise InputError(f"--days {days}: must be 1..{_MOST_DAYS}")
    if passwords and host:
        raise InputError("--host: is for certificates; leave it out with --passwords, which name no host")
    made = plan(load_scene(scene, sets), RunOptions(processes=parse_processes(processes), wire=wire), "RUN")
    from deploy.security.generate import generate_keys

    kind: Literal["certificate", "password"] = "password" if passwords else "certificate"
    about = generate_keys(folder, made.scene, made.cut, kind, hosts=host or (), days=days, force=force)
    how = "" if processes is None else f" --processes {processes}"
    how += "" if wire is None else f" --wire {wire}"
    if as_json:
        print(json.dumps({"folder": str(folder), **about.model_dump(mode="json")}))
    else:
        _print(folder, about, how)


def _print(folder: Path, about: KeyManifest, how: str) -> None:
    """The roles, where their keys are, until when they hold, and how the run is to be started."""
    from rich.console import Console
    from rich.table import Table

    from deploy.security.manifest import ACCESS
    from deploy.util.formatting import plural

    console = Console(highlight=False)
    cells = sum(map(len, about.roles.values()))
    console.print(f"[bold]{about.scene}[/bold]  {plural(cells, 'cell')}, wire format {about.wire}")
    table = Table.grid(padding=(0, 2))
    roles = list(about.roles)
    shown = roles if len(roles) <= _ROLES else [*roles[:3], "...", *roles[-2:]]
    for role in shown:
        where = "" if role == "..." else str(folder / role)
        own = about.roles.get(role, ())
        table.add_row(f"[cyan]{role}[/cyan]", plural(len(own), "cell") if own else "", where)
    console.print(table)
    console.print(f"Permissions of the roles: {folder / ACCESS}", soft_wrap=True)
    if about.until is not None:
        until, hosts = f"{about.until:%Y-%m-%d %H:%M} UTC", ", ".join(about.hosts)
        console.print(f"Certificates are valid until {until}, the plant's for {hosts}.", soft_wrap=True)
    console.print(f"Run with: mdms run {about.scene}{how} --keys {folder}", soft_wrap=True)
