"""Keys of a run, read from a folder: checks, identities and access policies."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

from pydantic import ValidationError

from deploy.errors import InputError
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
from deploy.security.policy import QUESTION_LIMITS, part_of, router_access, size_limits
from deploy.security.roles import OPERATOR, PLANT, ROUTER, ProcessLayout, roles_of
from deploy.util.formatting import plural

if TYPE_CHECKING:
    from bus.transports.zenoh import AccessPolicy, Identity


def identity_of(folder: Path, role: str) -> Identity:
    """Return the identity with which a role connects to the plant.

    Args:
        folder: Folder of the role.
        role: Name of the role.

    Raises:
        InputError: A file is missing, or others than its owner can read what is secret or change what is trusted.
    """
    from bus.transports.zenoh.session import Certificate, Password

    if (folder / PASSWORD).exists():
        return Password(role, _secret(folder / PASSWORD).read_text(encoding="utf-8").strip())
    authority, certificate = _sound(folder / AUTHORITY), _sound(folder / CERTIFICATE)
    return Certificate(str(authority), str(certificate), str(_secret(folder / KEY)))


def kind_of(folder: Path, role: str | None = None) -> Kind:
    """Return the kind of the credentials in a run's keys, or in the folder of a role.

    Args:
        folder: The folder.
        role: Role whose folder it may be; None: it must be the run's.

    Raises:
        InputError: The folder has no keys.
    """
    if role is not None and not (folder / KEYS).exists():
        return identity_of(folder, role).kind
    return Keyring(folder).about.kind


def operator_of(folder: Path) -> Identity:
    """Return an operator's identity, from a run's keys or from the operator's folder alone.

    Raises:
        InputError: The keys are not an operator's or have expired; see ``identity_of``.
    """
    own = folder / OPERATOR if (folder / KEYS).exists() else folder
    identity = identity_of(own, OPERATOR)
    _check(identity, OPERATOR)
    return identity


def cells_identity(folder: Path, role: str) -> Identity:
    """Return the identity of a process of cells, from a run's keys or from the role's folder alone.

    Raises:
        InputError: The keys are missing, another role's, or have expired; see ``identity_of``.
    """
    own = folder / role if (folder / KEYS).exists() else folder
    identity = identity_of(own, role)
    _check(identity, role)
    return identity


@final
class Keyring:
    """Keys of a run.

    Args:
        folder: Folder made by ``mdms keys``.

    Attributes:
        about: Manifest of the folder.

    Raises:
        InputError: The folder has no readable manifest.
    """

    def __init__(self, folder: Path) -> None:
        if not (folder / KEYS).exists():
            raise InputError(
                f"--keys {folder}: is no folder of keys, there is no {KEYS}: mdms keys DIR SCENE makes one"
            )
        self._folder = folder.absolute()
        try:
            self.about = KeyManifest.model_validate_json(_sound(folder / KEYS).read_bytes())
        except ValidationError as error:
            raise InputError(
                f"{folder / KEYS}: {error.errors()[0]['msg']}; mdms keys makes a new one"
            ) from None
        except OSError as error:
            raise InputError(f"{folder / KEYS}: can't be read: {error.strerror}") from None

    def check(self, cut: ProcessLayout, host: str | None, *, plant_alone: bool = False) -> None:
        """Check that every process has valid keys for a run with this layout.

        Args:
            cut: Layout of the cells in processes.
            host: Name or address of the plant's host; None: loopback.
            plant_alone: Whether other processes have their keys elsewhere.

        Raises:
            InputError: The keys don't fit; the message names the reason in one line.
        """
        about, roles = self.about, {role.name: role.cells for role in roles_of(cut)}
        if about.wire != cut.wire or about.roles != roles:
            raise InputError(
                f"--keys {self._folder}: made for {_layout_text(about.roles, about.wire)} (scene {about.scene}), "
                f"not for these {_layout_text(roles, cut.wire)}: mdms keys makes others"
            )
        if about.kind == "certificate" and host not in (None, *about.hosts):
            raise InputError(
                f"--keys {self._folder}: the plant's certificate is for {', '.join(about.hosts)}, not for {host}: "
                f"mdms keys --host {host} makes another"
            )
        for role in [PLANT] if plant_alone else roles:
            identity = identity_of(self._folder / role, role)
            if role != OPERATOR:
                _check(identity, role)

    def gate(self, *, operators: bool = False) -> AccessPolicy:
        """Return the access policy of the session that cells join.

        Args:
            operators: Whether operators may send requests there. They may not listen: this session drops nothing.
        """
        part = part_of(self._access(), operators=False, asking=operators)
        return self._gate(self._limits(), part, PLANT)

    def outer_gate(self) -> AccessPolicy:
        """Return the access policy of the session for listeners and operators; cells have no rights there."""
        return self._gate(QUESTION_LIMITS, part_of(self._access(), operators=True), PLANT)

    def router_gate(self) -> AccessPolicy:
        """Return the access policy of a router, for runs of the layout for which the keys were made.

        Raises:
            InputError: The router's keys are missing or not valid.
        """
        _check(identity_of(self._folder / ROUTER, ROUTER), ROUTER)
        return self._gate(self._limits(), router_access(self._access(), self.about.kind), ROUTER)

    def _limits(self) -> list[dict[str, Any]]:
        """Return the limits of sizes for what comes in."""
        return [*size_limits(*self.about.largest(), self.about.wire), *QUESTION_LIMITS]

    def _gate(self, limits: list[dict[str, Any]], access: dict[str, Any], role: str) -> AccessPolicy:
        from bus.transports.zenoh.session import AccessPolicy

        own = self._folder / role
        users = str(_secret(own / USERS)) if self.about.kind == "password" else None
        return AccessPolicy(identity_of(own, role), json.dumps(access), json.dumps(limits), users)

    def plant_as_client(self) -> Identity:
        """Return the plant's identity, as it presents itself to a router."""
        return identity_of(self._folder / PLANT, PLANT)

    def of_cells(self, cut: ProcessLayout) -> tuple[Path, ...]:
        """Return the folder of each process of cells, by shard."""
        return tuple(self._folder / cut.role(shard) for shard in range(cut.partition.count))

    def _access(self) -> dict[str, Any]:
        """Read the access control, without its comments, which Python's JSON can't parse."""
        path = _sound(self._folder / ACCESS)
        lines = path.read_text(encoding="utf-8").splitlines()
        try:
            access: dict[str, Any] = json.loads(
                "\n".join(line for line in lines if not line.startswith("//"))
            )
        except ValueError as error:
            raise InputError(f"{path}: {error}") from None
        if not access.get("enabled") or access.get("default_permission") != "deny":
            raise InputError(f"{path}: must be enabled, and deny what no rule allows")
        return access


