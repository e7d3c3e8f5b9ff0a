"""Channel of one key whose payloads are answered in Zenoh's receiving thread while the reader waits."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from queue import SimpleQueue
from threading import Lock
from typing import Final, final

import zenoh
from zenoh import handlers  # pyright: ignore[reportMissingModuleSource] - its source is the binary

from bus.transports.base import Event, Received
from bus.transports.zenoh.receiving_thread import keep_state


def _refuse(payload: bytes) -> bool:  # noqa: ARG001 - an answer's
    """Answer nothing."""
    return False


@final
class DirectChannel:
    """Payload channel of one key. While the reader waits in ``serve``, payloads are answered as they come.

    That saves waking the reader's thread for each payload, and Zenoh's for each answer. The reader owns the channel by
    a lock, and gives it away for the time that it waits in ``serve``: the answer's callee runs in one thread at a time.

    Args:
        session: The session.
        key: The key.
        is_quiet: Whether no other event waits for the reader; payloads are not answered before it.

    Attributes:
        key: The key.
    """

    def __init__(self, session: zenoh.Session, key: str, is_quiet: Callable[[], bool]) -> None:
        self.key: Final = key
        self._is_quiet = is_quiet
        self._payloads: deque[bytes] = deque()
        self._wakeups: SimpleQueue[None] = SimpleQueue()
        """An entry once a payload is kept or the bell rings; what it was for may be gone when it is found."""
        self._rung = False
        self._answer: Callable[[bytes], bool] = _refuse
        self._error: BaseException | None = None
        self._ownership = Lock()
        self._ownership.acquire()
        self._subscriber = session.declare_subscriber(
            key, handlers.Callback(keep_state(self._receive), indirect=False)
        )

    def _receive(self, sample: zenoh.Sample) -> None:
        """Answer a payload, or keep it for the reader. In Zenoh's thread."""
        payload = sample.payload.to_bytes()
        if self._ownership.acquire(blocking=False):
            try:
                if not self._payloads and self._is_quiet() and self._answer(payload):
                    return
            except BaseException as error:  # noqa: BLE001 - raised again in the reader's thread
                self._error = error
            finally:
                self._ownership.release()
        self._payloads.append(payload)
        self._wake()

    def serve(self, answer: Callable[[bytes], bool]) -> None:
        """Have payloads answered until one is refused, or the bell rings; maybe none.

        Args:
            answer: Returns whether it took the payload; must return soon. What it raises is raised here.
        """
        self._answer = answer
        while not self._payloads and not self._rung and self._error is None:
            self._ownership.release()
            try:
                self._wakeups.get()
            finally:
                self._ownership.acquire()
        self._rung = False
        error, self._error = self._error, None
        if error is not None:
            raise error

    def wait(self, events: list[Event]) -> None:
        """Wait for a payload, and add it to ``events``, or for the bell."""
        if (payload := self.next()) is not None:
            events.append(Received(self.key, payload))

    def next(self) -> bytes | None:
        """Wait for a payload and return it; None for the bell."""
        while not self._payloads and not self._rung:
            self._wakeups.get()
        if self._payloads:
            return self._payloads.popleft()
        self._rung = False
        return None

    def drain(self, events: list[Event]) -> None:
        """Add the payloads present. The bell has rung for what is looked at after this."""
        self._rung = False
        events.extend(Received(self.key, self._payloads.popleft()) for _ in range(len(self._payloads)))

    def ring(self) -> None:
        """End the current wait, or the next. From any thread, or a signal handler."""
        self._rung = True
        self._wake()

    def _wake(self) -> None:
        if self._wakeups.empty():  # else the reader looks at everything after it has found the entry
            self._wakeups.put(None)
