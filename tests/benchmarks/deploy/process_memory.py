"""Memory of processes, as Linux counts it."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from pathlib import Path


def descendants(pid: int) -> Iterator[int]:
    """Yield the ids of the processes that a process and its children have started."""
    for task in Path(f"/proc/{pid}/task").iterdir():
        with contextlib.suppress(FileNotFoundError):  # the thread has ended
            for child in map(int, (task / "children").read_text().split()):
                yield child
                yield from descendants(child)


def megabytes(pid: int, what: str) -> float:
    """Return one figure of a process's memory, such as ``Pss``, MB."""
    text = Path(f"/proc/{pid}/smaps_rollup").read_text()
    found = re.search(rf"^{what}:\s+(\d+) kB", text, re.MULTILINE)
    assert found is not None
    return int(found[1]) / 1024
