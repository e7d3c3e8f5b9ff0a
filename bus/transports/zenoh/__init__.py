"""The transport between processes: Zenoh.

The plant's session is a peer that listens on one endpoint (``open_hub``). Every cell process is a client of that
session (``open_client``), and clients receive from each other through it. Listeners and operators are clients of a
second session (``open_outside``), to which a ``Mirror`` copies the run's messages. Discovery by multicast and gossip is
off.
"""

from __future__ import annotations

from bus.transports.zenoh.endpoint import ZenohEndpoint, open_client, open_hub, open_outside, open_router
from bus.transports.zenoh.mirror import Mirror
from bus.transports.zenoh.session import (
    AccessPolicy,
    Certificate,
    Identity,
    Password,
    client_config,
    hub_config,
)

__all__ = [
    "AccessPolicy",
    "Certificate",
    "Identity",
    "Mirror",
    "Password",
    "ZenohEndpoint",
    "client_config",
    "hub_config",
    "open_client",
    "open_hub",
    "open_outside",
    "open_router",
]
