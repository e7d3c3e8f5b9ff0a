"""A Zenoh session as an endpoint."""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import json
import os
import socket
import threading
import weakref
from collections.abc import Callable, Generator, Iterable, Sequence
from typing import TYPE_CHECKING, Any, Final, cast, final

import zenoh

from bus.errors import TransportError
from bus.transports.base import Endpoint, Event, LivelinessChange, Publisher, Received, Urgency, Wakeup
from bus.transports.memory import check_overlap
from bus.transports.zenoh.linger import LingerReset, tcp_ports
from bus.transports.zenoh.receive import ReceiveQueue
from bus.transports.zenoh.session import (
    LEASE_S,
    PROTOCOL,
    AccessPolicy,
    Identity,
    client_config,
    first_line,
    hub_config,
    mirror_config,
    router_config,
)

if TYPE_CHECKING:
    from bus.transports.zenoh.access_log import AccessLogMonitor


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


def _token(sample: zenoh.Sample) -> LivelinessChange:
    return LivelinessChange(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)


@final
class ZenohPublisher(Publisher):
    """Publisher on one key: blocking, reliable, batched.

    Attributes:
        put_bytes: Zenoh's own put.
    """

    def __init__(self, endpoint: ZenohEndpoint, publisher: zenoh.Publisher) -> None:
        self._endpoint = endpoint
        self._publisher = publisher
        self.put_bytes = cast("Callable[[bytes], None]", cast("Any", publisher).put)

    def put(self, payload: bytes) -> None:
        """Send ``payload`` to every subscriber of the key."""
        endpoint = self._endpoint
        if endpoint.closed or endpoint.forks != _forks:
            endpoint.check_usable()
        try:
            self.put_bytes(payload)
        except zenoh.ZError as error:
            raise TransportError(f"put: {first_line(error)}") from None

    def matched(self) -> bool:
        """Whether the key has a subscriber."""
        self._endpoint.check_usable()
        # matching_status is an object that is always true.
        status = cast("zenoh.MatchingStatus", self._publisher.matching_status)
        return status.matching


@final
class ZenohEndpoint(Endpoint):
    """A Zenoh session; made by ``open_hub`` and ``open_client``.

    Attributes:
        locator: Address where the plant listens.
        listening: Addresses that this session listens on, as Zenoh has them; none at a client.
        closed: Whether ``close`` was called.
        forks: Forks of this process before the session was opened.
        session: The session, for what Zenoh has beyond an endpoint.
        refusals: Counter of denials; None without an access policy.
    """

    def __init__(
        self,
        session: zenoh.Session,
        locator: str,
        refusals: AccessLogMonitor | None = None,
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
        self.forks = _forks
        self.closed = False
        self._mail = ReceiveQueue(session)
        _open_endpoints.add(self)
        self._subscribed: list[str] = []
        self._watchers: list[object] = []
        self._tokens: dict[str, zenoh.LivelinessToken] = {}
        self._linger = LingerReset(tcp_ports(listening))

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
        """Put each payload with its publisher."""
        if self.closed or self.forks != _forks:
            self.check_usable()
        try:
            for publisher, payload in cast("Iterable[tuple[ZenohPublisher, bytes]]", puts):
                publisher.put_bytes(payload)
        except zenoh.ZError as error:
            raise TransportError(f"put: {first_line(error)}") from None

    def subscribe(self, key_expr: str, haste: Urgency = "wake", *, direct: bool = False) -> None:
        """Subscribe to matching keys."""
        self.check_usable()
        if key_expr in self._subscribed:
            return
        check_overlap(key_expr, self._subscribed)
        self._mail.subscribe(key_expr, haste, direct)
        self._subscribed.append(key_expr)

    def declare_alive(self, key: str) -> None:
        """Declare a token."""
        self.check_usable()
        if key in self._tokens:
            raise TransportError(f"token {key} is declared already")
        # Kept: a token without a reference is withdrawn at once.
        self._tokens[key] = self.session.liveliness().declare_token(key)

    def withdraw(self, key: str) -> None:
        """Withdraw a token."""
        self.check_usable()
        token = self._tokens.pop(key, None)
        if token is not None:
            cast("Any", token).undeclare()

    def watch_alive(self, key_expr: str) -> None:
        """Watch matching tokens."""
        self.check_usable()
        watcher = self.session.liveliness().declare_subscriber(
            key_expr, self._mail.enqueuer(_token), history=True
        )
        self._watchers.append(watcher)

    def receive_all(
        self, timeout_s: float | None, enough: int = 1, quiet_key: str | None = None
    ) -> list[Event]:
        """All events; a wait of more than a tenth of a second may end as much later."""
        if self.closed or self.forks != _forks:
            self.check_usable()
        rest, self._rest = self._rest, []
        return rest + self._mail.poll_all(0 if rest else timeout_s, enough, quiet_key)

    def receive_payload(self, key: str) -> bytes | None:
        """Wait for an event, and return the payload of ``key`` if nothing else is there."""
        if self.closed or self.forks != _forks:
            self.check_usable()
        mail = self._mail
        if self._rest or not mail.has_one_source(key):
            return super().receive_payload(key)
        payload = mail.next_payload()
        if payload is not None and mail.has_news():
            self._rest = [Received(key, payload)]
            return None
        return payload

    def answer_payloads(self, key: str, answer: Callable[[bytes], bool]) -> None:
        """Have ``answer`` take payloads of ``key`` as they come, in Zenoh's thread if they are subscribed to so."""
        if self.closed or self.forks != _forks:
            self.check_usable()
        mail = self._mail
        if self._rest or not mail.has_one_source(key) or not mail.answer_payloads(answer):
            super().answer_payloads(key, answer)

    def wake(self) -> None:
        """Put one ``Wakeup`` in the inbox."""
        self._mail.enqueue(Wakeup())

    def role(self, session: str) -> str | None:
        """Return the certificate's name of the session whose identifier begins with ``session``; None if unknown."""
        links = self.session.info.links()
        return next((link.auth_identifier for link in links if str(link.zid).startswith(session)), None)

    def close(self) -> None:
        """Withdraw all tokens and close the session."""
        if self.closed:
            return
        self.closed = True
        self._mail.close()
        if self.forks != _forks:
            return
        # Zenoh's close has been seen to hang; nothing that we started may keep a process from ending.
        closer = threading.Thread(target=self._close, name="zenoh-close", daemon=True)
        closer.start()
        closer.join(CLOSE_S)
        if closer.is_alive():
            # Dropping the session would wait for the same again: never drop it.
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(self.session))
        self._linger.close()
        if self.refusals is not None:
            self.refusals.close()

    def _close(self) -> None:
        for token in self._tokens.values():
            with contextlib.suppress(zenoh.ZError):  # The session may be gone already.
                cast("Any", token).undeclare()
        cast("Any", self.session).close()

    def check_usable(self) -> None:
        """Raise TransportError after ``close``, and in a process that inherited this session by a fork.

        Methods called every tick check the conditions themselves before calling this one.
        """
        if not self.closed and self.forks == _forks:
            return
        if self.closed:
            raise TransportError("this endpoint is closed")
        raise TransportError(
            f"this session was opened in process {self._pid}: a forked process must open its own"
        )


