"""Settings of the plant's and the cells' sessions; docs/bus.md explains each."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal, cast, final

import zenoh

from bus.errors import TransportError

PROTOCOL: Final = {"certificate": "tls", "password": "tcp"}
"""Transport protocol of sessions, by kind of identity."""


@final
@dataclass(frozen=True, slots=True)
class Certificate:
    """A certificate and its private key, for mutual TLS; its common name is the role.

    Attributes:
        authority: File with the certificate of the authority that signed both sides' certificates.
        certificate: File with the own certificate.
        key: File with the private key of the certificate.
    """

    authority: str
    certificate: str
    key: str
    kind: Literal["certificate"] = "certificate"

    def settings(self, side: Literal["listen", "connect"]) -> dict[str, str]:
        """Return Zenoh's settings, by key, in JSON."""
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
    """A user and a password; the user's name is the role. The plant is not authenticated, and nothing is encrypted."""

    user: str
    password: str = field(repr=False)
    kind: Literal["password"] = "password"

    def settings(self, side: Literal["listen", "connect"]) -> dict[str, str]:  # noqa: ARG002 - as a certificate's
        """Return Zenoh's settings, by key, in JSON."""
        own = {"user": self.user, "password": self.password}
        return {f"transport/auth/usrpwd/{name}": json.dumps(value) for name, value in own.items()}


Identity = Certificate | Password


@final
@dataclass(frozen=True, slots=True)
class AccessPolicy:
    """Access policy of a listening session: admitted identities, and the permissions of each role.

    Attributes:
        identity: The plant's own identity; None without authentication.
        access: Zenoh's ``access_control``, JSON.
        limits: Zenoh's ``low_pass_filter``, JSON: how large what comes in may be.
        users: File with a ``user:password`` a line, where passwords are asked for.
    """

    identity: Identity | None
    access: str
    limits: str = "[]"
    users: str | None = None

    def settings(self) -> dict[str, str]:
        """Return Zenoh's settings, by key, in JSON."""
        settings = {"access_control": self.access, "low_pass_filter": self.limits}
        if self.identity is not None:
            settings.update(self.identity.settings("listen"))
        if self.users is not None:
            settings["transport/auth/usrpwd/dictionary_file"] = json.dumps(self.users)
        return settings


LARGEST: Final = 1 << 28
"""Bytes of the largest payload that comes in: several times the senses of a million cells."""
AT_PLANT: Final = 1 << 26
"""Bytes of the largest payload received by the plant: 64 MiB, the drives of four million cells in one shard."""
_INTO_MIRROR: Final = 1 << 20
"""Bytes of the largest message that the mirror's session takes."""
_QUEUE: Final = 16
"""Batches of 64 kB that wait on each link of the mirror, the most that Zenoh has; 2 by default."""
_PATIENCE_US: Final = 100_000
"""Wait for a listener whose link is full before the mirror closes that link, µs; 5 s by default."""
LEASE_S: Final = 2.0
"""Silence after which the other side takes a process for dead, s; each session's own lease governs its token."""


def hub_config(listen: str, lease_s: float = LEASE_S, gate: AccessPolicy | None = None) -> zenoh.Config:
    """Return the settings of a session that listens: the plant's, which cells join, or the mirror's.

    Args:
        listen: Endpoint such as ``tcp/127.0.0.1:7447``.
        lease_s: Silence after which the others take the plant for dead, s.
        gate: Access policy; None: all sessions are admitted.
    """
    config = _config("peer", lease_s)
    _set(config, "listen/endpoints", json.dumps([listen]))
    _set(config, "listen/exit_on_failure", "true")
    # Asked once, within this session, for the addresses that it listens on.
    _set(config, "adminspace/enabled", "true")
    # Shared memory is off in every session: with it a hub stops near 350 sessions.
    _set(config, "transport/unicast/max_sessions", "20000")
    _set(config, "transport/unicast/accept_pending", "2000")
    # What comes in pieces is put together in memory before anybody can refuse it.
    _set(config, "transport/link/rx/max_message_size", str(min(LARGEST, AT_PLANT)))
    for key, value in ({} if gate is None else gate.settings()).items():
        _set(config, key, value)
    return config


