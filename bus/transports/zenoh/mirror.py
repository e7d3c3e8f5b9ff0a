"""Mirror of a run's messages for subscribers outside the run, which can't delay the run.

Cells and plant exchange messages over sessions of their own, which block rather than drop. Listeners and operators
connect to another session. A thread copies messages of a kind there while somebody subscribes to that kind: from
rings on the run's side, which lose their oldest message when full, with puts that are dropped where a listener's
link is full. Nothing goes the other way but operators' questions (``questions``).
"""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple, cast, final

import zenoh
from zenoh import handlers  # pyright: ignore[reportMissingModuleSource] - its source is the binary

from bus.errors import TransportError
from bus.transports.zenoh.endpoint import CLOSE_S, ZenohEndpoint

_ROUND_S: Final = 0.002
"""Polling interval of the rings while there is a subscriber, wall seconds."""


class _Token(NamedTuple):
    """News of a liveliness token of the run."""

    key: str
    present: bool


class _Demand(NamedTuple):
    """News that a kind of message has a subscriber, or has none any more."""

    key_expr: str
    wanted: bool


_News = _Token | _Demand | None
"""None: the end."""


@final
class Mirror:
    """Copies messages and liveliness tokens of a run from its hub to a session for listeners, until ``close``.

    Args:
        hub: Endpoint of the run's own session.
        outside: Endpoint of the session that listeners connect to. The mirror closes it.
        kinds: Key expression of each kind of message, with the messages of that kind that may wait to be copied.
        tokens: Key expression of the tokens.

    Attributes:
        outside: As given.
    """

    def __init__(
        self, hub: ZenohEndpoint, outside: ZenohEndpoint, kinds: Mapping[str, int], tokens: str
    ) -> None:
        self._hub = hub
        self.outside = outside
        self._kinds = dict(kinds)
        self._news: queue.SimpleQueue[_News] = queue.SimpleQueue()
        self._rings: dict[str, Any] = {}
        self._shown: set[str] = set()
        # Publishers of whole kinds put nothing: Zenoh says by them whether somebody subscribes.
        self._demand = [outside.session.declare_publisher(key_expr) for key_expr in kinds]
        self._listeners = [
            cast("Any", publisher).declare_matching_listener(_handler(self._demanded(key_expr)))
            for publisher, key_expr in zip(self._demand, kinds, strict=True)
        ]
        self._tokens = hub.session.liveliness().declare_subscriber(
            tokens, _handler(self._token), history=True
        )
        self._thread = threading.Thread(target=self._work, name="mirror", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Copy what is left, and close the listeners' session."""
        self._news.put(None)
        self._thread.join(CLOSE_S)
        self.outside.close()

    # --- news, in Zenoh's threads -----------------------------------------------------------------

    def _demanded(self, key_expr: str) -> Callable[[zenoh.MatchingStatus], None]:
        return lambda status: self._news.put(_Demand(key_expr, status.matching))

    def _token(self, sample: zenoh.Sample) -> None:
        self._news.put(_Token(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT))

    # --- the mirror's thread ----------------------------------------------------------------------

    def _work(self) -> None:
        with contextlib.suppress(zenoh.ZError, TransportError):  # A session was closed: the run is over.
            while self._take_news():
                self._copy()
            self._copy()
            for key_expr in list(self._rings):
                self._rings.pop(key_expr).undeclare()

    def _take_news(self) -> bool:
        """Wait for news, or for the next look at the rings; False at the end."""
        timeout_s = _ROUND_S if self._rings else None
        while True:
            try:
                news = self._news.get(timeout=timeout_s)
            except queue.Empty:
                return True
            if news is None:
                return False
            if isinstance(news, _Token):
                self._show(news)
            else:
                self._tap(news)
            timeout_s = 0.0

    def _show(self, token: _Token) -> None:
        # The same presence may be told twice.
        if token.present and token.key not in self._shown:
            self._shown.add(token.key)
            self.outside.declare_alive(token.key)
        elif not token.present and token.key in self._shown:
            self._shown.remove(token.key)
            self.outside.withdraw(token.key)

    def _tap(self, demand: _Demand) -> None:
        key_expr = demand.key_expr
        if demand.wanted and key_expr not in self._rings:
            ring = cast("Any", handlers.RingChannel)(self._kinds[key_expr])
            self._rings[key_expr] = self._hub.session.declare_subscriber(key_expr, ring)
        elif not demand.wanted and key_expr in self._rings:
            self._rings.pop(key_expr).undeclare()

    def _copy(self) -> None:
        """Copy the messages that have come; of each kind no more than its ring holds."""
        put = cast("Any", self.outside.session).put
        for key_expr, waiting in self._kinds.items():
            if key_expr not in self._rings:
                continue
            try_recv = self._rings[key_expr].try_recv
            for _ in range(waiting):
                if (sample := try_recv()) is None:
                    break
                # Endpoints of the run wake themselves by deletions.
                if sample.kind == zenoh.SampleKind.PUT:
                    put(sample.key_expr, sample.payload, congestion_control=zenoh.CongestionControl.DROP)


def _handler(call: Callable[[Any], None]) -> handlers.Callback[Any]:
    return handlers.Callback(call, indirect=False)