def _layout_text(roles: dict[str, tuple[tuple[int, int], ...]], wire: str) -> str:
    """Describe the layout of cells in processes."""
    processes = [cells for role, cells in roles.items() if role not in (PLANT, OPERATOR)]
    cells = sum(map(len, processes))
    return f"{cells:,} cells in {plural(len(processes), 'process', 'processes')}, wire format {wire}"


def _check(identity: Identity, role: str) -> None:
    """Check that a certificate belongs to the role and is valid."""
    if identity.kind == "certificate":
        from deploy.security.verify import check_certificate

        check_certificate(identity, role)


def _there(path: Path) -> Path:
    if not path.is_file():
        raise InputError(f"{path}: there is no such file: mdms keys makes it")
    return path


def _sound(path: Path) -> Path:
    """Return the path of a trusted file, after a check that only its owner can change or replace the file."""
    for changed in (_there(path), path.parent):
        mode = changed.stat().st_mode
        if mode & 0o022:
            raise InputError(
                f"{changed}: others can change it, mode {mode & 0o777:04o}: chmod go-w {changed}"
            )
    return path


def _secret(path: Path) -> Path:
    mode = _there(path).stat().st_mode
    if mode & 0o077:
        raise InputError(f"{path}: others can read it, mode {mode & 0o777:04o}: chmod 600 {path}")
    return path
