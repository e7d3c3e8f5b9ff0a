"""Requests to a running plant and its responses, over Zenoh's queries."""

from __future__ import annotations

from typing import Any, Final, cast, final

import zenoh
from zenoh import handlers  # pyright: ignore[reportMissingModuleSource] - its source is the binary

from bus.errors import TransportError
from bus.transports.zenoh.endpoint import ZenohEndpoint
from bus.transports.zenoh.session import first_line

REQUEST_LIMIT: Final = 65_536
"""Longest request and response, bytes."""
_WAITING: Final = 64
"""Most requests that wait for the next tick; beyond, the oldest get no response."""


class NoResponderError(TransportError):
    """Nobody takes requests on a key."""


@final
class IncomingRequest:
    """One request.

    Attributes:
        payload: At most ``REQUEST_LIMIT`` bytes; None: it was longer.
    """

    def __init__(self, query: zenoh.Query) -> None:
        self._query = query
        payload = query.payload
        self.payload: bytes | None = b"" if payload is None else None
        if payload is not None and len(payload) <= REQUEST_LIMIT:
            self.payload = payload.to_bytes()

    def answer(self, payload: bytes) -> None:
        """Send the response, once; the client may have disconnected."""
        try:
            cast("Any", self._query).reply(self._query.key_expr, payload)
            cast("Any", self._query).drop()
        except zenoh.ZError:
            pass


@final
class RequestQueue:
    """Queue of requests on a key.

    Requests wait in a ring, so that a client with too many requests does not delay the run's own messages.

    Args:
        endpoint: Endpoint of the plant.
        key: Key of the requests.
    """

    def __init__(self, endpoint: ZenohEndpoint, key: str) -> None:
        endpoint.check_usable()
        ring = cast("Any", handlers.RingChannel)(_WAITING)
        self._queryable = cast("Any", endpoint.session).declare_queryable(key, ring)

    def drain(self) -> IncomingRequest | None:
        """Return the oldest waiting request; None if there is none."""
        query = self._queryable.try_recv()
        return None if query is None else IncomingRequest(query)

    def close(self) -> None:
        """Stop accepting requests; waiting ones get no answer."""
        self._queryable.undeclare()


def send_request(endpoint: ZenohEndpoint, key: str, payload: bytes, timeout_s: float) -> bytes:
    """Send a request and wait for the response.

    Raises:
        NoResponderError: Nobody takes requests on that key, or not yet.
        TransportError: No response on that key in time.
    """
    endpoint.check_usable()
    try:
        replies = cast("Any", endpoint.session).get(key, payload=payload, timeout=timeout_s)
        for reply in replies:
            if reply.ok is not None:
                return cast("bytes", reply.ok.payload.to_bytes())
            raise TransportError(f"no answer within {timeout_s:g} s: {reply.err.payload.to_string()}")
    except zenoh.ZError as error:
        raise TransportError(f"ask {key}: {first_line(error)}") from None
    raise NoResponderError("no run answers at this endpoint")
