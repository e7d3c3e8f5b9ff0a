"""The event loop that waits in a transport: what ends a wait, and what ends the run."""

from __future__ import annotations

import asyncio
from typing import Any, cast

import pytest

from bus.errors import WaitInterrupted
from bus.transports.event_loop import TransportEventLoop


class Inbox:
    """An endpoint's wakeups, and a poll that reports all of them at once, as the lockstep's does.

    Args:
        late: Callbacks scheduled while the first wait ends, after its wakeups were taken.
    """

    def __init__(self, late: int) -> None:
        self.wakeups, self.polls, self.late = 0, 0, late
        self.loop = TransportEventLoop(cast("Any", self))

    def wake(self) -> None:
        self.wakeups += 1

    def poll(self, timeout_s: float | None) -> bool:
        del timeout_s
        self.polls += 1
        if self.polls == 1:
            self.loop.call_soon_threadsafe(int)
        taken, self.wakeups = self.wakeups, 0
        if self.polls == 1:
            for _ in range(self.late):
                self.loop.call_soon_threadsafe(int)
        if taken:
            raise WaitInterrupted("woken", taken)
        return True

    def run(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self.loop) as runner:
            runner.run(self.loop.poll_until(self.poll))


@pytest.mark.parametrize("late", [0, 1, 5])
def test_callbacks_of_other_threads_end_waits_and_never_the_run(late: int) -> None:
    inbox = Inbox(late)
    inbox.run()
    assert inbox.polls == (2 if late == 0 else 3)


def test_somebody_elses_wakeup_among_those_of_callbacks_ends_the_run() -> None:
    inbox = Inbox(0)
    inbox.wake()
    with pytest.raises(WaitInterrupted):
        inbox.run()
