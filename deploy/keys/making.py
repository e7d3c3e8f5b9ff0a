"""Making a run's keys."""

from __future__ import annotations

import json
import os
import secrets
import shutil
from collections.abc import Iterable
from datetime import datetime
from pathlib import Path
from typing import Final

from deploy.errors import DeployError, InputError
from deploy.keys.access import access_control
from deploy.keys.folder import ACCESS, AUTHORITY, CERTIFICATE, KEY, KEYS, PASSWORD, USERS, About, Kind
from deploy.keys.roles import PLANT, Cut, Role, roles_of

LOOPBACK: Final = ("127.0.0.1", "::1", "localhost")
"""Names of the plant's host that certificates hold for unasked."""

_HEAD: Final = """\
// What each role may do on the bus of a run: Zenoh's access_control, which the plant's session enforces.
"""
_BYTES: Final = 32
"""Of chance in a password."""


def make(
    folder: Path, scene: str, cut: Cut, kind: Kind, *, hosts: Iterable[str], days: int, force: bool
) -> About:
    """Makes the keys of every process of a run, and of operators.

    The folder appears whole or not at all. What is in it, only its owner can read.

    Args:
        folder: Where; made, mode 0700.
        scene: Name of the scene.
        cut: How its cells are cut into processes.
        kind: How roles are to prove who they are.
        hosts: Names and addresses of the plant's host beside loopback's.
        days: How long certificates hold.
        force: Replace keys that are there.

    Raises:
        InputError: The folder is there already, a host's name is none, or certificates can't be made here.
        DeployError: It can't be written.
    """
    if folder.exists() and not _may_go(folder, force=force):
        raise InputError(_there(folder, force=force))
    roles = roles_of(cut)
    draft = folder.with_name(f".{folder.name}.draft")
    try:
        shutil.rmtree(draft, ignore_errors=True)
        draft.mkdir(mode=0o700, parents=True)
        for role in roles:
            (draft / role.name).mkdir(mode=0o700)
        if kind == "certificate":
            names = (*LOOPBACK, *hosts)
            until = _certificates(draft, roles, names, days)
        else:
            names, until = (), _passwords(draft, roles)
        cells = {role.name: role.cells for role in roles}
        about = About(kind=kind, scene=scene, wire=cut.wire, roles=cells, hosts=names, until=until)
        access = json.dumps(access_control(roles, kind), indent=1)
        _write(draft / ACCESS, f"{_HEAD}{access}\n".encode())
        _write(draft / KEYS, f"{about.model_dump_json(indent=1)}\n".encode())
        if folder.exists():
            shutil.rmtree(folder)
        draft.rename(folder)
    except OSError as error:
        raise DeployError(f"can't write {folder}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(draft, ignore_errors=True)
    return about


def _may_go(folder: Path, *, force: bool) -> bool:
    """Whether nothing is lost with a folder but keys that are to be replaced."""
    if not folder.is_dir():
        return False
    return not any(folder.iterdir()) or (force and (folder / KEYS).is_file())


def _there(folder: Path, *, force: bool) -> str:
    if force:
        return f"{folder}: is not a folder of keys; it is left as it is"
    return f"{folder}: is there already; --force replaces keys, and ends those that are there"


def _certificates(draft: Path, roles: Iterable[Role], hosts: Iterable[str], days: int) -> datetime:
    """Writes each role's; says until when they hold."""
    from deploy.keys.certificates import Authority

    authority = Authority(days)
    for role in roles:
        made = authority.server(PLANT, hosts) if role.name == PLANT else authority.client(role.name)
        _write(draft / role.name / AUTHORITY, authority.certificate)
        _write(draft / role.name / CERTIFICATE, made.certificate)
        _write(draft / role.name / KEY, made.key)
    return authority.until


def _passwords(draft: Path, roles: Iterable[Role]) -> None:
    """Writes each role's, and the plant's list of all: they hold until they are replaced."""
    passwords = {role.name: secrets.token_urlsafe(_BYTES) for role in roles}
    for name, password in passwords.items():
        _write(draft / name / PASSWORD, f"{password}\n".encode())
    users = "".join(f"{name}:{password}\n" for name, password in passwords.items())
    _write(draft / PLANT / USERS, users.encode())


def _write(path: Path, content: bytes) -> None:
    """A new file that its owner alone can read."""
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(handle, "wb") as file:
        file.write(content)
