"""Respawning of lost workers, and the rejoin of their cells."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Protocol, final

from bus.partition import Partition

if TYPE_CHECKING:
    from bus.lockstep import Coordinator
    from bus.lockstep.counters import Loss

_PROCESS = ("disconnected", "timed_out")
"""Reasons of losses that a new process can mend; a failed firmware would fail again."""


class RestartableWorkers(Protocol):
    """Operations of ``deploy.workers.system.System`` that the respawner uses."""

    def restart(self, shard: int) -> None:
        """Restart the process of a shard."""
        ...

    def ended(self, shard: int) -> bool:
        """Whether the process of a shard has ended."""
        ...


@final
class Respawner:
    """Respawner of lost workers, up to a total number of restarts.

    Args:
        workers: Processes of the cells.
        host: Coordinator of the lockstep.
        partition: Cells of each shard.
        most: Most restarts in all.
        warn: Called with one line for each restart, and for each restart refused.
        done: Says in warnings how a process is replaced.
    """

    def __init__(
        self,
        workers: RestartableWorkers,
        host: Coordinator,
        partition: Partition,
        most: int,
        warn: Callable[[str], None],
        done: str = "is restarted",
    ) -> None:
        self._workers = workers
        self._host = host
        self._partition = partition
        self._most = most
        self._warn = warn
        self._how = done
        self._done = 0
        self._absent: dict[int, int] = {}
        """A cell's index, by shard that has not rejoined yet."""

    def on_lost(self, losses: Sequence[Loss]) -> None:
        """Restart the processes of lost cells."""
        for loss in losses:
            if loss.reason in _PROCESS:
                shard = int(self._partition.shard_of[loss.cell])
                if shard not in self._absent:
                    self._start(shard, loss.cell)

    def poll_rejoined(self, tick: int) -> list[int]:
        """Return the cells that rejoin at ``tick``, which is the next; restart workers that have ended again."""
        if not self._absent:
            return []
        for shard, cell in list(self._absent.items()):
            if self._workers.ended(shard):
                self._start(shard, cell)
        cells = self._host.admit(tick)
        for cell in cells:
            self._absent.pop(int(self._partition.shard_of[cell]), None)
        return cells

    def _start(self, shard: int, cell: int) -> None:
        row, column = self._partition.lattice.cells[cell]
        alone = len(self._partition.cells(shard)) == 1
        name = f"cell {row},{column}" if alone else f"shard {shard}"
        if self._done >= self._most:
            self._absent.pop(shard, None)
            self._warn(f"the process of {name} is not restarted: the limit is {self._most} (--respawn)")
            return
        self._done += 1
        self._absent[shard] = cell
        self._warn(f"the process of {name} {self._how} ({self._done} of {self._most})")
        self._workers.restart(shard)
