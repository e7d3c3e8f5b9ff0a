"""The transport between processes: Zenoh.

The plant's session is a peer that listens on one endpoint (``open_hub``). Every cell process is a client of that
session (``open_client``), and clients hear each other through it. Listeners and operators are clients of a second
session (``open_outside``), to which a ``Mirror`` copies the run's messages. Nobody is found by multicast or gossip.
"""

from __future__ import annotations

from bus.transports.zenoh.config import client_config, hub_config
from bus.transports.zenoh.endpoint import ZenohEndpoint
from bus.transports.zenoh.identity import Certificate, Gate, Identity, Password
from bus.transports.zenoh.mirror import Mirror
from bus.transports.zenoh.opening import open_client, open_hub, open_outside

__all__ = [
    "Certificate",
    "Gate",
    "Identity",
    "Mirror",
    "Password",
    "ZenohEndpoint",
    "client_config",
    "hub_config",
    "open_client",
    "open_hub",
    "open_outside",
]
