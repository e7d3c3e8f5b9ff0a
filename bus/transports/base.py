"""Transport interface of the lockstep: publishers, subscriptions, tokens, and delivery guarantees."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from typing import Literal, NamedTuple


class Received(NamedTuple):
    """A payload received on a key."""

    key: str
    payload: bytes


class LivelinessChange(NamedTuple):
    """A token that appeared (``present``) or disappeared: withdrawn, or its process ended."""

    key: str
    present: bool


class Wakeup(NamedTuple):
    """An event caused by ``wake``."""


Event = Received | LivelinessChange | Wakeup
Urgency = Literal["quiet", "wake", "urgent"]


class Publisher(ABC):
    """Publisher of payloads on one key."""

    @abstractmethod
    def put(self, payload: bytes) -> None:
        """Send ``payload`` to every subscriber of the key; block rather than drop."""

    @abstractmethod
    def matched(self) -> bool:
        """Whether at least one subscriber is known; earlier payloads may reach no subscriber."""


class Endpoint(ABC):
    """Participant of a transport: one inbox for subscribed payloads and watched tokens.

    Every transport promises, and one conformance suite checks:

    - **Order.** What one endpoint puts on the keys of one subscription is received in the order of the puts, and
      whatever it put before an urgent payload comes before that. Nothing is received without the urgent payloads
      that were put before it. Between different senders there is no order.
    - **Once.** A payload put while a subscriber was matched arrives exactly once while both live. Overlapping
      subscriptions of one endpoint would break that and are refused. An endpoint receives its own puts.
    - **Patience.** ``receive`` may be given the number of payloads needed: fewer then wait, but never beyond the
      timeout, and never behind a token, a ``Wakeup`` or an urgent subscription's payload. ``receive_all`` may be given
      a quiet subscription to wait for.
    - **Bytes.** Payloads arrive as they were put, empty ones included.
    - **Late joiners** get nothing of what was put before they subscribed. Tokens are different: a watcher
      is notified of every token present when it begins to watch, possibly twice.
    - **Tokens follow the data.** Payloads of an endpoint arrive before the disappearance of its token.
    - **Threads.** ``put``, ``put_all``, ``wake`` and ``matched`` may be called from any thread, ``receive`` from
      one at a time. In the main thread a blocked ``receive`` lets signal handlers run.
    - **Close** withdraws the tokens; closing twice is harmless; anything else on a closed endpoint raises
      ``TransportError``.
    """

    def __init__(self) -> None:
        self._rest: list[Event] = []
        """Taken, but not received yet."""

    @abstractmethod
    def publisher(self, key: str) -> Publisher:
        """A publisher on one key (no wildcards)."""

    @abstractmethod
    def put_all(self, puts: Iterable[tuple[Publisher, bytes]]) -> None:
        """Put each payload with its publisher, all of this endpoint, in quick succession."""

    @abstractmethod
    def subscribe(self, key_expr: str, haste: Urgency = "wake", *, direct: bool = False) -> None:
        """Subscribe to matching keys; subscribing to the same expression twice is a no-op.

        Args:
            key_expr: A key, or a pattern: ``*`` is one chunk, ``**`` any number of them.
            haste: Effect of a payload on a waiting ``receive``: ``"wake"`` counts towards ``enough``; ``"urgent"`` ends
                the wait; ``"quiet"`` neither counts nor ends the wait. Quiet payloads come first when the wait ends.
            direct: Whether ``answer_payloads`` may answer in a thread of the transport; for the first subscription of
                ``"wake"``, to a key.

        Raises:
            TransportError: The expression overlaps another subscription of this endpoint.
        """

    @abstractmethod
    def declare_alive(self, key: str) -> None:
        """Declare a token; it stands until withdrawn or until this process ends."""

    @abstractmethod
    def withdraw(self, key: str) -> None:
        """Withdraw a token; a no-op where none was declared."""

    @abstractmethod
    def watch_alive(self, key_expr: str) -> None:
        """Watch matching tokens: present ones first, then appearances and disappearances."""

    def receive(self, timeout_s: float | None, enough: int = 1) -> Event | None:
        """Return the oldest event in the inbox, else wait for one.

        Args:
            timeout_s: Wall seconds after which None is returned if there is none; 0: at once; None: never.
            enough: How many must be there before the wait ends early; see *patience*.
        """
        if not self._rest:
            self._rest = self.receive_all(timeout_s, enough)
        return self._rest.pop(0) if self._rest else None

    @abstractmethod
    def receive_all(
        self, timeout_s: float | None, enough: int = 1, quiet_key: str | None = None
    ) -> list[Event]:
        """Return all events in the inbox, oldest first, else wait as ``receive``; empty after ``timeout_s``.

        Every transport implements it: events pass no other file between its inbox and their reader. It returns
        ``_rest`` first, and then doesn't wait.

        Args:
            timeout_s: As of ``receive``.
            enough: As of ``receive``.
            quiet_key: Expression of a quiet subscription whose payload ends this wait, as does everything urgent;
                payloads of ``"wake"`` subscriptions then need not. None: the wait is that of ``receive``.
        """

    def receive_payload(self, key: str) -> bytes | None:
        """Wait for an event, and return the payload of ``key`` if nothing else is there.

        Returns:
            The payload, where further ones of ``key`` may be left for later calls; None: whatever came is left for
            ``receive_all``.
        """
        events = self.receive_all(None)
        if len(events) == 1 and type(event := events[0]) is Received and event.key == key:
            return event.payload
        self._rest = events
        return None

    def answer_payloads(self, key: str, answer: Callable[[bytes], bool]) -> None:
        """Have ``answer`` take payloads of ``key`` as they come, until it refuses one or anything else comes.

        The call may return early. A refused payload, and whatever else came, is left for later calls.

        Args:
            key: The key.
            answer: Returns whether it took a payload. Called in one thread at a time, while this call waits: in this
                thread or, of a ``direct`` subscription, in one of the transport's, which does nothing else before it
                returns. What it raises is raised here.
        """
        while (payload := self.receive_payload(key)) is not None:
            if not answer(payload):
                self._rest = [Received(key, payload)]
                return

    @abstractmethod
    def wake(self) -> None:
        """Put one ``Wakeup`` in the inbox: a blocked ``receive`` returns. Safe in a signal handler."""

    @abstractmethod
    def close(self) -> None:
        """Withdraw all tokens and close the endpoint."""
