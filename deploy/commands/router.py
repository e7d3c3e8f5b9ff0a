"""``mdms router``: a Zenoh router between a plant and cells on several hosts."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deploy.commands.options import default_endpoint
from deploy.util.formatting import say
from deploy.util.signals import Interrupted, Interruption
from deploy.workers.listening import check_listening, check_opened

if TYPE_CHECKING:
    from bus.transports.zenoh import ZenohEndpoint
    from bus.transports.zenoh.access_log import AccessLogMonitor

_POLL_S = 0.5

ListenOption = Annotated[
    list[str] | None,
    typer.Option(
        "--listen",
        metavar="ENDPOINT",
        help="Endpoint to listen on, such as tls/10.0.0.5:7447. Repeatable. Beyond loopback with --keys only. Default: "
        "tcp/127.0.0.1:7447, tls with certificates.",
    ),
]
KeysOption = Annotated[
    Path | None,
    typer.Option(
        "--keys",
        metavar="DIR",
        help="Admit only processes with keys from this folder, with their role's permissions (mdms keys). Of the "
        "folders of roles only router/ is needed.",
    ),
]
InsecureOption = Annotated[
    bool,
    typer.Option(
        "--insecure", help="Allow endpoints that anybody can use without keys, and drive runs there."
    ),
]


def router(*, listen: ListenOption = None, keys: KeysOption = None, insecure: InsecureOption = False) -> None:
    """Run a Zenoh router, which carries the messages between a plant and cells that can't reach each other directly.

    Plant, cells and operators connect to it. A run needs no router where the plant's host can be reached: mdms plant
    --listen. The router knows nothing of runs and carries any number of them, told apart by name. It runs until
    Ctrl-C or SIGTERM. If it ends, the runs lose all their cells; sessions reconnect when it is back.

    In four terminals; between hosts, with keys:

      [cyan]mdms router[/cyan]
      [cyan]mdms plant heat --shards 1 --connect tcp/127.0.0.1:7447[/cyan]
      [cyan]mdms cells heat --shard 0/1 --connect tcp/127.0.0.1:7447[/cyan]
      [cyan]mdms status --connect tcp/127.0.0.1:7447[/cyan]
      [cyan]mdms router --listen tls/10.0.0.5:7447 --keys secret[/cyan]
    """
    interruption = Interruption()
    with interruption.handling(last=True):
        endpoint = _opened(listen or [default_endpoint(keys)], keys, insecure=insecure)
        try:
            addresses = ", ".join(address.partition("?")[0] for address in endpoint.listening)
            say(f"the router listens on {addresses or endpoint.locator}")
            _serve(endpoint.refusals, interruption)
        except Interrupted:
            say("the router ends")
        finally:
            endpoint.close()


def _opened(listen: list[str], keys: Path | None, *, insecure: bool) -> ZenohEndpoint:
    """Open the router, as private as the keys demand.

    Raises:
        InputError: An endpoint is invalid, in use, or reachable from more than is allowed, or the keys are not valid.
    """
    from bus.errors import TransportError
    from bus.transports.zenoh import open_router
    from deploy.errors import InputError

    gate, kind = None, None
    if keys is not None:
        from deploy.security.keyring import Keyring

        keyring = Keyring(keys)
        gate, kind = keyring.router_gate(), keyring.about.kind
    for one in listen:
        check_listening(one, kind, insecure=insecure)
    try:
        endpoint = open_router(listen, gate)
    except TransportError as error:
        raise InputError(f"--listen: {error}") from None
    try:
        check_opened(", ".join(listen), endpoint.listening, kind, insecure=insecure)
    except InputError:
        endpoint.close()
        raise
    return endpoint


def _serve(refusals: AccessLogMonitor | None, interruption: Interruption) -> None:
    """Wait for the end, and print each kind of denial once."""
    known: set[tuple[str, str]] = set()

    def tell() -> None:
        if refusals is not None and refusals.fresh:
            for whose, what in sorted(refusals.counted().keys() - known):
                known.add((whose, what))
                say(f"denied: {whose}: {what}")

    interruption.is_idle = lambda: True
    try:
        while True:
            interruption.raise_if_requested()
            time.sleep(_POLL_S)
            tell()
    finally:
        tell()
