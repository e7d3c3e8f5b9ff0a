"""A small array, and a lockstep of shards that passes their messages by hand."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from bus.fault import FaultInstance
from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.build import CellFaults, MotorFacts, build_controller
from cell_firmware.clocks import ArrayClocks
from cell_firmware.effects.base import ShardContext
from cell_firmware.effects.registry import CellEffects
from cell_firmware.errors import FirmwareFailed
from cell_firmware.faults.base import CellFault
from cell_firmware.firmware import Cells, Firmware
from cell_firmware.shard import FAULTS, BoundaryMessages, Shard, ShardOutputs
from cell_firmware.shard_kernel import Threads
from cell_firmware.specs import CellsSpec
from mdms import Lab

SPEC = CellsSpec()
PITCH_M = 0.1


def cells_of(lattice: Lattice, sensors: int = 1) -> Cells:
    position = np.stack((lattice.columns * PITCH_M, lattice.rows * PITCH_M), axis=1)
    return Cells.of(lattice, position, SPEC.period_s, ((0.0, 0.0),) * sensors, pitch_m=PITCH_M)


@dataclass
class Run:
    """What came of a lockstep: drives ``(ticks, n, 2)`` in the lattice's order, failures, what effects counted."""

    drives: NDArray[np.float64]
    failures: list[FirmwareFailed] = field(default_factory=list)
    counted: Counter[str] = field(default_factory=Counter)


class Lockstep:
    """Steps shards in turn and carries border messages from tick k to tick k + 1.

    The shards' controller is the product's own. With ``live``, faults may be injected later, and serial lines
    go byte by byte. With ``link_ticks``, messages are read so many ticks later.
    """

    def __init__(
        self,
        firmware: Firmware,
        partition: Partition,
        motors: MotorFacts | None = None,
        effects: CellEffects | None = None,
        seed: int = 0,
        clocks: ArrayClocks | None = None,
        faults: Sequence[FaultInstance[CellFault]] = (),
        *,
        live: bool = False,
        threads: Threads | None = None,
        link_ticks: int = 1,
    ) -> None:
        self.partition = partition
        self.lattice = partition.lattice
        asked = CellEffects() if effects is None else effects
        injected = CellFaults(self.lattice, tuple(faults), seed, link_ticks) if faults else None
        tick_ns = SPEC.period_ns if clocks is None else clocks.clocks.window_ns
        self.shards: list[Shard] = []
        self.sites: list[ShardContext] = []
        for s in range(partition.count):
            controller = build_controller(
                firmware, SPEC, asked, motors, clocks, faults=injected, live=live, seed=seed
            )
            site = ShardContext(
                partition.cells(s),
                1,
                controller.link_type,
                seed,
                said=controller.message_type,
                tick_ns=tick_ns,
                clocks=None if clocks is None else clocks.clocks.take(partition.cells(s)),
            )
            self.sites.append(site)
            stages = asked.input_filters(site)
            if injected is not None:
                stages[FAULTS] = injected.stages(site)
            self.shards.append(
                Shard(
                    controller,
                    cells_of(self.lattice),
                    partition,
                    s,
                    stages,
                    faults,
                    link_ticks=link_ticks,
                    threads=threads,
                )
            )
        self.links: list[BoundaryMessages | None] = [None] * partition.count
        self._later = [self.links] * (link_ticks - 1)
        self.tick = 0
        self.failures: list[FirmwareFailed] = []

    def step(
        self, presence: NDArray[np.bool_] | None = None, encoder_m: NDArray[np.float64] | None = None
    ) -> NDArray[np.float64]:
        n = len(self.lattice)
        bits = np.zeros((n, 1), dtype=np.bool_) if presence is None else presence
        drive = np.full((n, 2), np.nan)
        outputs: list[ShardOutputs] = []
        for shard, links in zip(self.shards, self.links, strict=True):
            own = shard.indices
            out = shard.step(self.tick, bits[own], None if encoder_m is None else encoder_m[own], links)
            drive[own] = out.drive
            self.failures += out.failures
            outputs.append(out)
        self._later.append([self._incoming(s, outputs) for s in range(self.partition.count)])
        self.links = self._later.pop(0)
        self.tick += 1
        return drive

    def _incoming(self, shard: int, outputs: list[ShardOutputs]) -> BoundaryMessages | None:
        message = self.shards[shard].message
        if message is None:
            return None
        incoming = self.partition.incoming(shard)
        sent, values = np.zeros(len(incoming), dtype=np.bool_), np.zeros(len(incoming), dtype=message)
        for border in self.partition.incoming_borders(shard):
            theirs = outputs[border.shard].links
            assert theirs is not None
            (there,) = [b for b in self.partition.outgoing_borders(border.shard) if b.shard == shard]
            sent[border.start : border.stop] = theirs.sent[there.start : there.stop]
            values[border.start : border.stop] = theirs.message[there.start : there.stop]
        return BoundaryMessages(sent, values)

    def retire(self, cells: Iterable[tuple[int, int]]) -> None:
        gone = list(cells)
        for shard in self.shards:
            shard.retire(gone)


