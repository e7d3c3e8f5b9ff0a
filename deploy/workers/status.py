"""Status of a run, answered at any time: who is here, tick, lag, and who is lost."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, final

if TYPE_CHECKING:
    from bus.transports.zenoh.requests import IncomingRequest
    from deploy.workers.join import JoinRequest
    from deploy.workers.plan import Plan
    from deploy.workers.presence import Presence

_LISTED: Final = 64
"""Most shards and cells that an answer lists by name."""
_LATE_S: Final = 0.5
"""Wall time after which a tick is late, and the shards that it waits for are named, s."""


@final
@dataclass(frozen=True, slots=True)
class RunProgress:
    """Progress of a run that has begun.

    Attributes:
        tick: Next tick.
        time_s: Simulated time reached, s.
        flow: Fields of the run's flow: ``state``, ``speed``, ``real_time_factor``, ``lag_s``.
        lost: Cells that were lost, ``(row, column)``.
        awaited: Shards whose drives the tick waits for.
    """

    tick: int
    time_s: float
    flow: dict[str, Any]
    lost: Sequence[tuple[int, int]]
    awaited: Sequence[int]


@final
class RunStatus:
    """Status of a run; answers come from a thread beside the run's own.

    Args:
        plan: Plan of the run.
        duration_s: Simulated time of the run, s.
        presence: Tokens of the run.
        holder: Returns the process that took a shard's place by hand, or None; None: the plant started all.

    Attributes:
        progress: Returns the progress; None before the cells have started.
        tick: First tick of the run.
        time_s: Simulated time at its start, s.
    """

    def __init__(
        self,
        plan: Plan,
        duration_s: float,
        presence: Presence,
        holder: Callable[[int], JoinRequest | None] | None = None,
    ) -> None:
        self._plan = plan
        self._duration_s = duration_s
        self._presence = presence
        self._holder = holder
        self._seen = (-1, time.monotonic())
        """Tick seen last, and since when."""
        self.tick, self.time_s = 0, 0.0
        self.progress: Callable[[], RunProgress] | None = None

    def answer(self, request: IncomingRequest) -> bytes:
        """Return the answer to a request, JSON."""
        del request
        return json.dumps(self.state()).encode()

    def state(self) -> dict[str, Any]:
        """Return the fields of the answer."""
        count = self._plan.partition.count
        progress = None if self.progress is None else self.progress()
        here = self._presence.shards("alive")
        gone = sorted(set(range(count)) - here)
        found: dict[str, Any] = {
            "run": self._plan.run,
            "ok": True,
            "scene": self._plan.scene,
            "state": "waiting",
            "tick": self.tick,
            "time_s": self.time_s,
            "duration_s": self._duration_s,
            "shards": count,
            "here": count - len(gone),
            "lost": 0,
            "lost_cells": [],
            "waits_s": 0.0,
            "waits_for": [],
        }
        if progress is not None:
            found |= {"tick": progress.tick, "time_s": progress.time_s, **progress.flow}
            found |= {"lost": len(progress.lost), "lost_cells": [list(c) for c in progress.lost[:_LISTED]]}
            found |= self._lateness(progress)
        # Cells that die by the scene's schedule leave a run that has begun, and are not missed.
        missing = gone if progress is None else sorted({self._shard(cell) for cell in progress.lost})
        found |= {"missing": len(missing), "missing_shards": [self._described(s) for s in missing[:_LISTED]]}
        found["processes"] = [self._described(shard) for shard in sorted(here)[:_LISTED]]
        return found

    def _lateness(self, progress: RunProgress) -> dict[str, Any]:
        """Return for how long the tick has not ended, and the shards that it waits for, unless the run is paused."""
        now = time.monotonic()
        if self._seen[0] != progress.tick or progress.flow["state"] == "paused":
            self._seen = (progress.tick, now)
        waits_s = now - self._seen[1]
        late = waits_s > _LATE_S
        return {"waits_s": waits_s, "waits_for": list(progress.awaited[:_LISTED]) if late else []}

    def _shard(self, cell: tuple[int, int]) -> int:
        partition = self._plan.partition
        return int(partition.shard_of[partition.lattice.index(cell)])

    def _described(self, shard: int) -> dict[str, Any]:
        """Return number, name, cells, host and process of a shard, as far as they are known."""
        process = self._plan.processes[1 + shard]
        first, last = process.cells[0], process.cells[-1]
        found: dict[str, Any] = {
            "shard": shard,
            "name": process.name,
            "cells": len(process.cells),
            "first": list(first),
            "last": list(last),
        }
        holder = None if self._holder is None else self._holder(shard)
        if holder is not None and self._presence.process_is_there(shard, holder.process):
            found |= {"host": holder.host, "pid": holder.pid}
        return found
