"""A floor of cells in one array, whose state is seen, and round parcels that go as the wheels under them say."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bus.lattice import OPPOSITE, Lattice
from cell_firmware.firmware import Cells, Firmware, Inbox, Inputs, Outbox

PERIOD_S, PITCH_M = 0.02, 0.1
Floats = NDArray[np.float64]


@dataclass
class Disc:
    """A parcel without inertia: at its centre the field of the wheels under it, as loads that balance weigh them."""

    place: Floats
    radius_m: float = 0.16


class Floor:
    """Cells in lockstep, their messages passed by hand, and parcels on them."""

    def __init__(self, firmware: Firmware, lattice: Lattice, discs: Iterable[Disc] = ()) -> None:
        self.firmware, self.lattice = firmware, lattice
        place = np.stack((lattice.columns * PITCH_M, lattice.rows * PITCH_M), axis=1)
        self.cells = Cells.of(lattice, place, PERIOD_S, pitch_m=PITCH_M)
        firmware.check_geometry(lattice, place, PITCH_M)
        self.state: dict[str, Any] = dict(firmware.init(self.cells))
        self.discs = list(discs)
        self.dead = np.zeros(len(lattice), dtype=np.bool_)
        self.said = Outbox.empty(len(lattice), firmware.message)  # pyright: ignore[reportArgumentType]
        self.drive = np.zeros((len(lattice), 2))

    def under(self, disc: Disc) -> NDArray[np.bool_]:
        return np.hypot(*(self.cells.position_m - disc.place).T) <= disc.radius_m

    def inbox(self) -> Inbox:
        received = np.zeros((len(self.lattice), 4), dtype=np.bool_)
        message = np.zeros((len(self.lattice), 4), dtype=self.firmware.message)
        for side in range(4):
            from_cell = self.lattice.neighbours[:, side]
            there = (from_cell >= 0) & self.said.sent[from_cell, OPPOSITE[side]]
            received[there, side] = True
            message[there, side] = self.said.message[from_cell[there], OPPOSITE[side]]
        return Inbox(received, message)

    def step(self, ticks: int = 1, lost: Any = None) -> None:
        """Lets some ticks pass; ``lost`` draws which messages never arrive."""
        for _ in range(ticks):
            presence = np.zeros((len(self.lattice), 1), dtype=np.bool_)
            for disc in self.discs:
                presence[:, 0] |= self.under(disc)
            inbox = self.inbox()
            if lost is not None:
                gone = lost(inbox.received.shape)
                inbox.received[gone] = False
                inbox.message[gone] = np.zeros((), dtype=inbox.message.dtype)
            for array in self.state.values():
                array.flags.writeable = False
            after, outputs = self.firmware.step(self.state, Inputs(presence, None, inbox))
            self.state = dict(after)
            assert outputs.outbox is not None
            self.said = Outbox(outputs.outbox.sent & ~self.dead[:, None], outputs.outbox.message)
            self.drive = np.where(self.dead[:, None], 0.0, outputs.speed_m_s)
            for disc in self.discs:
                under = self.under(disc) & ~self.dead
                if np.count_nonzero(under) >= 3:
                    away = self.cells.position_m[under] - disc.place
                    plane = np.hstack((np.ones((len(away), 1)), away))
                    disc.place = disc.place + PERIOD_S * np.linalg.lstsq(plane, self.drive[under])[0][0]

    def forget(self, cell: int) -> None:
        """Resets a cell: its memory is as after power-on."""
        fresh = self.firmware.init(self.cells)
        for name, array in self.state.items():
            changed = array.copy()
            changed[cell] = fresh[name][cell]
            self.state[name] = changed
