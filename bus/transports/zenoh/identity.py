"""Who a session says it is, and whom the plant's session lets in."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Final, Literal, final

PROTOCOL: Final = {"certificate": "tls", "password": "tcp"}
"""Over what sessions talk that prove who they are in this way."""


@final
@dataclass(frozen=True, slots=True)
class Certificate:
    """A certificate and its private key, for mutual TLS; its common name is the role.

    Attributes:
        authority: File with the certificate of whoever signed those of both sides.
        certificate: File with one's own.
        key: File with its private key.
    """

    authority: str
    certificate: str
    key: str
    kind: Literal["certificate"] = "certificate"

    def settings(self, side: Literal["listen", "connect"]) -> dict[str, str]:
        """Zenoh's settings, by key, in JSON."""
        tls = {
            "root_ca_certificate": self.authority,
            f"{side}_certificate": self.certificate,
            f"{side}_private_key": self.key,
            "enable_mtls": True,
        }
        # Nothing but TLS, or a stranger's port could be taken for the plant's.
        return {"transport/link/tls": json.dumps(tls), "transport/link/protocols": '["tls"]'}


@final
@dataclass(frozen=True, slots=True)
class Password:
    """A user and a password; the user's name is the role. Nobody proves to be the plant, and all goes in the clear."""

    user: str
    password: str = field(repr=False)
    kind: Literal["password"] = "password"

    def settings(self, side: Literal["listen", "connect"]) -> dict[str, str]:  # noqa: ARG002 - as a certificate's
        """Zenoh's settings, by key, in JSON."""
        own = {"user": self.user, "password": self.password}
        return {f"transport/auth/usrpwd/{name}": json.dumps(value) for name, value in own.items()}


Identity = Certificate | Password


@final
@dataclass(frozen=True, slots=True)
class Gate:
    """Whom a session that listens lets in, and what each may do.

    Attributes:
        identity: The plant's own; None where nobody has to prove who they are.
        access: Zenoh's ``access_control``, JSON.
        limits: Zenoh's ``low_pass_filter``, JSON: how large what comes in may be.
        users: File with a ``user:password`` a line, where passwords are asked for.
    """

    identity: Identity | None
    access: str
    limits: str = "[]"
    users: str | None = None

    def settings(self) -> dict[str, str]:
        """Zenoh's settings, by key, in JSON."""
        settings = {"access_control": self.access, "low_pass_filter": self.limits}
        if self.identity is not None:
            settings.update(self.identity.settings("listen"))
        if self.users is not None:
            settings["transport/auth/usrpwd/dictionary_file"] = json.dumps(self.users)
        return settings
