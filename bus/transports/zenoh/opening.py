"""Opening sessions: the one that cells join, the mirror's, and those of clients."""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Callable
from typing import Any, Final, cast

import zenoh

from bus.errors import TransportError
from bus.transports.zenoh.config import LEASE_S, client_config, first_line, hub_config, mirror_config
from bus.transports.zenoh.endpoint import ZenohEndpoint
from bus.transports.zenoh.identity import PROTOCOL, Gate, Identity

_PORT_ATTEMPTS: Final = 20
_RUNTIME: Final = (
    "(app: (worker_threads: 1), acc: (worker_threads: 1), tx: (worker_threads: 1), "
    "rx: (worker_threads: 1), net: (worker_threads: 1))"
)
_NO_PORT: Final = ":0"


def open_hub(
    listen: str | None = None, *, lease_s: float = LEASE_S, gate: Gate | None = None
) -> ZenohEndpoint:
    """Opens the plant's session, which cells join.

    Args:
        listen: Endpoint to listen on; None: a free loopback port.
        lease_s: See ``hub_config``.
        gate: Whom to let in; None: anybody.

    Returns:
        The endpoint; its ``locator`` is what clients connect to.

    Raises:
        TransportError: The port is in use, or the endpoint makes no sense.
    """
    refusals = None
    if gate is not None:
        from bus.transports.zenoh.refusals import Watch

        refusals = Watch()
    try:
        session, locator, listening = _listening(listen, gate, lambda where: hub_config(where, lease_s, gate))
    except BaseException:
        if refusals is not None:
            refusals.close()
        raise
    return ZenohEndpoint(session, locator, refusals, listening)


def open_outside(listen: str | None, *, lease_s: float = LEASE_S, gate: Gate) -> ZenohEndpoint:
    """Opens the session of a run's mirror, which listeners and operators connect to.

    Args:
        listen: Endpoint to listen on; None: a free loopback port.
        lease_s: See ``hub_config``.
        gate: Whom to let in, and what they may do there.

    Raises:
        TransportError: As of ``open_hub``.
    """
    session, locator, listening = _listening(listen, gate, lambda where: mirror_config(where, lease_s, gate))
    return ZenohEndpoint(session, locator, listening=listening)


_Opened = tuple[zenoh.Session, str, tuple[str, ...]]
"""A session, what to connect to, and the addresses that it listens on."""


def _listening(listen: str | None, gate: Gate | None, config: Callable[[str], zenoh.Config]) -> _Opened:
    if listen is not None:
        session = _open(config(listen), f"listen on {listen}")
        addresses = _addresses(session)
        return session, _with_port(listen, addresses), addresses
    protocol = "tcp" if gate is None or gate.identity is None else PROTOCOL[gate.identity.kind]
    for attempt in range(1, _PORT_ATTEMPTS + 1):
        locator = f"{protocol}/127.0.0.1:{_free_port()}"
        try:
            session = _open(config(locator), f"listen on {locator}")
        except TransportError:
            # Somebody took the port between our look and Zenoh's; another is as good.
            if attempt == _PORT_ATTEMPTS:
                raise
            continue
        return session, locator, _addresses(session)
    raise AssertionError("unreachable: this is a bug")


def _addresses(session: zenoh.Session) -> tuple[str, ...]:
    """Addresses that a session listens on: its own answer, from Zenoh's admin space."""
    own = cast("Any", session)
    for reply in own.get(f"@/{own.zid()}/peer"):
        if reply.ok is not None:
            return tuple(json.loads(reply.ok.payload.to_string())["locators"])
    return ()


def _with_port(listen: str, addresses: tuple[str, ...]) -> str:
    """The endpoint that was asked for, with the port that was found where port 0 asked for any."""
    address, mark, more = listen.partition("#")
    if not address.endswith(_NO_PORT) or not addresses:
        return listen
    port = addresses[0].partition("#")[0].partition("?")[0].rpartition(":")[2]
    return f"{address.removesuffix(_NO_PORT)}:{port}{mark}{more}"


def open_client(
    connect: str, *, lease_s: float = LEASE_S, timeout_s: float = 10.0, identity: Identity | None = None
) -> ZenohEndpoint:
    """Opens a cell process's session, or an onlooker's; call it after a fork, never before.

    Raises:
        TransportError: Nobody listens there within ``timeout_s``, or whoever does lets nobody in with this identity.
    """
    # A cell process has little to do: one thread a pool is faster than many. Read once, at the first session.
    os.environ.setdefault("ZENOH_RUNTIME", _RUNTIME)
    config = client_config(connect, lease_s, timeout_s, identity)
    return ZenohEndpoint(_open(config, f"connect to {connect}"), connect)


def _open(config: zenoh.Config, attempted: str) -> zenoh.Session:
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        text = str(error)
        if "in use" in text:
            raise TransportError(f"{attempted}: the port is in use") from None
        if attempted.startswith("connect to tls"):
            raise TransportError(
                f"{attempted}: nobody answers, or they let nobody in with these keys ({first_line(error)})"
            ) from None
        if attempted.startswith("connect"):
            raise TransportError(f"{attempted}: nobody answers ({first_line(error)})") from None
        raise TransportError(f"{attempted}: {first_line(error)}") from None


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return cast("int", probe.getsockname()[1])
