"""Requests to a running plant and its responses, over Zenoh's queries."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Mapping
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
_POLL_S: Final = 0.05
"""Interval at which a responder looks for requests, wall seconds."""


class NoResponderError(TransportError):
    """Nobody takes requests on a key."""


@final
class IncomingRequest:
    """One request.

    Attributes:
        key: Key that was asked.
        payload: At most ``REQUEST_LIMIT`` bytes; None: it was longer.
    """

    def __init__(self, query: zenoh.Query) -> None:
        self._query = query
        self.key = str(query.key_expr)
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
        key: Key of the requests, or an expression.
        *endpoints: Endpoints of the plant at which requests are taken.
    """

    def __init__(self, key: str, *endpoints: ZenohEndpoint) -> None:
        self._queryables: list[Any] = []
        for endpoint in endpoints:
            endpoint.check_usable()
            ring = cast("Any", handlers.RingChannel)(_WAITING)
            self._queryables.append(cast("Any", endpoint.session).declare_queryable(key, ring))

    def drain(self) -> IncomingRequest | None:
        """Return the oldest waiting request; None if there is none."""
        for queryable in self._queryables:
            query = queryable.try_recv()
            if query is not None:
                return IncomingRequest(query)
        return None

    def close(self) -> None:
        """Stop accepting requests; waiting ones get no answer."""
        for queryable in self._queryables:
            queryable.undeclare()


Answer = Callable[[IncomingRequest], bytes]


@final
class Responder:
    """Thread that answers requests at any time, until ``close``.

    Args:
        answers: By queue, the function that returns the answer to a request.
    """

    def __init__(self, answers: Mapping[RequestQueue, Answer]) -> None:
        self._answers = dict(answers)
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._work, name="responder", daemon=True)
        self._thread.start()

    def _work(self) -> None:
        with contextlib.suppress(zenoh.ZError):  # the session was closed
            while not self._closed.wait(_POLL_S):
                for queue, answer in self._answers.items():
                    while (request := queue.drain()) is not None:
                        request.answer(answer(request))

    def close(self) -> None:
        """Stop answering."""
        self._closed.set()
        self._thread.join()
        with contextlib.suppress(zenoh.ZError):
            for queue in self._answers:
                queue.close()


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


def tokens_at(endpoint: ZenohEndpoint, key_expr: str, timeout_s: float) -> set[str]:
    """Return the keys of the liveliness tokens that are there now.

    Raises:
        TransportError: The session is closed.
    """
    endpoint.check_usable()
    try:
        replies = cast("Any", endpoint.session.liveliness()).get(key_expr, timeout=timeout_s)
        return {str(reply.ok.key_expr) for reply in replies if reply.ok is not None}
    except zenoh.ZError as error:
        raise TransportError(f"tokens {key_expr}: {first_line(error)}") from None