def router_config(listen: Sequence[str], gate: AccessPolicy | None) -> zenoh.Config:
    """Return the settings of a router, which passes everything on between its clients.

    Args:
        listen: Endpoints such as ``tcp/127.0.0.1:7447``.
        gate: Access policy; None: all sessions are admitted.
    """
    config = hub_config(listen[0], LEASE_S, gate)
    _set(config, "mode", '"router"')
    _set(config, "listen/endpoints", json.dumps(list(listen)))
    _set(config, "transport/link/rx/max_message_size", str(LARGEST))
    return config


def mirror_config(listen: str, lease_s: float, gate: AccessPolicy) -> zenoh.Config:
    """Return the settings of the mirror's session, which listeners and operators connect to; see ``hub_config``."""
    config = hub_config(listen, lease_s, gate)
    # Nothing that comes in is longer than a question.
    _set(config, "transport/link/rx/max_message_size", str(_INTO_MIRROR))
    # A burst of a tick waits here for a listener that reads; what does not fit is dropped.
    _set(config, "transport/link/tx/queue/size/data", str(_QUEUE))
    # Declarations and replies are never dropped. A thread that sends one holds up whoever shares that thread.
    _set(config, "transport/link/tx/queue/congestion_control/block/wait_before_close", str(_PATIENCE_US))
    return config


def client_config(
    connect: str,
    lease_s: float = LEASE_S,
    timeout_s: float = 10.0,
    identity: Identity | None = None,
    largest: int | None = None,
) -> zenoh.Config:
    """Return the settings of a session that connects: a cell process's, an operator's, or the plant's to a router.

    Args:
        connect: The plant's endpoint.
        lease_s: Silence after which the plant takes this process for dead, s.
        timeout_s: Time to retry while there is no listener, s.
        identity: Identity to present to the plant; None: none.
        largest: Bytes of the largest payload that comes in; None: ``LARGEST``.
    """
    config = _config("client", lease_s)
    _set(config, "connect/endpoints", json.dumps([connect]))
    _set(config, "connect/timeout_ms", str(round(timeout_s * 1000)))
    _set(config, "connect/exit_on_failure", "true")
    _set(config, "connect/retry", "{period_init_ms: 20, period_max_ms: 200, period_increase_factor: 2}")
    _set(config, "listen/endpoints", "[]")
    _set(config, "transport/link/rx/max_message_size", str(largest or LARGEST))
    for key, value in ({} if identity is None else identity.settings("connect")).items():
        _set(config, key, value)
    return config


def _config(mode: str, lease_s: float) -> zenoh.Config:
    config = zenoh.Config()
    _set(config, "mode", json.dumps(mode))
    _set(config, "scouting/multicast/enabled", "false")
    _set(config, "scouting/gossip/enabled", "false")
    _set(config, "transport/shared_memory/enabled", "false")
    # One queue a link: with priorities a token's withdrawal overtakes the data put before it.
    _set(config, "transport/unicast/qos/enabled", "false")
    # Longer ones are dropped piece by piece; by default a stranger's may take 1 GiB.
    _set(config, "transport/link/rx/max_message_size", str(LARGEST))
    _set(config, "transport/link/tx/lease", str(round(lease_s * 1000)))
    _set(config, "open/return_conditions/connect_scouted", "false")
    return config


def _set(config: zenoh.Config, key: str, value: str) -> None:
    """Set one key to a value in JSON."""
    try:
        cast("Any", config).insert_json5(key, value)
    except zenoh.ZError as error:
        raise TransportError(f"Zenoh refuses {key} = {value}: {first_line(error)}") from None


def first_line(error: BaseException) -> str:
    """Return the first line of an error, without Zenoh's source location."""
    lines = str(error).splitlines()
    return re.sub(r" at \S+\.rs:\d+\.?", "", lines[0]) if lines else type(error).__name__
