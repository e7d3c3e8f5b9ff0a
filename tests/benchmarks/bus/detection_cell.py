"""What the processes of ``detection.py`` do: show a token, and wait."""

from __future__ import annotations

from dataclasses import dataclass

KEY = "detection/{}/alive"


@dataclass(frozen=True)
class Cell:
    """A process's whole life: called with its number.

    Attributes:
        connect: Where to.
        lease_s: Its lease.
    """

    connect: str
    lease_s: float

    def __call__(self, number: int) -> None:
        """Never returns: it is killed."""
        from bus.transports.zenoh import open_client

        endpoint = open_client(self.connect, lease_s=self.lease_s)
        endpoint.declare_alive(KEY.format(number))
        endpoint.receive(None)
