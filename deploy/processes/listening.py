"""Where the plant may listen: beyond this host only for those who prove who they are."""

from __future__ import annotations

import ipaddress
import re
from typing import Final, Literal

from deploy.errors import InputError

Kind = Literal["certificate", "password"]

_ENDPOINT: Final = re.compile(r"(?P<protocol>[a-z_-]+)/(?P<address>[^/].*)")
_LOCAL: Final = ("unixsock-stream", "unixpipe")
"""Protocols that don't leave the host."""


def free_port(kind: Kind | None) -> str:
    """What the plan says of an endpoint that is chosen as the run begins."""
    return f"{'tls' if kind == 'certificate' else 'tcp'}/127.0.0.1 (a free port)"


def check_listening(listen: str, kind: Kind | None, *, insecure: bool) -> None:
    """Whether the plant may listen there.

    Args:
        listen: ``PROTOCOL/ADDRESS``.
        kind: How processes prove who they are; None: not at all.
        insecure: Whether anybody may join who can reach it.

    Raises:
        InputError: It is no endpoint, it is not TLS though certificates are to be shown, or strangers could join, or
            with passwords listen.
    """
    match = _ENDPOINT.fullmatch(listen)
    if match is None:
        raise InputError(f"--listen {listen}: must be PROTOCOL/ADDRESS, such as tcp/127.0.0.1:7447")
    if kind == "certificate":
        if match["protocol"] != "tls":
            raise InputError(
                f"--listen {listen}: with these keys it must be tls/, such as tls/{match['address']}"
            )
        return
    if match["protocol"] == "tls":
        raise InputError(
            f"--listen {listen}: tls/ needs certificates: --keys DIR, made by mdms keys DIR SCENE"
        )
    if insecure or match["protocol"] in _LOCAL or _is_loopback(host_of(listen)):
        return
    if kind == "password":
        raise InputError(
            f"--listen {listen}: leaves this host, and with passwords what is said goes unencrypted: use certificates "
            "(mdms keys without --passwords), or --insecure"
        )
    raise InputError(
        f"--listen {listen}: leaves this host, and anybody who reaches it could join: use --keys DIR "
        "(mdms keys DIR SCENE makes them), or --insecure"
    )


def host_of(endpoint: str) -> str:
    """The host of ``PROTOCOL/HOST:PORT``, with whatever else Zenoh has there."""
    address = endpoint.partition("/")[2]
    return address.partition("#")[0].partition("?")[0].rpartition(":")[0].strip("[]")


def near(endpoint: str) -> str:
    """How processes of the same host reach who listens there: on every address is on loopback, too."""
    for everywhere, loopback in (("/0.0.0.0:", "/127.0.0.1:"), ("/[::]:", "/[::1]:")):
        endpoint = endpoint.replace(everywhere, loopback, 1)
    return endpoint


def _is_loopback(host: str) -> bool:
    """Whether it is on the loopback interface by its very name."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
