"""Watchdog of the cells' programs: a program that does not return is interrupted or, failing that, abandoned.

Python can interrupt a thread's Python code, not what that code waits for in C. A program that sleeps or waits for a
lock is therefore reported from here, by the watching thread, while its own thread stays where it is.
"""

from __future__ import annotations

import ctypes
import sys
import threading
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Final, Self, final

from cell_firmware.agent import Held, Hopeless
from cell_firmware.call_stack import UnderWay, in_debugger, under_way
from cell_firmware.errors import NeverReturned

_LOOKS: Final = 20
"""Looks within the deadline. A late look counts once, so that a suspended process has not used up its time."""
_BUSY: Final = 5
"""Looks after which ``busy`` is called, then again at each look. Early, since looks may be late."""
_NEXT: Final = 1
"""Looks that a program gets after an interruption of another program in the same call."""
_STUCK: Final = 6
"""Looks at the same program after its interruption, after which the program counts as uninterruptible."""
_LAST: Final = 60
"""Looks after which the call is abandoned in any case."""
_CHANCES: Final = 1000
"""Turns of a loop, in each of which Python looks whether an error is pending."""


@final
class Watchdog:
    """Watchdog of one thread's calls of the cells' programs, in a thread of its own.

    ``with overseer:`` around a call that steps programs. A call that is still running after ``limit_s`` gets
    ``NeverReturned`` raised in it, wherever it is: the board takes that for the failure of the program that was
    running, and goes on to the next. Should that one not return either, it gets a twentieth of the time.

    Args:
        limit_s: Wall time that a call may take, s.
        rule: Setting that the limit comes from, for the message.
        busy: Called from the watching thread when a quarter of the limit is over, and again while the call runs.
        hopeless: Called from the watching thread, once a call, where the program could not be interrupted.
        held: Called from the watching thread with the cell while a debugger holds its program, which does not count
            as running then.
    """

    def __init__(
        self,
        limit_s: float,
        rule: str,
        busy: Callable[[], None] | None = None,
        hopeless: Hopeless | None = None,
        held: Held | None = None,
    ) -> None:
        problem = f"the step had not returned after {limit_s:g} s ({rule})"
        self._error = type("NeverReturned", (NeverReturned,), {"problem": problem, "__module__": "builtins"})
        self._problem = problem
        self._look_s = limit_s / _LOOKS
        self._busy = busy
        self._hopeless = hopeless
        self._held = held
        self._lock = threading.Lock()
        self._over = threading.Event()
        self._calls = 0
        self._running = 0
        """Number of the running call; 0 if no call is running."""
        self._overran = False
        self._given_up = False
        self._target = 0
        self._thread = threading.Thread(target=self._watch, name="overseer", daemon=True)
        self._thread.start()

    @property
    def given_up(self) -> bool:
        """Whether the last call was abandoned; its result is discarded."""
        return self._given_up

    def __enter__(self) -> Self:
        self._target = threading.get_ident()
        self._calls += 1
        self._running = self._calls
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._lock:
            self._running = 0
            if self._overran:
                _cancel_pending()  # it may have come too late
                self._overran = False

    def close(self) -> None:
        """End the watching thread."""
        self._over.set()
        self._thread.join()

    # --- in the watching thread -------------------------------------------------------------------

    def _watch(self) -> None:
        call, looks, blame = 0, 0, _Blame()
        while not self._over.wait(self._look_s):
            if self._running != call or not call:
                call, looks, blame = self._running, 0, _Blame()
                continue
            if (cell := self._held_cell()) is not None:
                if self._held is not None:
                    self._held(cell)
                continue
            looks += 1
            if looks >= _LOOKS and (program := self._program()) is not None:
                same = blame.take(program)
                if looks == _LOOKS or same >= _NEXT:
                    self._interrupt(call)
                if (same >= _STUCK or looks >= _LAST) and blame.first is not None:
                    self._give_up(call, blame.first)
            if looks >= _BUSY and not self._given_up and self._busy is not None:
                self._busy()

    def _program(self) -> UnderWay | None:
        return under_way(self._frame())

    def _held_cell(self) -> tuple[int, int] | None:
        """Return the cell whose program a debugger holds; None if no debugger holds the thread."""
        if not in_debugger(frame := self._frame()):
            return None
        program = under_way(frame)
        return None if program is None else program.cell

    def _frame(self) -> FrameType | None:
        frames = sys._current_frames()  # noqa: SLF001 # pyright: ignore[reportPrivateUsage] - the documented way
        return frames.get(self._target)

    def _interrupt(self, call: int) -> None:
        with self._lock:
            if self._running == call:
                self._overran = True
                _raise_in(self._target, self._error)

    def _give_up(self, call: int, program: UnderWay) -> None:
        with self._lock:
            if self._running != call or self._given_up or self._hopeless is None:
                return
            self._given_up = True
        together = f", for {program.cells} cells at once" if program.cells > 1 else ""
        problem = f"NeverReturned: {self._problem}{together}"
        self._hopeless(
            program.cell, problem, f"Traceback (most recent call last):\n{program.trace}{problem}\n"
        )


@final
class _Blame:
    """Programs found running in one call after the deadline.

    Attributes:
        first: First program found. A program for several cells at once is replaced by the first single cell's program
            that is found twice in a row.
    """

    def __init__(self) -> None:
        self.first: UnderWay | None = None
        self._last: UnderWay | None = None
        self._looks = 0

    def take(self, program: UnderWay) -> int:
        """Add the program that a look found; return the number of consecutive earlier looks with the same program."""
        self._looks = self._looks + 1 if program.same(self._last) else 0
        self._last = program
        if self.first is None or (self.first.cells > 1 and program.cells == 1 and self._looks):
            self.first = program
        return self._looks


def _raise_in(thread: int, error: type[BaseException]) -> None:
    """Raise ``error`` in a thread as soon as Python code runs there."""
    ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), ctypes.py_object(error))


class _NotRaised(BaseException):
    """Takes the place of an error that is pending in a thread."""


def _cancel_pending() -> None:
    """Cancel an error that is pending in the calling thread, if there is one.

    Another one takes its place and is caught here. An error that is taken back instead would leave Python 3.11 looking
    for it from then on, at every call, and without end in a function that a debugger or a profiler watches.
    """
    try:
        _raise_in(threading.get_ident(), _NotRaised)
        for _ in range(_CHANCES):
            pass
    except _NotRaised:
        pass
