"""Takes events out of an endpoint's inbox to where they belong."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, final

from bus.counts import Counts
from bus.errors import WireError, WokenError
from bus.keys import owner_of
from bus.transport import Alive, Endpoint, Received

BATCH: Final = 64
"""Payloads for which a side sleeps at most before it begins to read them."""

Route = tuple[Callable[[int, bytes], None], int]
"""What takes the payloads of a key, and which part they are for it."""


@final
class Dispatcher:
    """Reads what comes for one side of a run.

    Args:
        endpoint: Where from.
        counts: Where refused payloads are counted.
        tokens: What takes the coming and going of tokens.

    Attributes:
        routes: For each key, what takes its payloads; may raise WireError.
    """

    def __init__(self, endpoint: Endpoint, counts: Counts, tokens: Callable[[Alive], None]) -> None:
        self.routes: dict[str, Route] = {}
        self._receive = endpoint.receive_all
        self._counts = counts
        self._tokens = tokens

    def read(self, timeout_s: float | None, enough: int = 1) -> bool:
        """Waits as ``Endpoint.receive`` does, then takes all there is; False if there was nothing in time.

        Raises:
            WokenError: ``Endpoint.wake`` was called; everything else that was there has been taken.
        """
        events = self._receive(timeout_s, min(enough, BATCH))
        woken = False
        for event in events:
            if type(event) is Received:
                take, part = self.routes.get(event.key, _NOWHERE)
                try:
                    take(part, event.payload)
                except WireError as error:
                    # A stranger may invent keys without end; they are one.
                    known = take is not _refuse
                    self._counts.refuse(error, owner_of(event.key) if known else "nobody")
            elif type(event) is Alive:
                self._tokens(event)
            else:
                woken = True
        if woken:
            raise WokenError("woken while waiting for the others")
        return bool(events)


def _refuse(part: int, payload: bytes) -> None:  # noqa: ARG001 - as every route
    raise WireError("bus", "key", "no part of this run sends on such a key")


_NOWHERE: Final[Route] = (_refuse, 0)
