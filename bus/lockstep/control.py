"""What the plant tells a shard: that it is there, by its token, and what is to happen, by its control records."""

from __future__ import annotations

from typing import final

from bus.errors import WireError
from bus.lattice import Lattice
from bus.lockstep.counters import MessageCounters
from bus.lockstep.shard_io import ParticipantMembership
from bus.transports.base import LivelinessChange
from bus.wire.frames import Control, decode_control


@final
class ControlState:
    """Takes in the plant's token and its control records: tells who takes part, and keeps what others ask for.

    Args:
        lattice: The run's cells.
        company: Told who takes part.
        token: Key of the plant's token.
        counts: Where to count.

    Attributes:
        resumed: Whether the run began before the shard did: that it begins was counted then.
        plant_seen: Whether the plant's token has stood.
        plant_lost: Whether it stood and went.
        stop: The record that ends the run, once it has come.
        joining: Records of cells that come back, which the shard has not answered yet.
        joined: The tick from which the shard's own cells take part again, once it is known.
        asked: The tick before which the plant wants to know what the shard remembers.
        unanswered: Cells (indices) that the shard reported as failed, until the plant has told that they are lost.
    """

    def __init__(
        self, lattice: Lattice, company: ParticipantMembership, token: str, counts: MessageCounters
    ) -> None:
        self._lattice = lattice
        self._company = company
        self._token = token
        self._counts = counts
        self._faults: list[Control] = []
        self.resumed = False
        self.plant_seen = False
        self.plant_lost = False
        self.stop: Control | None = None
        self.rejoins_offered: list[Control] = []
        self.rejoin_tick: int | None = None
        self.snapshot_tick = -1
        self.unanswered: set[int] = set()

    def handle_token(self, event: LivelinessChange) -> None:
        """Takes note of a token that came or went; somebody else's is none of ours."""
        if event.key == self._token:
            self.plant_lost = self.plant_seen and not event.present
            self.plant_seen = self.plant_seen or event.present

    def handle(self, _: int, payload: bytes) -> None:
        """Takes in a control record.

        Raises:
            WireError: Not such a payload, or of cells that are not in the array.
        """
        control = decode_control(payload, len(self._lattice))
        if not all(cell in self._lattice for cell in control.cells):
            raise WireError("control", "cells", "names a cell that is not in the array")
        cells = [self._lattice.index(cell) for cell in control.cells]
        match control.kind:
            case "keep":
                self.snapshot_tick = control.tick
                return  # no part of the lockstep, and not counted
            case "start":
                if self.resumed:
                    return  # counted when the run began
            case "stop":
                self.stop = control
            case "fault":
                if not cells or self._company.owns(cells):
                    self._faults.append(control)
            case "joining":
                self.rejoins_offered.append(control)
                self._company.allow_early(cells)
            case "joined":
                if self._company.admit(cells, control.tick):
                    self.rejoin_tick = control.tick
            case "lost":
                self._company.mark_lost(cells, control.tick)
                self.unanswered.difference_update(cells)
        self._counts.delivered += 1

    def drain_faults(self) -> list[Control]:
        """Faults that have come since the last call."""
        if not self._faults:
            return []
        faults, self._faults = self._faults, []
        return faults
