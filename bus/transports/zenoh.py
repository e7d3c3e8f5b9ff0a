"""The transport between processes: Zenoh over TCP, loopback unless told otherwise.

The plant's session is a peer that listens on one endpoint (``open_hub``); every cell process is a client of
it (``open_client``), and clients hear each other through it. Nobody is found by multicast or gossip.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import functools
import os
import socket
import threading
import weakref
from collections.abc import Callable, Iterable
from typing import Any, Final, cast, final

import zenoh
from zenoh import handlers  # pyright: ignore[reportMissingModuleSource] - its source is the binary

from bus.errors import TransportError
from bus.inbox import Inbox
from bus.transport import Alive, Endpoint, Event, Haste, Publisher, Received, Woken
from bus.transports.memory import check_overlap

LEASE_S: Final = 2.0
"""Silence after which the other side takes a process for gone; each session's own lease governs its token."""
CLOSE_S: Final = 2.0
_CAPACITY: Final = 65_536
"""Quiet payloads that wait for a reader; beyond it their senders do."""
_PORT_ATTEMPTS: Final = 20
_RUNTIME: Final = (
    "(app: (worker_threads: 1), acc: (worker_threads: 1), tx: (worker_threads: 1), "
    "rx: (worker_threads: 1), net: (worker_threads: 1))"
)


_forks = 0
_open_endpoints: weakref.WeakSet[ZenohEndpoint] = weakref.WeakSet()
_held: set[int] = set()
"""Receiving threads that keep their Python state."""


def _count_fork() -> None:
    global _forks  # noqa: PLW0603 - one process, one count
    _forks += 1
    _held.clear()  # those threads are not in this process


def _close_all() -> None:
    for endpoint in list(_open_endpoints):
        endpoint.close()


os.register_at_fork(after_in_child=_count_fork)
# A session that is dropped as the interpreter ends, while samples come in, hangs for ten seconds and then panics.
atexit.register(_close_all)


def _keep_state(put: Callable[[zenoh.Sample], None]) -> Callable[[zenoh.Sample], None]:
    """``put``, and what makes it and others cheap for Zenoh's own threads, which call it.

    CPython gives a thread that it did not start a new state, and that state new memory pages, for every call into
    Python: a page fault and about 40 µs a sample. One hold that is never released lets the thread keep the
    state of its first call. There are few such threads and they live as long as the process.
    """
    hold = ctypes.pythonapi.PyGILState_Ensure

    def call(sample: zenoh.Sample) -> None:
        thread = threading.get_ident()
        if thread not in _held:
            _held.add(thread)
            hold()
        put(sample)

    return call


def hub_config(listen: str, lease_s: float = LEASE_S) -> zenoh.Config:
    """Settings of the plant's session.

    Args:
        listen: Endpoint such as ``tcp/127.0.0.1:7447``.
        lease_s: Seconds of silence after which the others take the plant for gone.
    """
    config = _config("peer", lease_s)
    _set(config, "listen/endpoints", f'["{listen}"]')
    _set(config, "listen/exit_on_failure", "true")
    # Shared memory is off in every session: with it a hub stops near 350 sessions.
    _set(config, "transport/unicast/max_sessions", "20000")
    _set(config, "transport/unicast/accept_pending", "2000")
    return config


def client_config(connect: str, lease_s: float = LEASE_S, timeout_s: float = 10.0) -> zenoh.Config:
    """Settings of a cell process.

    Args:
        connect: The plant's endpoint.
        lease_s: Seconds of silence after which the plant takes this process for gone.
        timeout_s: Seconds to go on trying while nobody listens there.
    """
    config = _config("client", lease_s)
    _set(config, "connect/endpoints", f'["{connect}"]')
    _set(config, "connect/timeout_ms", str(round(timeout_s * 1000)))
    _set(config, "connect/exit_on_failure", "true")
    _set(config, "connect/retry", "{period_init_ms: 20, period_max_ms: 200, period_increase_factor: 2}")
    _set(config, "listen/endpoints", "[]")
    return config


def _config(mode: str, lease_s: float) -> zenoh.Config:
    config = zenoh.Config()
    _set(config, "mode", f'"{mode}"')
    _set(config, "scouting/multicast/enabled", "false")
    _set(config, "scouting/gossip/enabled", "false")
    _set(config, "transport/shared_memory/enabled", "false")
    # One queue a link: with priorities a token's withdrawal overtakes the data put before it.
    _set(config, "transport/unicast/qos/enabled", "false")
    _set(config, "transport/link/tx/lease", str(round(lease_s * 1000)))
    _set(config, "open/return_conditions/connect_scouted", "false")
    return config


def _set(config: zenoh.Config, key: str, json: str) -> None:
    try:
        cast("Any", config).insert_json5(key, json)
    except zenoh.ZError as error:
        raise TransportError(f"Zenoh refuses {key} = {json}: {_first_line(error)}") from None


def open_hub(listen: str | None = None, *, lease_s: float = LEASE_S) -> ZenohEndpoint:
    """Opens the plant's session.

    Args:
        listen: Endpoint to listen on; None: a free loopback port.
        lease_s: See ``hub_config``.

    Returns:
        The endpoint; its ``locator`` is what clients connect to.

    Raises:
        TransportError: The port is in use, or the endpoint makes no sense.
    """
    if listen is not None:
        return ZenohEndpoint(_open(hub_config(listen, lease_s), f"listen on {listen}"), listen)
    for attempt in range(1, _PORT_ATTEMPTS + 1):
        locator = f"tcp/127.0.0.1:{_free_port()}"
        try:
            session = _open(hub_config(locator, lease_s), f"listen on {locator}")
        except TransportError:
            # Somebody took the port between our look and Zenoh's; another is as good.
            if attempt == _PORT_ATTEMPTS:
                raise
        else:
            return ZenohEndpoint(session, locator)
    raise AssertionError("unreachable: this is a bug")


