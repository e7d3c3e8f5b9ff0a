"""Cluster membership on the coordinator's side: expected senders, losses and rejoins."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from typing import final

import numpy as np

from bus.lockstep.counters import Loss, MessageCounters, Reason
from bus.lockstep.intervals import Membership
from bus.lockstep.liveness import LivenessTracker, RejoinTracker
from bus.lockstep.receive import FrameAssembler
from bus.partition import Partition
from bus.wire.format import CoordinatorCodec
from bus.wire.frames import Control, Mask


@final
class CoordinatorMembership:
    """Membership on the coordinator's side: drops and readmits cells, and announces both to the shards.

    Args:
        partition: Partition of the cells into shards.
        form: The plant's side of the wire format.
        roll: Liveness of the run's units.
        drives: Assembler of the drives of live cells.
        counts: Counters to update.
        matched: Whether a unit is subscribed.
        send: Sends a control record to all shards.

    Attributes:
        rejoins: Progress of rejoins.
    """

    def __init__(
        self,
        partition: Partition,
        form: CoordinatorCodec,
        roll: LivenessTracker,
        drives: FrameAssembler,
        counts: MessageCounters,
        *,
        matched: Callable[[int], bool],
        send: Callable[[Control], None],
    ) -> None:
        self._lattice = partition.lattice
        self._shard_of = partition.shard_of
        self._unit_cells = form.unit_cells
        self._roll = roll
        self._drives = drives
        self._counts = counts
        self._send = send
        self._intervals = Membership(len(partition.lattice))
        self._losses: list[Loss] = []
        shards = self._unit_shards = [int(partition.shard_of[cells[0]]) for cells in form.unit_cells]
        units = [[u for u, own in enumerate(shards) if own == s] for s in range(partition.count)]
        self.rejoins = RejoinTracker(roll, units, matched)

    @property
    def unchanged(self) -> bool:
        """Whether no cell ever died: masks of live cells can be skipped."""
        return self._intervals.unchanged

    def live(self, tick: int) -> Mask:
        """Return the mask of cells that are live in ``tick``, ``(n,)``."""
        return self._intervals.live(tick)

    def shards(self, tick: int) -> list[int]:
        """Return the shards with any live cell in ``tick``."""
        return np.unique(self._shard_of[self._intervals.live(tick)]).tolist()

    def mark_dead(self, cells: Iterable[int], tick: int) -> None:
        """Mark ``cells`` (indices) as dead from ``tick`` on."""
        self._intervals.mark_dead(cells, tick)
        self._drives.update_membership(self._intervals.end_by_group(self._unit_cells))

    # --- who goes -------------------------------------------------------------------------------

    def drop_failed(self, tick: int, failed: Iterable[tuple[str, Sequence[int]]]) -> None:
        """Drop, at ``tick``, cells whose process reported a failure, with the reported detail."""
        for detail, cells in failed:
            self._drop(cells, tick, "failed", detail)

    def drop_disconnected(self, tick: int, have: bytearray) -> None:
        """Drop units whose token disappeared before the drive for ``tick``; ``have`` marks units with a drive."""
        # A unit whose drive came before its token went is lost at the next tick.
        gone = [unit for unit in self._roll.unhandled_departures if not have[unit]]
        self._roll.unhandled_departures.difference_update(gone)
        self._drop_units([unit for unit in gone if self._drives.end_tick[unit] > tick], tick, "disconnected")

    def drop_timed_out(self, tick: int, busy: Collection[int] = ()) -> None:
        """Drop units whose drive for ``tick`` is missing, except units of ``busy`` shards."""
        missing = self._drives.missing(tick)
        self._drop_units([u for u in missing if self._unit_shards[u] not in busy], tick, "timed_out")

    def drain_losses(self) -> list[Loss]:
        """Return the losses since the last call, ascending by cell, and clear them."""
        losses, self._losses = self._losses, []
        return sorted(losses, key=lambda loss: loss.cell)

    def _drop_units(self, units: list[int], tick: int, reason: Reason) -> None:
        self._counts.lost += len(units)
        if reason == "timed_out":  # a process that is still there must go before another takes its place
            self._roll.ever_left.difference_update(units)
        before = len(self._losses)
        self._drop([int(i) for unit in units for i in self._unit_cells[unit]], tick, reason)
        for loss in self._losses[before:]:
            self.rejoins.on_left(int(self._shard_of[loss.cell]), (loss.cell,))

    def _drop(self, cells: Iterable[int], tick: int, reason: Reason, detail: str = "") -> None:
        lost = sorted(i for i in cells if self._intervals.end_tick[i] > tick)
        if lost:
            self.mark_dead(lost, tick)
            names = tuple(self._lattice.cells[i] for i in lost)
            self._send(Control("lost", tick, names, detail or reason))
            self._losses += [Loss(i, tick, reason, detail) for i in lost]

    # --- who comes back -------------------------------------------------------------------------

    def admit(self, tick: int) -> list[int]:
        """Readmit cells whose process was replaced and is ready; call between two ticks.

        Args:
            tick: The next.

        Returns:
            Indices of the readmitted cells, ascending. Their drives are expected from ``tick`` on, and the rejoin has
            been announced to all shards.
        """
        if not self.rejoins:
            return []
        names = self._lattice.cells
        for absence in self.rejoins.to_prepare():
            self._send(Control("rejoin_prepare", tick, tuple(names[i] for i in absence.cells)))
        cells = self.rejoins.ready_to_commit(self.shards(tick))
        if cells:
            self._intervals.admit(cells, tick)
            self._drives.admit(
                self._intervals.start_by_group(self._unit_cells),
                self._intervals.end_by_group(self._unit_cells),
            )
            # whoever is new knows nobody who went before
            gone = tuple(names[i] for i in np.flatnonzero(~self._intervals.live(tick)).tolist())
            self._send(Control("lost", 0, gone))
            self._send(Control("rejoin_commit", tick, tuple(names[i] for i in cells)))
        return cells
