"""How many runs of a campaign are over, on stderr."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, final

from deploy.display import LINE_S, Display

if TYPE_CHECKING:
    from rich.progress import Progress as Bar


@final
class Progress(Display):
    """A bar with the runs that are over, those that failed, and the time left; lines now and then in a log.

    Args:
        total: Runs of the campaign, undisturbed ones included.
        done: Of these, done before.
        failed: Of those, failed.
        quiet: Show nothing.
    """

    def __init__(self, total: int, done: int, failed: int, *, quiet: bool) -> None:
        super().__init__(_bar, quiet=quiet)
        self._total, self._done, self._failed = total, done, failed
        self._before = done
        self._begun = self._said = time.monotonic()
        if self._bar is not None:
            self._task = self._bar.add_task("", total=total, completed=done, failed=self._facts())

    def advance(self, *, failed: bool) -> None:
        """One more run is over."""
        self._done += 1
        self._failed += failed
        if self._bar is not None:
            self._bar.update(self._task, completed=self._done, failed=self._facts())
        elif self._lines and time.monotonic() - self._said > LINE_S:
            self._said = time.monotonic()
            left_s = (self._said - self._begun) / (self._done - self._before) * (self._total - self._done)
            self._write(f"{self._done:,} of {self._total:,} runs{self._facts()}, {left_s:.0f} s left")

    def _facts(self) -> str:
        return f", {self._failed:,} failed" if self._failed else ""


def _bar() -> Bar:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    return Bar(
        MofNCompleteColumn(),
        TextColumn("runs{task.fields[failed]}"),
        BarColumn(),
        TimeRemainingColumn(),
        TextColumn("left"),
        console=Console(stderr=True),
        transient=True,
    )
