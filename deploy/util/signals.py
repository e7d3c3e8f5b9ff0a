"""Handling of Ctrl-C and SIGTERM at safe points."""

from __future__ import annotations

import signal
import socket
import sys
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager
from types import FrameType
from typing import Any, Final, final

from plant import stop

_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)


class Interrupted(BaseException):
    """Stop request by SIGINT or SIGTERM, or by an operator.

    Not an Exception: nothing but the run itself may catch it.
    """

    exit_code: int = 130


@final
class Interruption:
    """Records SIGINT and SIGTERM, and raises Interrupted only at points that leave no work half done.

    A signal raises at once inside `interruptible` and whenever `is_idle` says that the run only waits; elsewhere at the
    next `raise_if_requested`. Python handles a signal when compiled code returns, so a thread receives signals as well
    and has the plants' solvers return (`plant.stop`). `handling` restores the previous handlers. In a thread other than
    the main one signals are left alone.

    Attributes:
        requested: Whether a signal has come.
        is_idle: Called in the signal handler: whether the run only waits.
        wake: Called in the signal handler, to end a wait; None: nothing is called.
    """

    def __init__(self) -> None:
        self.requested = False
        self.is_idle: Callable[[], bool] = lambda: False
        self.wake: Callable[[], None] | None = None
        self._allowed = False
        self._raised = False

    @contextmanager
    def handling(self, *, last: bool = False) -> Generator[None]:
        """Handle the two signals in here.

        Args:
            last: The process ends after this: once a signal has come, further ones are ignored for good, so
                that an impatient second Ctrl-C does not spoil the end.
        """
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        before = {number: signal.signal(number, self._note) for number in _SIGNALS}
        hook = sys.unraisablehook

        def unraisable(lost: sys.UnraisableHookArgs) -> None:
            # Python drops what a signal handler raises inside a C library's callback, such as the compiler's.
            if isinstance(lost.exc_value, Interrupted):
                self._raised = False
            else:
                hook(lost)

        sys.unraisablehook = unraisable
        try:
            with _solvers_stopped():
                yield
        finally:
            sys.unraisablehook = hook
            for number, handler in before.items():
                if last and self.requested:
                    signal.signal(number, signal.SIG_IGN)
                elif signal.getsignal(number) == self._note:  # else somebody in here had the last word on it
                    signal.signal(number, handler)

    @contextmanager
    def interruptible(self) -> Generator[None]:
        """Let a signal end what happens in here, in the middle of it."""
        self._allowed = True
        try:
            self.raise_if_requested()
            yield
        except Exception:
            if self._raised:  # a C library has made an error of its own of it
                raise Interrupted from None
            raise
        finally:
            self._allowed = False

    def raise_if_requested(self) -> None:
        """Raise Interrupted if a signal has come."""
        if self.requested:
            self._raised = True
            raise Interrupted

    def _note(self, number: int, frame: FrameType | None) -> Any:
        del number, frame
        self.requested = True
        if self.wake is not None:
            self.wake()
        # One exception is enough: what it unwinds is not to be interrupted again.
        if not self._raised and (self._allowed or self.is_idle()):
            self._raised = True
            raise Interrupted


@contextmanager
def _solvers_stopped() -> Generator[None]:
    """Have solvers' calls end when one of the two signals comes in here, whatever code runs then."""
    ours, wakes = socket.socketpair()
    wakes.setblocking(False)

    def watch() -> None:
        while numbers := ours.recv(64):
            if any(number in _SIGNALS for number in numbers):
                stop.request()

    watcher = threading.Thread(target=watch, name="mdms-signals", daemon=True)
    watcher.start()
    before = signal.set_wakeup_fd(wakes.fileno(), warn_on_full_buffer=False)
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        wakes.close()
        watcher.join()
        ours.close()
        stop.withdraw()
