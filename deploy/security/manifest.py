"""Files of a run's keys: a manifest, the access control, and a folder for each role.

    DIR/keys.json           manifest: kind of credentials, cells of each role, end of validity
    DIR/access.json5        Zenoh's access_control
    DIR/ROLE/               keys of this role alone: copy the folder to the role's host

``ROLE/`` holds ``authority.pem``, ``certificate.pem`` and ``key.pem``; or ``password``, and the plant's ``users``.
"""

from __future__ import annotations

from datetime import datetime
from typing import Final, Literal, final

from bus.spec import CellName, Spec
from bus.wire.keys import WireFormat

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
    """Manifest of a folder of keys, ``keys.json``.

    Attributes:
        version: Version of the manifest's format.
        kind: Kind of the roles' credentials.
        scene: Name of the scene.
        wire: Wire format to whose keys the roles have access.
        roles: Cells of each role.
        hosts: Names and addresses in the plant's certificate; empty with passwords.
        until: End of validity; None for passwords, which don't expire.
    """

    version: Literal[1] = 1
    kind: Kind
    scene: str
    wire: WireFormat
    roles: dict[str, tuple[CellName, ...]]
    hosts: tuple[str, ...] = ()
    until: datetime | None = None

    def largest(self) -> tuple[int, int]:
        """Return the most cells of a process of cells, and the most links from them to other processes."""
        groups = [cells for cells in self.roles.values() if cells]
        owner = {cell: number for number, cells in enumerate(groups) for cell in cells}
        links = [0] * len(groups)
        for (row, column), own in owner.items():
            for near in ((row + 1, column), (row - 1, column), (row, column + 1), (row, column - 1)):
                links[own] += owner.get(near, own) != own
        return max(map(len, groups), default=0), max(links, default=0)
