"""Questions to the plant and its answers, over Zenoh's queries: how somebody outside speaks to a run."""

from __future__ import annotations

from typing import Any, Final, cast, final

import zenoh
from zenoh import handlers  # pyright: ignore[reportMissingModuleSource] - its source is the binary

from bus.errors import TransportError
from bus.transports.zenoh.endpoint import ZenohEndpoint
from bus.transports.zenoh.session import first_line

REQUEST_LIMIT: Final = 65_536
"""Longest question and answer, bytes."""
_WAITING: Final = 64
"""Questions that may wait for the next tick; of more the oldest get no answer."""


@final
class IncomingRequest:
    """One question.

    Attributes:
        payload: What is asked, at most ``REQUEST_LIMIT`` bytes; None: it was longer.
    """

    def __init__(self, query: zenoh.Query) -> None:
        self._query = query
        payload = query.payload
        self.payload: bytes | None = b"" if payload is None else None
        if payload is not None and len(payload) <= REQUEST_LIMIT:
            self.payload = payload.to_bytes()

    def answer(self, payload: bytes) -> None:
        """Answer it, once; whoever asked may have gone."""
        try:
            cast("Any", self._query).reply(self._query.key_expr, payload)
            cast("Any", self._query).drop()
        except zenoh.ZError:
            pass


@final
class RequestQueue:
    """The questions that come in on a key.

    They wait in a ring, so that nobody who asks too much makes the run's own messages wait.

    Args:
        endpoint: Of the plant.
        key: Where they are asked.
    """

    def __init__(self, endpoint: ZenohEndpoint, key: str) -> None:
        endpoint.check_usable()
        ring = cast("Any", handlers.RingChannel)(_WAITING)
        self._queryable = cast("Any", endpoint.session).declare_queryable(key, ring)

    def drain(self) -> IncomingRequest | None:
        """The oldest that waits; None where none does."""
        query = self._queryable.try_recv()
        return None if query is None else IncomingRequest(query)

    def close(self) -> None:
        """Stop accepting requests; waiting ones get no answer."""
        self._queryable.undeclare()


def send_request(endpoint: ZenohEndpoint, key: str, payload: bytes, timeout_s: float) -> bytes:
    """Ask, and wait for the answer.

    Raises:
        TransportError: Nobody answers on that key, or not in time.
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
    raise TransportError("no run answers there")
