"""A world of tiles without physics: parcels move as the wheels under them do on the average, and do not turn."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.build import build_controller
from cell_firmware.effects.base import ShardContext
from cell_firmware.effects.registry import CellEffects
from cell_firmware.firmware import Cells
from cell_firmware.shard import Shard
from cell_firmware.specs import CellsSpec
from cell_firmware.tiles.firmware import TileFirmware
from cell_firmware.tiles.tiling import Tile

PERIOD_S, PITCH_M = 0.016, 0.1
HALF_M = np.array([0.14, 0.11])
"""Half of a parcel's length and width."""


@dataclass(eq=False)
class Parcel:
    """A parcel, its exit's number, and where it is."""

    exit: int
    centre_m: NDArray[np.float64]


@dataclass
class World:
    """Parcels that wait at entries, ride, and leave; all cells are one shard, which a label reader in each helps.

    Attributes:
        queues: By entry, the exits of the parcels that wait there.
        riding: Those on the array.
        left: Exit that each came to, and its own, in the order in which they left.
        met: How often two parcels overlapped.
        seen: Presence bits of every tick.
    """

    firmware: TileFirmware
    queues: dict[Tile, list[int]]
    effects: CellEffects = field(default_factory=CellEffects)
    seed: int = 0
    riding: list[Parcel] = field(default_factory=list[Parcel])
    left: list[tuple[int, int]] = field(default_factory=list[tuple[int, int]])
    met: int = 0
    tick: int = 0
    seen: list[NDArray[np.bool_]] = field(default_factory=list[NDArray[np.bool_]])

    def __post_init__(self) -> None:
        tiling = self.firmware.tiling
        rows, columns = (size * tiling.side for size in tiling.shape)
        self.lattice = Lattice(
            (row, column)
            for row in range(rows)
            for column in range(columns)
            if tiling.used[row // tiling.side, column // tiling.side]
        )
        self.place_m = (np.stack((self.lattice.columns, self.lattice.rows), axis=1) + 0.5) * PITCH_M
        cells = Cells.of(self.lattice, self.place_m, PERIOD_S, pitch_m=PITCH_M)
        self.firmware.check(self.lattice)
        partition = Partition.even(self.lattice, 1)
        spec, clock = CellsSpec(period_s=PERIOD_S), self.effects.clock
        clocks = None if clock is None else clock.clocks(self.lattice, spec.period_ns, self.seed)
        controller = build_controller(self.firmware, spec, self.effects, None, clocks)
        self.tick_s = PERIOD_S if clocks is None else clocks.clocks.window_ns * 1e-9
        stages = self.effects.input_filters(
            ShardContext(partition.cells(0), 1, controller.link_type, self.seed)
        )
        self.shard = Shard(controller, cells, partition, 0, stages)
        self.living = np.ones(len(self.lattice), dtype=np.bool_)

    def middle_m(self, tile: Tile) -> NDArray[np.float64]:
        """Centre of a tile."""
        return (np.array([tile[1], tile[0]]) + 0.5) * self.firmware.tiling.side * PITCH_M

    def kill(self, cells: Iterable[tuple[int, int]]) -> None:
        """These cells neither speak nor drive any more."""
        gone = list(cells)
        self.shard.retire(gone)
        self.living[[self.lattice.index(cell) for cell in gone]] = False

    def run(self, ticks: int) -> World:
        """So many ticks, or until nobody is there or waits."""
        for _ in range(ticks):
            if not self.riding and not any(self.queues.values()):
                break
            self._step()
        return self

    def _step(self) -> None:
        for entry, queue in self.queues.items():
            spot = self.middle_m(entry)
            if queue and all(np.abs(p.centre_m - spot).max() > 0.38 for p in self.riding):
                self.riding.append(Parcel(queue.pop(0), spot + np.array([0.02, -0.02])))
        over = [(np.abs(self.place_m - parcel.centre_m) <= HALF_M).all(axis=1) for parcel in self.riding]
        label = np.zeros(len(self.lattice), dtype=np.int64)
        for parcel, under in zip(self.riding, over, strict=True):
            label[under] = parcel.exit
        presence = (label > 0)[:, None]
        self.seen.append(presence)
        drive = self.shard.step(self.tick, presence, label=label).drive
        self.tick += 1
        for parcel, under in zip(self.riding, over, strict=True):
            pulls = under & self.living
            if pulls.any():
                parcel.centre_m = parcel.centre_m + self.tick_s * drive[pulls].mean(axis=0)
        self.met += sum(
            bool((np.abs(one.centre_m - other.centre_m) < 2 * HALF_M).all())
            for i, one in enumerate(self.riding)
            for other in self.riding[:i]
        )
        for parcel in list(self.riding):
            self._let_out(parcel)

    def _let_out(self, parcel: Parcel) -> None:
        """Exits are the outer 15 cm of their tiles, in the east."""
        tiling = self.firmware.tiling
        side_m = tiling.side * PITCH_M
        row, column = (int(parcel.centre_m[axis] // side_m) for axis in (1, 0))
        inside = row < tiling.shape[0] and column < tiling.shape[1]
        number = int(tiling.exit[row, column]) if inside else 0
        if number and parcel.centre_m[0] > (column + 1) * side_m - 0.15:
            self.left.append((number, parcel.exit))
            self.riding.remove(parcel)

    def tiles(self, name: str) -> NDArray[Any]:
        """A register, of the cell that leads each tile first: ``(tiles,)``."""
        names, registers = self.shard.registers()
        side, values = self.firmware.tiling.side, registers[f"firmware.{name}"]
        first = {
            (row, column): value for (row, column), value in zip(names.tolist(), values.tolist(), strict=True)
        }
        return np.array(
            [first[row * side + 1, column * side + 1] for row, column in self.firmware.tiling.tiles()]
        )