def open_client(connect: str, *, lease_s: float = LEASE_S, timeout_s: float = 10.0) -> ZenohEndpoint:
    """Opens a cell process's session; call it after a fork, never before.

    Raises:
        TransportError: Nobody listens there within ``timeout_s``.
    """
    # A cell process has little to do: one thread a pool is faster than many. Read once, at the first session.
    os.environ.setdefault("ZENOH_RUNTIME", _RUNTIME)
    config = client_config(connect, lease_s, timeout_s)
    return ZenohEndpoint(_open(config, f"connect to {connect}"), connect)


def _open(config: zenoh.Config, attempted: str) -> zenoh.Session:
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        text = str(error)
        if "in use" in text:
            raise TransportError(f"{attempted}: the port is in use") from None
        if attempted.startswith("connect"):
            raise TransportError(f"{attempted}: nobody answers ({_first_line(error)})") from None
        raise TransportError(f"{attempted}: {_first_line(error)}") from None


def _first_line(error: BaseException) -> str:
    lines = str(error).splitlines()
    return lines[0] if lines else type(error).__name__


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return cast("int", probe.getsockname()[1])


_received = cast("Callable[[tuple[str, bytes]], Received]", functools.partial(tuple.__new__, Received))
"""As ``Received`` does, without a call into Python."""


def _event(item: Any) -> Event:
    return _received((str(item.key_expr), item.payload.to_bytes())) if type(item) is zenoh.Sample else item


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

    Zenoh's receiving threads put samples straight into the inbox: no thread a subscriber, and unlike the wait
    on one of Zenoh's channels, this one covers all subscriptions, can time out and lets signals through.

    Attributes:
        locator: Where the plant listens.
        closed: Whether ``close`` was called.
        session: The session, for what Zenoh has beyond an endpoint.
    """

    def __init__(self, session: zenoh.Session, locator: str) -> None:
        self.locator = locator
        self.session = session
        self._pid = os.getpid()
        self._forks = _forks
        self.closed = False
        self._inbox = Inbox()
        _open_endpoints.add(self)
        self._subscribers: dict[str, object] = {}
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
        self.check_usable()
        publisher: Publisher | None = None
        try:
            for publisher, payload in puts:
                cast("ZenohPublisher", publisher).put_bytes(payload)
        except zenoh.ZError as error:
            raise TransportError(f"{publisher}: {_first_line(error)}") from None

    def subscribe(self, key_expr: str, haste: Haste = "wake") -> None:
        """Lets everything put on matching keys into the inbox."""
        self.check_usable()
        if key_expr in self._subscribers:
            return
        check_overlap(key_expr, list(self._subscribers))
        self._subscribers[key_expr] = subscriber = self.session.declare_subscriber(
            key_expr, self._handler(haste)
        )
        if haste == "quiet":
            self._inbox.quiet.append(subscriber.handler.try_recv)

    def _handler(self, haste: Haste) -> Any:
        if haste == "quiet":
            return handlers.FifoChannel(_CAPACITY)
        if haste == "urgent":
            put = _keep_state(lambda sample: self._inbox.put_urgent(_event(sample)))
        else:
            # One subscription that sees to it that threads keep their state does so for all.
            put = self._inbox.put if self._subscribers else _keep_state(self._inbox.put)
        return handlers.Callback(put, indirect=False)

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
        put = self._inbox.put_urgent

        def tell(sample: zenoh.Sample) -> None:
            put(Alive(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT))

        self._watchers.append(
            self.session.liveliness().declare_subscriber(
                key_expr, handlers.Callback(tell, indirect=False), history=True
            )
        )

    def receive(self, timeout_s: float | None, enough: int = 1) -> Event | None:
        """The oldest event, or None after ``timeout_s``."""
        self.check_usable()
        item = self._inbox.get(timeout_s, enough)
        return None if item is None else _event(item)

    def receive_all(self, timeout_s: float | None, enough: int = 1) -> list[Event]:
        """All events, oldest first."""
        self.check_usable()
        return [_event(item) for item in self._inbox.get_all(timeout_s, enough)]

    def wake(self) -> None:
        """Puts one ``Woken`` in the inbox."""
        self._inbox.put_urgent(Woken())

    def close(self) -> None:
        """Withdraws everything and leaves."""
        if self.closed:
            return
        self.closed = True
        if self._forks != _forks:
            return
        # Zenoh's close has been seen to hang; nothing that we started may keep a process from ending.
        closer = threading.Thread(target=self._close, name="zenoh-close", daemon=True)
        closer.start()
        closer.join(CLOSE_S)
        if closer.is_alive():
            # Dropping the session would wait for the same again: never drop it.
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(self.session))

    def _close(self) -> None:
        for token in self._tokens.values():
            with contextlib.suppress(zenoh.ZError):  # The session may be gone already.
                cast("Any", token).undeclare()
        cast("Any", self.session).close()

    def check_usable(self) -> None:
        """Raises TransportError after ``close``, and in a process that inherited this session by a fork."""
        if not self.closed and self._forks == _forks:
            return
        if self.closed:
            raise TransportError("this endpoint is closed")
        raise TransportError(
            f"this session was opened in process {self._pid}: a forked process must open its own"
        )
