"""Readings of label scanners (effect ``scanners``)."""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import NDArray

from bus import elementary
from plant.array import CellArray
from plant.effects.feeders.spec import FeedersSpec
from plant.effects.scanners.spec import ScannersSpec
from plant.kernel_data import make_parcel
from plant.kernels.common import layout
from plant.kernels.common.footprint import EDGE_SLACK
from plant.parcel_spec import ParcelSpec
from plant.wheels import Floats

Labels = NDArray[np.int64]


@final
class Scanners:
    """Readers at the centres of some cells; a centre is under a parcel exactly where a presence sensor there says so.

    Args:
        spec: which cells have one.
        feeders: the exits, which are numbered from 1 in their order.
        array: where the cells are.
        parcels: all that are there or will be fed.
    """

    def __init__(
        self, spec: ScannersSpec, feeders: FeedersSpec, array: CellArray, parcels: tuple[ParcelSpec, ...]
    ) -> None:
        rows, columns = zip(*spec.cells, strict=True)
        self._every = array.grid[list(rows), list(columns)]
        self._array = array
        self.keep(np.ones(len(array), dtype=np.bool_))
        self._label: Labels = np.array([feeders.number(parcel.destination) for parcel in parcels], np.int64)
        made = [make_parcel(parcel, array) for parcel in parcels]
        edges = max((len(parcel.offset) for parcel in made), default=0)
        self._normal: Floats = np.zeros((len(made), edges, 2))
        self._offset: Floats = np.full((len(made), edges), np.inf)  # an edge that is none keeps nobody out
        self._slack: Floats = np.zeros(len(made))
        for i, parcel in enumerate(made):
            self._normal[i, : len(parcel.normal)] = parcel.normal
            self._offset[i, : len(parcel.offset)] = parcel.offset
            self._slack[i] = EDGE_SLACK * parcel.par[layout.ON_SURFACE]

    def keep(self, there: NDArray[np.bool_]) -> None:
        """Only those of the cells read from now on that are ``there`` ``(n,)``."""
        self._cells = self._every[there[self._every]]
        self._at_m = self._array.positions_m[self._cells]

    def label(self, state: Floats, there: NDArray[np.int64]) -> Labels:
        """``(n,)``: number of the exit that the parcel over each scanner is meant for; 0 elsewhere, and for none.

        Args:
            state: ``(m, 6)`` of all parcels.
            there: which of them are on the surface; where two overlap, the first is read.
        """
        found: Labels = np.zeros(len(self._array), dtype=np.int64)
        if not len(there):
            return found
        here = state[there]
        c, s = elementary.cos(here[:, 2])[:, None], elementary.sin(here[:, 2])[:, None]
        dx, dy = self._at_m[:, 0] - here[:, :1], self._at_m[:, 1] - here[:, 1:2]
        x, y = (c * dx + s * dy)[..., None], (c * dy - s * dx)[..., None]
        normal = self._normal[there, None]
        depth = self._offset[there, None] - normal[..., 0] * x - normal[..., 1] * y
        under = (depth >= -self._slack[there, None, None]).all(axis=2)
        found[self._cells] = np.where(under.any(axis=0), self._label[there][under.argmax(axis=0)], 0)
        return found
