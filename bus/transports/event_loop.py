"""Asyncio event loop of one thread that waits in a transport instead of in the operating system's selector.

A transport's wait (a Zenoh channel) has no file descriptor that a selector could watch. A second thread that blocks in
the transport and hands each payload to the loop costs two switches of threads a tick. This loop has one thread: where
it would sleep in the selector, it calls the poll that a coroutine awaits. What the poll receives stays with the poll.
"""

from __future__ import annotations

import asyncio
import selectors
from collections import deque
from collections.abc import Callable
from contextvars import Context
from typing import TypeVarTuple, final

from bus.errors import WaitInterrupted
from bus.transports.base import Endpoint

Ts = TypeVarTuple("Ts")


@final
class _Selector(selectors.DefaultSelector):
    """Selector whose wait is replaced by ``wait`` while that is set."""

    def __init__(self) -> None:
        super().__init__()
        self.wait: Callable[[float | None], None] | None = None

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """Return the file descriptors that are ready, after a wait in the transport."""
        if self.wait is not None and (timeout is None or timeout > 0.0):
            self.wait(timeout)
            timeout = 0.0
        return super().select(timeout)


def _never(timeout_s: float | None) -> None:
    """Stand for a wait that is not the selector's."""
    raise AssertionError(f"this is a bug: a selector waits for {timeout_s} s while a coroutine does")


@final
class TransportEventLoop(asyncio.SelectorEventLoop):
    """Event loop that waits in a transport while a coroutine awaits ``poll_until``.

    Callbacks and timers run as in every event loop. File descriptors are looked at after each wait only: no task of
    this loop should wait for one.

    Args:
        endpoint: Endpoint that the polls wait in; woken by ``call_soon_threadsafe``.
    """

    def __init__(self, endpoint: Endpoint) -> None:
        self._idle = _Selector()
        self._endpoint = endpoint
        self._calls: deque[None] = deque()
        """An entry for each wakeup for a callback that no wait has reported yet; appended and popped atomically."""
        super().__init__(self._idle)

    async def poll_until(self, poll: Callable[[float | None], bool]) -> None:
        """Call ``poll`` whenever the loop is idle, until it returns True.

        One coroutine at a time.

        Args:
            poll: Waits in the transport; its argument is the longest time, s, None for any; returns False if that is
                up. Raises WaitInterrupted when the endpoint was woken.

        Raises:
            WaitInterrupted: The endpoint was woken, and not for a callback of this loop.
        """
        if self._poll_at_once(poll):
            return
        over: asyncio.Future[None] = self.create_future()

        def wait(timeout_s: float | None) -> None:
            try:
                done = poll(timeout_s)
            except WaitInterrupted as error:
                if not self._are_own(error.wakeups):
                    over.set_exception(error)
            except Exception as error:  # noqa: BLE001 - raised again where the poll is awaited
                over.set_exception(error)
            else:
                if done:
                    over.set_result(None)

        self._idle.wait = wait
        try:
            await over
        finally:
            self._idle.wait = None

    def _poll_at_once(self, poll: Callable[[float | None], bool]) -> bool:
        """Call ``poll`` without a turn of the loop where the loop has nothing else to do; False if it has.

        The loop would go idle and call it then. A turn costs as much as the wait itself.

        Raises:
            WaitInterrupted: As ``poll_until``.
        """
        own = vars(self)  # where asyncio keeps callbacks that are due, and timers
        self._idle.wait = _never  # from here on callbacks of other threads end the wait
        try:
            while not own["_ready"] and not own["_scheduled"]:
                if poll(None):
                    return True
        except WaitInterrupted as error:
            if not self._are_own(error.wakeups):
                raise
        finally:
            self._idle.wait = None
        return False

    def call_soon_threadsafe(
        self, callback: Callable[[*Ts], object], *args: *Ts, context: Context | None = None
    ) -> asyncio.Handle:
        """Schedule a callback from another thread or a signal handler, and end the wait in the transport."""
        handle = super().call_soon_threadsafe(callback, *args, context=context)
        if self._idle.wait is not None:
            self._calls.append(None)
            self._endpoint.wake()
        return handle

    def _are_own(self, wakeups: int) -> bool:
        """Whether all of so many wakeups were for callbacks of this loop."""
        try:
            for _ in range(wakeups):
                self._calls.pop()
        except IndexError:
            return False
        return True