@pytest.fixture(scope="session")
def grid() -> Callable[..., Lattice]:
    """A rectangle of cells, less some."""

    def make(rows: int, columns: int, missing: Iterable[tuple[int, int]] = ()) -> Lattice:
        holes = set(missing)
        return Lattice((r, c) for r in range(rows) for c in range(columns) if (r, c) not in holes)

    return make


@pytest.fixture(scope="session")
def everything() -> Callable[..., Cells]:
    """All cells of a lattice."""
    return cells_of


@pytest.fixture(scope="session")
def lockstep() -> type[Lockstep]:
    """The lockstep's class."""
    return Lockstep


@pytest.fixture(scope="session")
def run() -> Callable[..., Run]:
    """Runs firmware over a partition for some ticks, with cells that die before given ticks."""

    def go(
        firmware: Firmware,
        partition: Partition,
        ticks: int,
        motors: MotorFacts | None = None,
        dead: Mapping[int, list[tuple[int, int]]] | None = None,
        presence: NDArray[np.bool_] | None = None,
        encoder_m: NDArray[np.float64] | None = None,
        effects: CellEffects | None = None,
        seed: int = 0,
        clocks: ArrayClocks | None = None,
        faults: Sequence[FaultInstance[CellFault]] = (),
        live: bool = False,
    ) -> Run:
        steps = Lockstep(firmware, partition, motors, effects, seed, clocks, faults, live=live)
        drives: list[NDArray[np.float64]] = []
        for k in range(ticks):
            steps.retire((dead or {}).get(k, ()))
            drives.append(
                steps.step(
                    None if presence is None else presence[k], None if encoder_m is None else encoder_m[k]
                )
            )
        counted = Counter[str]()
        for shard in steps.shards:
            counted.update(shard.counters())
        return Run(np.array(drives), steps.failures, counted)

    return go


@pytest.fixture(scope="session")
def watch() -> Callable[..., NDArray[Any]]:
    """Runs firmware as ``run`` does; returns its observed field, ``(ticks, n, ...)``, 0 in dead cells."""

    def go(
        firmware: Firmware,
        lattice: Lattice,
        ticks: int,
        dead: Mapping[int, list[tuple[int, int]]] | None = None,
        presence: NDArray[np.bool_] | None = None,
        effects: CellEffects | None = None,
        seed: int = 0,
    ) -> NDArray[Any]:
        assert firmware.observable is not None
        program = firmware.author
        lab = Lab(
            type(program),
            lattice,
            parameters=program.parameters.model_dump(mode="json", exclude_unset=True),
            presence=None if presence is None else lambda lab: presence[lab.tick],
            faults=[
                {"kind": "crash", "at_tick": tick, "cells": [list(cell) for cell in cells]}
                for tick, cells in (dead or {}).items()
            ],
            effects=None if effects is None else effects.model_dump(mode="json", exclude_unset=True),
            seed=seed,
            check=None,
        )
        return lab.record(firmware.observable, ticks)

    return go
