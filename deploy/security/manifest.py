"""A run's keys as files: what they are for, what each role may do, and a folder a role.

    DIR/keys.json           how roles prove who they are, which cells each has, until when
    DIR/access.json5        Zenoh's access_control
    DIR/ROLE/               what this role has to have, and no other: copy it to its host

``ROLE/`` holds ``authority.pem``, ``certificate.pem`` and ``key.pem``; or ``password``, and the plant's ``users``.
"""

from __future__ import annotations

from datetime import datetime
from typing import Final, Literal, final

from bus.spec import CellName, Spec

KEYS: Final = "keys.json"
ACCESS: Final = "access.json5"
AUTHORITY: Final = "authority.pem"
CERTIFICATE: Final = "certificate.pem"
KEY: Final = "key.pem"
PASSWORD: Final = "password"
USERS: Final = "users"

Kind = Literal["certificate", "password"]


@final
class KeyManifest(Spec):
    """What a folder of keys is for: ``keys.json``.

    Attributes:
        version: Of this layout.
        kind: How roles prove who they are.
        scene: Name of the scene.
        wire: The wire form whose keys they give leave for.
        roles: The cells of each role.
        hosts: Names and addresses under which the plant can be reached; empty with passwords.
        until: When they end; None: never, as passwords.
    """

    version: Literal[1] = 1
    kind: Kind
    scene: str
    wire: Literal["packed", "cells"]
    roles: dict[str, tuple[CellName, ...]]
    hosts: tuple[str, ...] = ()
    until: datetime | None = None
