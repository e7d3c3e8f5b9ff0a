"""Wheels that feel what they pull (effect ``wheel_load``), between the implicit solver's kernels and the motors."""

from __future__ import annotations

import math
from importlib import import_module
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant.kernels.common import implicit_layout
from plant.specs import PlantSpec
from plant.wheels import Floats


class WheelLoadWorkspace(NamedTuple):
    """Speed loss of loaded wheels under one parcel; workspace of one thread.

    Attributes:
        place: row of each cell in the arrays below, ``(n,)``, -1 for none.
        cell: cell of each row, ``(n,)``.
        now: ``(n, SLOWED)``: see ``plant.kernels.common.implicit_layout``.
        begin: as ``now``, at the start of the step.
        table: ``(4, n, SLOWED)`` after the step in 1 to 4 parts.
        begun: ``(n, 2)`` rates of change at the start of the step.
        ended: as ``begun``, at the accelerations solved last.
        rates: as ``begun``, at the step's event.
        series: ``(n, 2, DEGREE)`` over the step, in unit time; see ``plant.kernels.implicit.dense``.
        travel: ``(DEGREE + 1,)`` scratch for a series.
        row: row of each of ``ImplicitWorkspace.wheels``, ``(capacity,)``.
        ctl: number of rows in use, and of rows handed over, ``(2,)``.
        which: cells handed over, parcel after parcel, ``(2 n,)``.
        written: values handed over of each cell, ``(2 n, SLOWED)``.
    """

    place: NDArray[np.int64]
    cell: NDArray[np.int64]
    now: Floats
    begin: Floats
    table: Floats
    begun: Floats
    ended: Floats
    rates: Floats
    series: Floats
    travel: Floats
    row: NDArray[np.int64]
    ctl: NDArray[np.int64]
    which: NDArray[np.int64]
    written: Floats


def make_slowing(cells: int, capacity: int) -> WheelLoadWorkspace:
    """Scratch for an array of ``cells`` cells and parcels that cover at most ``capacity`` of them.

    Kernels compiled from now on know of wheels that feel what they pull.
    """
    import_module("plant.kernels.effects.loaded_wheels")
    columns = implicit_layout.SLOWED
    return WheelLoadWorkspace(
        place=np.full(cells, -1),
        cell=np.zeros(cells, dtype=np.int64),
        now=np.zeros((cells, columns)),
        begin=np.zeros((cells, columns)),
        table=np.zeros((4, cells, columns)),
        begun=np.zeros((cells, 2)),
        ended=np.zeros((cells, 2)),
        rates=np.zeros((cells, 2)),
        series=np.zeros((cells, 2, 5)),
        travel=np.zeros(6),
        row=np.zeros(capacity, dtype=np.int64),
        ctl=np.zeros(2, dtype=np.int64),
        which=np.zeros(2 * cells, dtype=np.int64),
        written=np.zeros((2 * cells, columns)),
    )


def load_wheels(scene: PlantSpec, law: Floats, mass_kg: float) -> None:
    """Put the wheels' inertia into one parcel's law, if the scene has the effect: with it no force is set-valued."""
    inertia_kg = scene.effects.wheel_inertia_kg
    if inertia_kg is None:
        return
    law[implicit_layout.WHEEL] = inertia_kg / mass_kg
    if law[implicit_layout.SET_VALUED]:
        law[implicit_layout.SET_VALUED], law[implicit_layout.STIFFNESS] = 0.0, math.inf


class WheelLoadSum:
    """Changes of wheel speeds by the parcels of one call, summed independently of threads."""

    def __init__(self) -> None:
        self._blocks: dict[int, tuple[NDArray[np.int64], Floats]] = {}

    def add(self, slowing: WheelLoadWorkspace, first: int) -> None:
        """Take what a thread has written of the parcels from ``first`` on; each number once a call."""
        rows = int(slowing.ctl[implicit_layout.WRITTEN])
        self._blocks[first] = slowing.which[:rows].copy(), slowing.written[:rows].copy()
        slowing.ctl[implicit_layout.WRITTEN] = 0

    def flush(self, total: Floats | None) -> None:
        """Add it all to ``total`` ``(n, SLOWED)``, parcel by parcel: sums don't depend on threads. Then forget it."""
        for _, (cells, slowed) in sorted(self._blocks.items()):
            if total is not None:
                np.add.at(total, cells, slowed)
        self._blocks.clear()
