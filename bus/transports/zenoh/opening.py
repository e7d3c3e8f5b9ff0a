"""Opening sessions: the plant's, and those of the cell processes."""

from __future__ import annotations

import os
import socket
from typing import Final, cast

import zenoh

from bus.errors import TransportError
from bus.transports.zenoh.config import LEASE_S, client_config, first_line, hub_config
from bus.transports.zenoh.endpoint import ZenohEndpoint
from bus.transports.zenoh.identity import PROTOCOL, Gate, Identity

_PORT_ATTEMPTS: Final = 20
_RUNTIME: Final = (
    "(app: (worker_threads: 1), acc: (worker_threads: 1), tx: (worker_threads: 1), "
    "rx: (worker_threads: 1), net: (worker_threads: 1))"
)


def open_hub(
    listen: str | None = None, *, lease_s: float = LEASE_S, gate: Gate | None = None
) -> ZenohEndpoint:
    """Opens the plant's session.

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
        session, locator = _listening(listen, lease_s, gate)
    except BaseException:
        if refusals is not None:
            refusals.close()
        raise
    return ZenohEndpoint(session, locator, refusals)


def _listening(listen: str | None, lease_s: float, gate: Gate | None) -> tuple[zenoh.Session, str]:
    if listen is not None:
        return _open(hub_config(listen, lease_s, gate), f"listen on {listen}"), listen
    protocol = "tcp" if gate is None else PROTOCOL[gate.identity.kind]
    for attempt in range(1, _PORT_ATTEMPTS + 1):
        locator = f"{protocol}/127.0.0.1:{_free_port()}"
        try:
            return _open(hub_config(locator, lease_s, gate), f"listen on {locator}"), locator
        except TransportError:
            # Somebody took the port between our look and Zenoh's; another is as good.
            if attempt == _PORT_ATTEMPTS:
                raise
    raise AssertionError("unreachable: this is a bug")


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
