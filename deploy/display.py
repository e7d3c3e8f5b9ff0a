"""Where commands show on stderr how far they have come: a bar on a terminal, lines in a log."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Final, Self

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

LINE_S: Final = 10.0
"""Wall time between two lines where stderr is not a terminal: for logs, few."""


class Display:
    """A bar where stderr is a terminal, or lines; nothing at all where it is to be quiet.

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
