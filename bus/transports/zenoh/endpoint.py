"""A Zenoh session as an endpoint."""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import os
import threading
import weakref
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, Final, cast, final

import zenoh

from bus.errors import TransportError
from bus.transport import Alive, Endpoint, Event, Haste, Publisher, Woken
from bus.transports.memory import check_overlap
from bus.transports.zenoh.config import first_line
from bus.transports.zenoh.mail import Mail

if TYPE_CHECKING:
    from bus.transports.zenoh.refusals import Watch

CLOSE_S: Final = 2.0


_forks = 0
_open_endpoints: weakref.WeakSet[ZenohEndpoint] = weakref.WeakSet()


def _count_fork() -> None:
    global _forks  # noqa: PLW0603 - one process, one count
    _forks += 1


def _close_all() -> None:
    for endpoint in list(_open_endpoints):
        endpoint.close()


os.register_at_fork(after_in_child=_count_fork)
# A session that is dropped as the interpreter ends, while samples come in, hangs for ten seconds and then panics.
atexit.register(_close_all)


def _token(sample: zenoh.Sample) -> Alive:
    return Alive(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)


@final
class ZenohPublisher(Publisher):
    """Puts on one key: blocking, reliable, batched.

    Attributes:
        put_bytes: Zenoh's own put.
    """

    def __init__(self, endpoint: ZenohEndpoint, publisher: zenoh.Publisher) -> None:
        self._endpoint = endpoint
        self._publisher = publisher
        self.put_bytes = cast("Callable[[bytes], None]", cast("Any", publisher).put)

    def put(self, payload: bytes) -> None:
        """Sends ``payload`` to every subscriber of the key."""
        self._endpoint.put_all(((self, payload),))

    def matched(self) -> bool:
        """Whether somebody subscribed to the key."""
        self._endpoint.check_usable()
        # matching_status is an object that is always true.
        status = cast("zenoh.MatchingStatus", self._publisher.matching_status)
        return status.matching


@final
class ZenohEndpoint(Endpoint):
    """A Zenoh session; made by ``open_hub`` and ``open_client``.

    Attributes:
        locator: Where the plant listens.
        listening: Addresses that this session listens on, as Zenoh has them; none at a client.
        closed: Whether ``close`` was called.
        session: The session, for what Zenoh has beyond an endpoint.
        refusals: What Zenoh refuses, where it has been told whom to let in.
    """

    def __init__(
        self,
        session: zenoh.Session,
        locator: str,
        refusals: Watch | None = None,
        listening: tuple[str, ...] = (),
    ) -> None:
        super().__init__()
        self.listening = listening
        self.refusals = refusals
        if refusals is not None:
            refusals.names.append(self.role)
        self.locator = locator
        self.session = session
        self._pid = os.getpid()
        self._forks = _forks
        self.closed = False
        self._mail = Mail(session)
        _open_endpoints.add(self)
        self._subscribed: list[str] = []
        self._watchers: list[object] = []
        self._tokens: dict[str, zenoh.LivelinessToken] = {}

    def publisher(self, key: str) -> Publisher:
        """A publisher on one key."""
        self.check_usable()
        return ZenohPublisher(
            self,
            self.session.declare_publisher(
                key,
                congestion_control=zenoh.CongestionControl.BLOCK,
                reliability=zenoh.Reliability.RELIABLE,
                express=False,
            ),
        )

    def put_all(self, puts: Iterable[tuple[Publisher, bytes]]) -> None:
        """Puts each payload with its publisher."""
        if self.closed or self._forks != _forks:
            self.check_usable()
        try:
            for publisher, payload in cast("Iterable[tuple[ZenohPublisher, bytes]]", puts):
                publisher.put_bytes(payload)
        except zenoh.ZError as error:
            raise TransportError(f"put: {first_line(error)}") from None

    def subscribe(self, key_expr: str, haste: Haste = "wake") -> None:
        """Lets everything put on matching keys into the inbox."""
        self.check_usable()
        if key_expr in self._subscribed:
            return
        check_overlap(key_expr, self._subscribed)
        self._mail.subscribe(key_expr, haste)
        self._subscribed.append(key_expr)

    def declare_alive(self, key: str) -> None:
        """Shows a token."""
        self.check_usable()
        if key in self._tokens:
            raise TransportError(f"token {key} is declared already")
        # Kept: a token without a reference is withdrawn at once.
        self._tokens[key] = self.session.liveliness().declare_token(key)

    def withdraw(self, key: str) -> None:
        """Takes a token back."""
        self.check_usable()
        token = self._tokens.pop(key, None)
        if token is not None:
            cast("Any", token).undeclare()

    def watch_alive(self, key_expr: str) -> None:
        """Lets the coming and going of matching tokens into the inbox."""
        self.check_usable()
        watcher = self.session.liveliness().declare_subscriber(
            key_expr, self._mail.teller(_token), history=True
        )
        self._watchers.append(watcher)

    def take(self, timeout_s: float | None, enough: int) -> list[Event]:
        """All events; a wait of more than a tenth of a second may end as much later."""
        if self.closed or self._forks != _forks:
            self.check_usable()
        return self._mail.take(timeout_s, enough)

    def wake(self) -> None:
        """Puts one ``Woken`` in the inbox."""
        self._mail.tell(Woken())

    def role(self, session: str) -> str | None:
        """What the certificate says of the session whose identifier begins like this, if it is connected."""
        links = self.session.info.links()
        return next((link.auth_identifier for link in links if str(link.zid).startswith(session)), None)

    def close(self) -> None:
        """Withdraws everything and leaves."""
        if self.closed:
            return
        self.closed = True
        self._mail.close()
        if self._forks != _forks:
            return
        # Zenoh's close has been seen to hang; nothing that we started may keep a process from ending.
        closer = threading.Thread(target=self._close, name="zenoh-close", daemon=True)
        closer.start()
        closer.join(CLOSE_S)
        if closer.is_alive():
            # Dropping the session would wait for the same again: never drop it.
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(self.session))
        if self.refusals is not None:
            self.refusals.close()

    def _close(self) -> None:
        for token in self._tokens.values():
            with contextlib.suppress(zenoh.ZError):  # The session may be gone already.
                cast("Any", token).undeclare()
        cast("Any", self.session).close()

    def check_usable(self) -> None:
        """Raises TransportError after ``close``, and in a process that inherited this session by a fork.

        What runs every tick looks itself before it calls this.
        """
        if not self.closed and self._forks == _forks:
            return
        if self.closed:
            raise TransportError("this endpoint is closed")
        raise TransportError(
            f"this session was opened in process {self._pid}: a forked process must open its own"
        )
