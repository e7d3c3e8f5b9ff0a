"""The transport between processes: Zenoh over TCP, loopback unless told otherwise.

The plant's session is a peer that listens on one endpoint (``open_hub``); every cell process is a client of
it (``open_client``), and clients hear each other through it. Nobody is found by multicast or gossip.
"""

from __future__ import annotations

from bus.transports.zenoh.config import client_config, hub_config
from bus.transports.zenoh.endpoint import ZenohEndpoint
from bus.transports.zenoh.identity import Certificate, Gate, Identity, Password
from bus.transports.zenoh.opening import open_client, open_hub

__all__ = [
    "Certificate",
    "Gate",
    "Identity",
    "Password",
    "ZenohEndpoint",
    "client_config",
    "hub_config",
    "open_client",
    "open_hub",
]
