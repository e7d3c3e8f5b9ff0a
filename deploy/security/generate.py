"""Generation of a run's keys."""

from __future__ import annotations

import json
import os
import secrets
import shutil
from collections.abc import Callable, Generator, Iterable
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import Final

from deploy.errors import DeployError, InputError
from deploy.security.manifest import (
    ACCESS,
    AUTHORITY,
    CERTIFICATE,
    KEY,
    KEYS,
    PASSWORD,
    USERS,
    KeyManifest,
    Kind,
)
from deploy.security.policy import access_control
from deploy.security.roles import PLANT, ROUTER, ProcessLayout, Role, roles_of
from deploy.util.formatting import say
from deploy.util.output_lock import OutputLock

LOOPBACK: Final = ("127.0.0.1", "::1", "localhost")
"""Names of the plant's and the router's host that every server certificate includes."""

_HEAD: Final = """\
// What each role may do on the bus of a run: Zenoh's access_control, which the plant's session enforces.
"""
_BYTES: Final = 32
"""Random bytes of a password."""


def generate_keys(
    folder: Path,
    scene: str,
    cut: ProcessLayout,
    kind: Kind,
    *,
    hosts: Iterable[str],
    days: int,
    force: bool,
    warn: Callable[[str], None] = say,
) -> KeyManifest:
    """Generate the keys of every process of a run, and of operators.

    The folder appears whole or not at all. Only its owner can read the files.

    Args:
        folder: Folder to make, mode 0700.
        scene: Name of the scene.
        cut: Layout of the scene's cells in processes.
        kind: Kind of credentials of the roles.
        hosts: Names and addresses of the plant's host and of the router's, besides loopback.
        days: Validity of certificates, days.
        force: Replace existing keys.
        warn: Called with one line if files can't be locked there.

    Raises:
        InputError: The folder is there already or is the working one, another process makes it at this time, a host's
            name is none, or certificates can't be made here.
        DeployError: It can't be written.
    """
    if folder.resolve() == Path.cwd():
        raise InputError(
            f"mdms keys: DIR must name a folder to be made, not {str(folder)!r}, the working one"
        )
    if folder.exists() and not _may_go(folder, force=force):
        raise InputError(_there(folder, force=force))
    names = (*LOOPBACK, *hosts) if kind == "certificate" else ()
    try:
        with _draft(folder, warn) as draft:
            about = _fill(draft, scene, cut, kind, names, days)
            if folder.exists():
                if not _may_go(folder, force=force):  # another process has made it since
                    raise InputError(_there(folder, force=force))
                shutil.rmtree(folder)
            draft.rename(folder)
    except OSError as error:
        raise DeployError(f"can't write {folder}: {error.strerror or error}") from error
    return about


@contextmanager
def _draft(folder: Path, warn: Callable[[str], None]) -> Generator[Path]:
    """Make a draft folder beside ``folder``, locked against other processes that generate keys there.

    Raises:
        InputError: Another process holds the lock.
        OSError: It can't be made.
    """
    place = folder.with_name(f".{folder.name}.draft")
    while True:
        place.mkdir(mode=0o700, parents=True, exist_ok=True)
        try:
            lock = OutputLock(place, warn, named="mdms keys: draft")
        except InputError:
            if place.is_dir():
                raise
        else:
            break  # else the holder before removed it just now
    draft = place / "keys"
    try:
        with lock:
            try:
                shutil.rmtree(draft, ignore_errors=True)  # of a process that was killed
                draft.mkdir(mode=0o700)
                yield draft
            finally:
                shutil.rmtree(draft, ignore_errors=True)
    finally:
        with suppress(OSError):  # the next process has come already
            place.rmdir()


def _fill(
    draft: Path, scene: str, cut: ProcessLayout, kind: Kind, names: tuple[str, ...], days: int
) -> KeyManifest:
    """Write the keys of every role, the access control and the manifest."""
    roles = roles_of(cut)
    for name in (*(role.name for role in roles), ROUTER):
        (draft / name).mkdir(mode=0o700)
    until = _certificates(draft, roles, names, days) if kind == "certificate" else _passwords(draft, roles)
    cells = {role.name: role.cells for role in roles}
    about = KeyManifest(kind=kind, scene=scene, wire=cut.wire, roles=cells, hosts=names, until=until)
    access = json.dumps(access_control(roles, kind), indent=1)
    _write(draft / ACCESS, f"{_HEAD}{access}\n".encode())
    _write(draft / KEYS, f"{about.model_dump_json(indent=1)}\n".encode())
    return about


def _may_go(folder: Path, *, force: bool) -> bool:
    """Whether a folder is empty, or has keys to be replaced."""
    if not folder.is_dir():
        return False
    return not any(folder.iterdir()) or (force and (folder / KEYS).is_file())


def _there(folder: Path, *, force: bool) -> str:
    if force:
        return f"{folder}: is not a folder of keys; it is left as it is"
    return f"{folder}: is there already; --force replaces keys, and ends those that are there"


def _certificates(draft: Path, roles: Iterable[Role], hosts: Iterable[str], days: int) -> datetime:
    """Write the certificates of every role; return the end of their validity."""
    from deploy.security.certificates import Authority

    authority = Authority(days)
    made = {role.name: authority.client(role.name) for role in roles if role.name != PLANT}
    made[PLANT] = authority.server(PLANT, hosts, connects=True)
    made[ROUTER] = authority.server(ROUTER, hosts)
    for name, pair in made.items():
        _write(draft / name / AUTHORITY, authority.certificate)
        _write(draft / name / CERTIFICATE, pair.certificate)
        _write(draft / name / KEY, pair.key)
    return authority.until


def _passwords(draft: Path, roles: Iterable[Role]) -> None:
    """Write the password of every role, and the list of users for plant and router; passwords don't expire."""
    passwords = {name: secrets.token_urlsafe(_BYTES) for name in (*(role.name for role in roles), ROUTER)}
    for name, password in passwords.items():
        _write(draft / name / PASSWORD, f"{password}\n".encode())
    users = "".join(f"{name}:{password}\n" for name, password in passwords.items())
    for name in (PLANT, ROUTER):
        _write(draft / name / USERS, users.encode())


def _write(path: Path, content: bytes) -> None:
    """Write a new file that only its owner can read."""
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(handle, "wb") as file:
        file.write(content)
