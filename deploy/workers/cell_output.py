"""Output of programs: lines of ``print`` and of ``logging`` begin with cell and tick."""

from __future__ import annotations

import logging
import sys
from collections.abc import Generator
from contextlib import contextmanager
from threading import get_ident
from typing import Any, TextIO, final

from cell_firmware.stepping import NOW


@final
class CellStream:
    """Stream on which lines of the thread that made it begin with cell and tick, while a program is stepped.

    Args:
        stream: Stream that is written to.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._at_start, self._thread = True, get_ident()

    def write(self, text: str) -> int:
        """Write, with cell and tick at the start of every line."""
        place = NOW.place() if get_ident() == self._thread else None
        if place is None or not text:
            self._at_start = text.endswith("\n") if text else self._at_start
            return self._stream.write(text)
        lines = text.splitlines(keepends=True)
        said = [f"{place}: {line}" if i or self._at_start else line for i, line in enumerate(lines)]
        self._at_start = text.endswith("\n")
        self._stream.write("".join(said))
        return len(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def naming_cells() -> Generator[None]:
    """Have standard output and standard error of this thread name cell and tick, and log records have ``place``."""
    before = sys.stdout, sys.stderr, logging.getLogRecordFactory()
    ours: tuple[Any, Any] = CellStream(sys.stdout), CellStream(sys.stderr)
    thread = get_ident()

    def record(*arguments: Any, **keywords: Any) -> logging.LogRecord:
        made = before[2](*arguments, **keywords)
        made.place = (get_ident() == thread and NOW.place()) or ""
        return made

    sys.stdout, sys.stderr = ours
    logging.setLogRecordFactory(record)
    try:
        yield
    finally:
        if sys.stdout is ours[0]:
            sys.stdout = before[0]
        if sys.stderr is ours[1]:
            sys.stderr = before[1]
        if logging.getLogRecordFactory() is record:
            logging.setLogRecordFactory(before[2])
