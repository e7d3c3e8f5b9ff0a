"""Progress of a run on stderr, updated a few times a second."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Final, Self, final

from deploy.util.formatting import plural

if TYPE_CHECKING:
    from rich.progress import Progress as Bar


LINE_S: Final = 10.0
"""Wall time between two lines where stderr is not a terminal: for logs, few."""


class Display:
    """Progress bar on a terminal, or lines in a log; no output where quiet.

    Args:
        bar: Makes the bar.
        quiet: Show nothing.
    """

    def __init__(self, bar: Callable[[], Bar], *, quiet: bool) -> None:
        terminal = sys.stderr.isatty()
        self._bar = bar() if terminal and not quiet else None
        self._lines = not terminal and not quiet

    def __enter__(self) -> Self:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    @staticmethod
    def _write(line: str) -> None:
        """Put a line into the log."""
        sys.stderr.write(f"mdms: {line}\n")
        sys.stderr.flush()


_TERMINAL_S: Final = 0.2
"""Wall time between two updates of the bar."""


@final
class Progress(Display):
    """Progress bar with simulated time, tick rate, events and lost cells; occasional lines in a log.

    Args:
        duration_ns: Simulated time of the run.
        quiet: Show nothing.

    Attributes:
        events: Counted by the caller.
        lost: Cells lost, counted by the caller.
    """

    def __init__(self, duration_ns: int, *, quiet: bool = False) -> None:
        super().__init__(lambda: _bar(duration_ns), quiet=quiet)
        self.events = 0
        self.lost = 0
        self._duration_ns = duration_ns
        self._show: Callable[[int, float], None] | None = self._line if self._lines else None
        self._every_s = LINE_S
        if self._bar is not None:
            self._task = self._bar.add_task("", total=duration_ns * 1e-9, facts="")
            self._show, self._every_s = self._redraw, _TERMINAL_S
        self._last: tuple[int, float] | None = None
        self._next = 0.0

    def update(self, ticks: int, time_ns: int) -> None:
        """Tell how many ticks are over and which time was reached; cheap, call it every tick."""
        if self._show is None:
            return
        now = time.monotonic()
        if now < self._next:
            return
        last, self._last = self._last, (ticks, now)
        self._next = now + self._every_s
        if last is not None:
            self._show(time_ns, (ticks - last[0]) / (now - last[1]))

    def say(self, line: str) -> None:
        """Put a line above the bar."""
        if self._bar is not None:
            self._bar.console.print(f"mdms: {line}", markup=False, highlight=False, soft_wrap=True)
        elif self._lines:
            self._write(line)

    def _facts(self, rate: float) -> str:
        lost = f"  {plural(self.lost, 'cell')} lost" if self.lost else ""
        return f"{rate:,.0f} ticks/s  {plural(self.events, 'event')}{lost}"

    def _redraw(self, time_ns: int, rate: float) -> None:
        assert self._bar is not None
        self._bar.update(self._task, completed=time_ns * 1e-9, facts=self._facts(rate))
        self._bar.refresh()

    def _line(self, time_ns: int, rate: float) -> None:
        reached = f"{time_ns * 1e-9:.2f} of {self._duration_ns * 1e-9:g} s"
        self._write(f"{reached}  {self._facts(rate)}")


def _bar(duration_ns: int) -> Bar:
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn
    from rich.progress import Progress as Bar

    duration = f"{duration_ns * 1e-9:g}"
    return Bar(
        TextColumn(f"{{task.completed:>{len(duration) + 2}.2f}} of {duration} s"),
        BarColumn(),
        TextColumn("{task.fields[facts]}"),
        console=Console(stderr=True),
        auto_refresh=False,
        transient=True,
    )