_PORT_ATTEMPTS: Final = 20
_PROBE_S: Final = 0.5
"""Longest wait for an answer to a connection, wall seconds."""
_RUNTIME_VARIABLE: Final = "ZENOH_RUNTIME"
_RUNTIME: Final = (
    "(rx: (worker_threads: 1), tx: (handover: rx), acc: (handover: rx), net: (handover: rx), "
    "app: (handover: rx))"
)
"""Zenoh's thread of a process of cells, which exchanges a few payloads a tick. A socket belongs to the pool that opened
it: with a pool of its own for that, each payload wakes a thread that wakes the one that reads."""
_NO_PORT: Final = ":0"


def open_hub(
    listen: str | None = None, *, lease_s: float = LEASE_S, gate: AccessPolicy | None = None
) -> ZenohEndpoint:
    """Open the plant's session, which cells join.

    Args:
        listen: Endpoint to listen on; None: a free loopback port.
        lease_s: See ``hub_config``.
        gate: Access policy; None: all sessions are admitted.

    Returns:
        The endpoint; its ``locator`` is what clients connect to.

    Raises:
        TransportError: The port is in use, or the endpoint makes no sense.
    """
    refusals = None
    if gate is not None:
        from bus.transports.zenoh.access_log import AccessLogMonitor

        refusals = AccessLogMonitor()
    try:
        session, locator, listening = _listening(listen, gate, lambda where: hub_config(where, lease_s, gate))
    except BaseException:
        if refusals is not None:
            refusals.close()
        raise
    return ZenohEndpoint(session, locator, refusals, listening)


def open_router(listen: Sequence[str], gate: AccessPolicy | None = None) -> ZenohEndpoint:
    """Open a router, for a plant and processes of cells that connect to it.

    Args:
        listen: Endpoints to listen on.
        gate: Access policy; None: all sessions are admitted.

    Raises:
        TransportError: As of ``open_hub``.
    """
    refusals = None
    if gate is not None:
        from bus.transports.zenoh.access_log import AccessLogMonitor

        refusals = AccessLogMonitor()
    try:
        session = _open(router_config(listen, gate), f"listen on {', '.join(listen)}")
    except BaseException:
        if refusals is not None:
            refusals.close()
        raise
    addresses = _addresses(session, "router")
    return ZenohEndpoint(session, _with_port(listen[0], addresses), refusals, addresses)


def open_outside(listen: str | None, *, lease_s: float = LEASE_S, gate: AccessPolicy) -> ZenohEndpoint:
    """Open the session of a run's mirror, which listeners and operators connect to.

    Args:
        listen: Endpoint to listen on; None: a free loopback port.
        lease_s: See ``hub_config``.
        gate: Access policy.

    Raises:
        TransportError: As of ``open_hub``.
    """
    session, locator, listening = _listening(listen, gate, lambda where: mirror_config(where, lease_s, gate))
    return ZenohEndpoint(session, locator, listening=listening)


