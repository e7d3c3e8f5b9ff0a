"""Connecting to a plant or a router that may not listen yet."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from bus.errors import TransportError
from deploy.errors import DeployError

if TYPE_CHECKING:
    from bus.spec import StallSpec
    from bus.transports.zenoh import Identity, ZenohEndpoint

_ATTEMPT_S: Final = 0.5
"""Longest attempt: signals are handled between attempts."""
QUIET_S: Final = 1.0
"""Wait before a line says what is waited for, wall seconds."""


def connect_patiently(
    connect: str,
    stall: StallSpec,
    identity: Identity | None,
    whose: str,
    say: Callable[[str], None],
    check: Callable[[], None] | None = None,
    *,
    plant: bool = False,
) -> ZenohEndpoint:
    """Connect to an endpoint, and wait up to ``stall.start_s`` until somebody listens there.

    Args:
        connect: The endpoint.
        stall: Deadlines.
        identity: Identity to present; None: none.
        whose: Name of this process in messages.
        say: Called with a line that says what is waited for.
        check: Called between attempts; may raise to end the wait.
        plant: Whether it is a plant that connects, which takes smaller payloads and uses more of Zenoh's threads.

    Raises:
        DeployError: Nobody listens there in time, or these keys are refused.
    """
    from bus.transports.zenoh import open_client
    from bus.transports.zenoh.session import AT_PLANT

    begun, said = time.monotonic(), False
    while True:
        try:
            return open_client(
                connect,
                lease_s=stall.lease_s,
                timeout_s=_ATTEMPT_S,
                identity=identity,
                one_thread=not plant,
                largest=AT_PLANT if plant else None,
            )
        except TransportError as error:
            waited_s = time.monotonic() - begun
            if waited_s >= stall.start_s:
                raise DeployError(f"--connect: {error}; waited {stall.start_s:g} s (stall.start_s)") from None
            if not said and waited_s > QUIET_S:
                said = True
                say(f"{whose} waits: {error}")
        if check is not None:
            check()
