"""Endpoints that a plant may listen on: valid, and as private as its keys demand."""

from __future__ import annotations

import ipaddress
import re
import socket
from collections.abc import Sequence
from typing import Final, Literal

from deploy.errors import InputError

Kind = Literal["certificate", "password"]
Option = Literal["--listen", "--join"]
"""``--listen``: for listeners and operators. ``--join``: for processes of cells."""

_ENDPOINT: Final = re.compile(r"(?P<protocol>[a-z_-]+)/(?P<address>\S.*)")
_HOST_AND_PORT: Final = re.compile(
    r"(?P<host>\[[0-9A-Za-z:.%]+\]|[^\s\[\]:,\"'/\\?#]+):\d+(?P<more>[?#][^\s,\"'\\]*)?"
)
_INTERFACE: Final = re.compile(r"[#;&](?:iface|bind)=(?P<interface>[^;&#]*)")
_SOCKET: Final = "unixsock-stream"
_LOCAL: Final = (_SOCKET, "unixpipe")
"""Protocols that don't leave the host."""


def free_port(kind: Kind | None) -> str:
    """Describe an endpoint on loopback whose port is chosen at the start of the run."""
    return f"{'tls' if kind == 'certificate' else 'tcp'}/127.0.0.1 (a free port)"


def joined_at(kind: Kind | None) -> str:
    """Describe the default endpoint that cells join."""
    return f"{_SOCKET} (a private folder)" if kind is None else free_port(kind)


def socket_in(folder: str) -> str:
    """Return the endpoint of a Unix socket in a folder."""
    return f"{_SOCKET}/{folder}/run"


def socket_path(endpoint: str) -> str | None:
    """Return the path of the Unix socket of an endpoint; None for other protocols."""
    protocol, _, path = endpoint.partition("/")
    return path if protocol == _SOCKET else None


def check_listening(endpoint: str, kind: Kind | None, *, insecure: bool, option: Option = "--listen") -> None:
    """Check that the plant may listen on an endpoint.

    Args:
        endpoint: ``PROTOCOL/ADDRESS``.
        kind: Kind of credentials; None: no credentials.
        insecure: Accept an endpoint that any peer can reach.
        option: Option that names the endpoint.

    Raises:
        InputError: The endpoint is invalid, is not TLS although certificates are used, or lets strangers connect or,
            with passwords, read the traffic.
    """
    match = _ENDPOINT.fullmatch(endpoint)
    if match is None:
        raise InputError(f"{option} {endpoint}: must be PROTOCOL/ADDRESS, such as tcp/127.0.0.1:7447")
    if match["protocol"] not in _LOCAL and _HOST_AND_PORT.fullmatch(match["address"]) is None:
        raise InputError(
            f"{option} {endpoint}: must be one endpoint, PROTOCOL/HOST:PORT, such as tcp/127.0.0.1:7447"
        )
    if kind == "certificate":
        if match["protocol"] != "tls":
            raise InputError(
                f"{option} {endpoint}: with these keys it must be tls/, such as tls/{match['address']}"
            )
        return
    if match["protocol"] == "tls":
        raise InputError(
            f"{option} {endpoint}: tls/ needs certificates: --keys DIR, made by mdms keys DIR SCENE"
        )
    if not insecure:
        _check_reach(endpoint, kind, option)


def check_opened(
    endpoint: str, addresses: Sequence[str], kind: Kind | None, *, insecure: bool, option: Option = "--listen"
) -> None:
    """Check that the addresses on which a session listens are as private as the requested endpoint.

    Args:
        endpoint: Requested endpoint.
        addresses: Addresses on which the session listens.
        kind: Kind of credentials; None: no credentials.
        insecure: Accept an endpoint that any peer can reach.
        option: Option that names the endpoint.

    Raises:
        InputError: An address is reachable from more than is allowed, or Zenoh names no address.
    """
    if insecure or kind == "certificate":
        return
    if not addresses:
        raise InputError(
            f"{option} {endpoint}: Zenoh doesn't report the address then: use tcp/, or --insecure"
        )
    for address in addresses:
        _check_reach(address, kind, option)


def _check_reach(endpoint: str, kind: Kind | None, option: Option) -> None:
    """Raise InputError if an endpoint is reachable from more than is allowed."""
    if is_local(endpoint):
        if option == "--join" and kind is None and not endpoint.startswith(f"{_SOCKET}/"):
            raise InputError(
                f"{option} {endpoint}: anybody on this host could drive the run's wheels: use {_SOCKET}/PATH, or "
                "--keys DIR (mdms keys DIR SCENE makes them), or --insecure"
            )
        return
    if kind == "password":
        raise InputError(
            f"{option} {endpoint}: leaves this host, and with passwords messages are not encrypted: use "
            "certificates (mdms keys without --passwords), or --insecure"
        )
    done = "listen to the run and disturb it" if option == "--listen" else "join"
    raise InputError(
        f"{option} {endpoint}: leaves this host, and anybody who reaches it could {done}: use --keys DIR "
        "(mdms keys DIR SCENE makes them), or --insecure"
    )


def is_local(endpoint: str) -> bool:
    """Whether an endpoint is reachable from this host only, by its protocol or by all addresses of its host's name."""
    protocol, _, address = endpoint.partition("/")
    if protocol in _LOCAL:
        return True
    interface = _INTERFACE.search(address)
    return (interface is None or interface["interface"] == "lo") and _is_loopback(host_of(endpoint))


def host_of(endpoint: str) -> str:
    """Return the host of ``PROTOCOL/HOST:PORT``, which may have Zenoh's metadata and configuration appended."""
    address = endpoint.partition("/")[2]
    return address.partition("#")[0].partition("?")[0].rpartition(":")[0].strip("[]")


def loopback_address(endpoint: str) -> str:
    """Return the endpoint with loopback in place of the wildcard address, for processes of the same host."""
    for everywhere, loopback in (("/0.0.0.0:", "/127.0.0.1:"), ("/[::]:", "/[::1]:")):
        endpoint = endpoint.replace(everywhere, loopback, 1)
    return endpoint


def _is_loopback(host: str) -> bool:
    """Whether a host's name stands for loopback addresses alone."""
    try:
        found = socket.getaddrinfo(host, None) if host else []
        return bool(found) and all(ipaddress.ip_address(one[4][0]).is_loopback for one in found)
    except (OSError, ValueError):
        return False
