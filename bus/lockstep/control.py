"""Control plane of a shard: the plant's liveliness token and control records."""

from __future__ import annotations

from collections.abc import Callable
from typing import final

from bus.errors import WireError
from bus.lattice import Lattice
from bus.lockstep.counters import MessageCounters
from bus.lockstep.shard_io import ParticipantMembership
from bus.transports.base import LivelinessChange
from bus.wire.frames import Control, decode_control


def _ignore() -> None:
    """Do nothing."""


@final
class ControlState:
    """State of a run as reported by the plant's token and control records.

    Args:
        lattice: The run's cells.
        membership: Membership to update.
        token: Key of the plant's token.
        counts: Counters to update.

    Attributes:
        resumed: Whether the run was resumed: its start record was counted before.
        plant_seen: Whether the plant's token was ever present.
        plant_lost: Whether the plant's token was present and disappeared.
        stop: The record that ends the run; None until it arrives.
        rejoins_offered: Rejoin records that the shard has not answered yet.
        rejoin_tick: First tick of the shard's own cells after a rejoin; None until known.
        joining: Whether the shard joins a running simulation, and has not been admitted yet.
        on_show: Called when the plant requests the registers once more, for observers.
        snapshot_tick: Tick before which the plant requests a snapshot; -1 if it requests none.
        unanswered: Cells (indices) reported as failed whose loss the plant has not announced yet.
    """

    def __init__(
        self, lattice: Lattice, membership: ParticipantMembership, token: str, counts: MessageCounters
    ) -> None:
        self._lattice = lattice
        self._membership = membership
        self._token = token
        self._counts = counts
        self._faults: list[Control] = []
        self.resumed = False
        self.plant_seen = False
        self.plant_lost = False
        self.stop: Control | None = None
        self.rejoins_offered: list[Control] = []
        self.rejoin_tick: int | None = None
        self.joining = False
        self.on_show: Callable[[], None] = _ignore
        self.snapshot_tick = -1
        self.unanswered: set[int] = set()

    def handle_token(self, event: LivelinessChange) -> None:
        """Record a change of the plant's token; other tokens are ignored."""
        if event.key == self._token:
            self.plant_lost = self.plant_seen and not event.present
            self.plant_seen = self.plant_seen or event.present

    def handle(self, _: int, payload: bytes) -> None:
        """Handle a control record.

        Raises:
            WireError: Not such a payload, or of cells that are not in the array.
        """
        control = decode_control(payload, len(self._lattice))
        if not all(cell in self._lattice for cell in control.cells):
            raise WireError("control", "cells", "names a cell that is not in the array")
        if control.kind == "snapshot" or control.kind == "show":  # no part of the lockstep, and not counted
            self._take_request(control)
            return
        cells = [self._lattice.index(cell) for cell in control.cells]
        match control.kind:
            case "start":
                if self.resumed:
                    return  # counted when the run began
            case "stop":
                self.stop = control
            case "fault":
                if not cells or self._membership.owns(cells):
                    self._faults.append(control)
            case "rejoin_prepare":
                self.rejoins_offered.append(control)
                self._membership.allow_early(cells)
            case "rejoin_commit":
                if self._membership.admit(cells, control.tick):
                    self.rejoin_tick, self.joining = control.tick, False
            case "lost":
                self._mark_lost(cells, control.tick)
        self._counts.delivered += 1

    def _mark_lost(self, cells: list[int], tick: int) -> None:
        """Note the loss of cells (indices)."""
        if (
            self.joining
        ):  # until the shard is admitted, the loss of its own cells is that of the process before it
            cells = [cell for cell in cells if not self._membership.owns([cell])]
        self._membership.mark_lost(cells, tick)
        self.unanswered.difference_update(cells)

    def _take_request(self, control: Control) -> None:
        """Handle a request for a snapshot or for the registers."""
        if control.kind == "snapshot":
            self.snapshot_tick = control.tick
        else:
            self.on_show()

    @property
    def has_faults(self) -> bool:
        """Whether fault records wait for ``drain_faults``."""
        return bool(self._faults)

    def drain_faults(self, tick: int) -> list[Control]:
        """Return the fault records that act in ``tick`` or earlier and were not returned before."""
        if not self._faults:
            return []
        due = [fault for fault in self._faults if fault.tick <= tick]
        self._faults = [fault for fault in self._faults if fault.tick > tick]
        return due
