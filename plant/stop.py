"""Early termination of solver calls, requested by a signal watcher or another thread and checked between steps.

Kernels run without the interpreter lock and can't see signals; kernels poll one number in memory. A signal concerns the
whole process, so there is one such number a process, for all of its plants.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_FLAG = bytearray(8)


def request() -> None:
    """Ask for the end of every call under way: `PlantStopped` is raised there, and in calls to come."""
    _FLAG[0] = 1


def withdraw() -> None:
    """Let calls to come go on to their end."""
    _FLAG[0] = 0


def requested() -> bool:
    """Whether calls are to end early."""
    return _FLAG[0] != 0


def flag() -> NDArray[np.int64]:
    """``(1,)`` that is not 0 while calls are to end early: the same memory for everybody."""
    import numpy as np  # whoever only asks for an end has no need of it

    return np.frombuffer(_FLAG, dtype=np.int64)
