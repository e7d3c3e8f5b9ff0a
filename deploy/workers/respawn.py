"""Workers that went, started anew: how often, and when their cells take part again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Protocol, final

from bus.partition import Partition

if TYPE_CHECKING:
    from bus.lockstep import Coordinator
    from bus.lockstep.counters import Loss

_PROCESS = ("token lost", "stalled")
"""Losses of a process; a firmware that fails fails again."""


class Workers(Protocol):
    """What is needed of ``deploy.workers.system.System``."""

    def restart(self, shard: int) -> None:
        """Start the process of a shard anew."""
        ...

    def ended(self, shard: int) -> bool:
        """Whether the process of a shard has ended."""
        ...


@final
class Respawner:
    """Starts workers anew that were lost.

    Args:
        workers: The processes.
        host: The plant's side of the lockstep.
        partition: Which cells run where.
        most: How often, in all.
        warn: Told what is done, a line each.
    """

    def __init__(
        self,
        workers: Workers,
        host: Coordinator,
        partition: Partition,
        most: int,
        warn: Callable[[str], None],
    ) -> None:
        self._workers = workers
        self._host = host
        self._partition = partition
        self._most = most
        self._warn = warn
        self._done = 0
        self._absent: dict[int, int] = {}
        """Of shards that are waited for, a cell's index."""

    def on_lost(self, losses: Sequence[Loss]) -> None:
        """Cells were lost: start their processes anew."""
        for loss in losses:
            if loss.reason in _PROCESS:
                shard = int(self._partition.shard_of[loss.cell])
                if shard not in self._absent:
                    self._start(shard, loss.cell)

    def poll_rejoined(self, tick: int) -> list[int]:
        """Cells that take part again from ``tick`` on, which is the next."""
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
        if self._done >= self._most:
            self._absent.pop(shard, None)
            self._warn(
                f"the process of cell {row},{column} is not started anew: {self._most} times were allowed"
            )
            return
        self._done += 1
        self._absent[shard] = cell
        self._warn(f"the process of cell {row},{column} is started anew ({self._done} of {self._most})")
        self._workers.restart(shard)