_Opened = tuple[zenoh.Session, str, tuple[str, ...]]
"""A session, what to connect to, and the addresses that it listens on."""


def _listening(
    listen: str | None, gate: AccessPolicy | None, config: Callable[[str], zenoh.Config]
) -> _Opened:
    if listen is not None:
        session = _open(config(listen), f"listen on {listen}")
        addresses = _addresses(session)
        return session, _with_port(listen, addresses), addresses
    protocol = "tcp" if gate is None or gate.identity is None else PROTOCOL[gate.identity.kind]
    for attempt in range(1, _PORT_ATTEMPTS + 1):
        locator = f"{protocol}/127.0.0.1:{free_port()}"
        try:
            session = _open(config(locator), f"listen on {locator}")
        except TransportError:
            # Somebody took the port between our look and Zenoh's; another is as good.
            if attempt == _PORT_ATTEMPTS:
                raise
            continue
        return session, locator, _addresses(session)
    raise AssertionError("unreachable: this is a bug")


def _addresses(session: zenoh.Session, mode: str = "peer") -> tuple[str, ...]:
    """Return the addresses that a session listens on, from Zenoh's admin space."""
    own = cast("Any", session)
    for reply in own.get(f"@/{own.zid()}/{mode}"):
        if reply.ok is not None:
            return tuple(json.loads(reply.ok.payload.to_string())["locators"])
    return ()


def _with_port(listen: str, addresses: tuple[str, ...]) -> str:
    """Return the requested endpoint, with the actual port in place of port 0."""
    address, mark, more = listen.partition("#")
    if not address.endswith(_NO_PORT) or not addresses:
        return listen
    port = addresses[0].partition("#")[0].partition("?")[0].rpartition(":")[2]
    return f"{address.removesuffix(_NO_PORT)}:{port}{mark}{more}"


def open_client(
    connect: str,
    *,
    lease_s: float = LEASE_S,
    timeout_s: float = 10.0,
    identity: Identity | None = None,
    one_thread: bool = True,
    largest: int | None = None,
) -> ZenohEndpoint:
    """Open the session of a cell process or an observer; call it after a fork, never before.

    Args:
        connect: Endpoint of a session that listens.
        lease_s: See ``client_config``.
        timeout_s: Time to retry while there is no listener, s.
        identity: Identity to present; None: none.
        one_thread: Whether one of Zenoh's threads is enough, as where a few payloads are exchanged in a tick.
        largest: Bytes of the largest payload that comes in; None: ``session.LARGEST``.

    Raises:
        TransportError: No session listens there within ``timeout_s``, or it refuses this identity.
    """
    config = client_config(connect, lease_s, timeout_s, identity, largest)
    try:
        with _one_thread() if one_thread else contextlib.nullcontext():
            return ZenohEndpoint(zenoh.open(config), connect)
    except zenoh.ZError as error:
        why = _silence(connect, first_line(error)) or _refusal(identity)
        raise TransportError(f"connect to {connect}: {why}") from None


def _refusal(identity: Identity | None) -> str:
    """Say why somebody who listens may refuse a session, which Zenoh doesn't say."""
    if identity is None:
        return (
            "somebody listens there and refuses sessions without keys (--keys), or is no plant and no router"
        )
    if identity.kind == "password":
        return f"somebody listens there, and the run refuses these keys: the password of {identity.user} is another"
    return (
        "somebody listens there, and the run refuses these keys, or its certificate is not for this address"
    )


def _silence(connect: str, problem: str) -> str:
    """Say why nobody answers at an endpoint; empty: somebody accepts connections there.

    Args:
        connect: The endpoint.
        problem: Zenoh's own words, for endpoints that aren't of TCP.
    """
    protocol, _, address = connect.partition("/")
    host, _, port = address.partition("#")[0].partition("?")[0].rpartition(":")
    if protocol not in ("tcp", "tls") or not port.isdecimal():
        return f"no answer ({problem})"
    try:
        socket.create_connection((host.strip("[]"), int(port)), _PROBE_S).close()
    except ConnectionRefusedError:
        return "no answer: nobody listens there"
    except (OSError, OverflowError) as error:
        return f"no answer: {error}"
    return ""


@contextlib.contextmanager
def _one_thread() -> Generator[None]:
    """Choose one thread for Zenoh, if the variable is not set and the process opens its first session in the context.

    Zenoh reads the variable at a process's first session. The context restores it: a child process may be a plant.
    """
    if _RUNTIME_VARIABLE in os.environ:
        yield
        return
    os.environ[_RUNTIME_VARIABLE] = _RUNTIME
    try:
        yield
    finally:
        os.environ.pop(_RUNTIME_VARIABLE, None)


def _open(config: zenoh.Config, attempted: str) -> zenoh.Session:
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        text = str(error)
        if "in use" in text:
            raise TransportError(f"{attempted}: the port is in use") from None
        raise TransportError(f"{attempted}: {first_line(error)}") from None


def free_port() -> int:
    """Find a free loopback TCP port."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return cast("int", probe.getsockname()[1])
