"""Exact crossings of cells and footprint edges while a parcel turns about its centre of mass.

With the centre of mass fixed, a cell at distance r from it in direction a is seen from the parcel at angle theta in
direction ``a - theta``. It is beyond an edge with outward normal in direction n and offset o where
``r cos(a - theta - n) > o``: on an arc of half-width ``acos(o / r)`` about ``theta = a - n``. The cell is under the
parcel outside the union of its edges' arcs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Indices = NDArray[np.intp]

TURN = 2.0 * np.pi
TOGETHER_RAD = 1e-9
"""Crossings closer than this are one change of the cells below: rounding can't separate them, as when an edge passes
over cells of a row together, or a corner only touches one."""
_TOUCHING = 1e-12
"""Of its distance: a cell that is beyond an edge by less, at the one angle at which it is nearest to it, is touched."""


@final
@dataclass(frozen=True, slots=True)
class Crossings:
    """One turn of a parcel over some cells.

    Attributes:
        angles_rad: ``(m,)`` where the cells below change, ascending in [0, 2 pi).
        under: ``(c,)`` which of the cells are below the parcel from the last of these angles round to the first.
        change: ``(t,)`` which angle each crossing is at, ascending.
        cell: ``(t,)`` which cell crosses an edge.
        sign: ``(t,)`` 1 where it comes under the parcel, -1 where it leaves.
    """

    angles_rad: Floats
    under: Bools
    change: Indices
    cell: Indices
    sign: Indices

    def under_after(self, change: int) -> Bools:
        """``(c,)`` which cells are below the parcel between one of the angles and the next."""
        count = self.under.astype(np.intp)
        passed = self.change <= change
        np.add.at(count, self.cell[passed], self.sign[passed])
        return count > 0


def crossings(offsets_m: Floats, normal: Floats, reach_m: Floats) -> Crossings:
    """Follow a convex polygon through one turn about its centre of mass.

    Args:
        offsets_m: ``(c, 2)`` cells, from the centre of mass.
        normal: ``(e, 2)`` outward unit normals of the polygon's edges in its axes.
        reach_m: ``(e,)`` their distances from the centre of mass, as ``plant.geometry.edges`` has them.
    """
    arcs, ends, beyond, never = _arcs(offsets_m, normal, reach_m)
    # cell by cell: how many arcs it is in from 0 on, and how many from each end of an arc on
    at_start = np.sum(beyond & (ends < arcs), axis=1)
    angle = np.where(np.concatenate([beyond, beyond], axis=1), np.concatenate([arcs, ends], axis=1), np.inf)
    step = np.concatenate([beyond.astype(np.intp), -beyond.astype(np.intp)], axis=1)
    order = np.argsort(angle, axis=1, kind="stable")
    angle, step = np.take_along_axis(angle, order, axis=1), np.take_along_axis(step, order, axis=1)
    after = at_start[:, None] + np.cumsum(step, axis=1)
    before = after - step
    crossed = ((before == 0) != (after == 0)) & ~never[:, None]
    cell, _ = np.nonzero(crossed)
    sign = np.where(after[crossed] == 0, 1, -1)
    under = (at_start == 0) & ~never
    return _together(angle[crossed], under, cell, sign)


def _arcs(offsets_m: Floats, normal: Floats, reach_m: Floats) -> tuple[Floats, Floats, Bools, Bools]:
    """Compute the arc in which each cell is beyond each edge.

    Returns:
        Begin and end of each arc and whether the arc exists, ``(c, e)`` each, then whether the cell is beyond some edge
        at all angles, ``(c,)``.
    """
    distance = np.hypot(offsets_m[:, 0], offsets_m[:, 1])[:, None]
    toward = np.arctan2(offsets_m[:, 1], offsets_m[:, 0])[:, None] - np.arctan2(normal[:, 1], normal[:, 0])
    # by its tangent: the angle of a cell that only just passes an edge keeps its digits
    half = np.arctan2(np.sqrt(np.maximum((distance - reach_m) * (distance + reach_m), 0.0)), reach_m)
    begins, ends = np.mod(toward - half, TURN), np.mod(toward + half, TURN)
    for angle in (begins, ends):
        angle[angle >= TURN] = 0.0  # what a negative angle smaller than rounding becomes
    least = distance * (1.0 - _TOUCHING)
    return begins, ends, least > np.abs(reach_m), np.any(reach_m <= -least, axis=1)


def _together(angle: Floats, under: Bools, cell: Indices, sign: Indices) -> Crossings:
    """The crossings in order, those at one angle as one change; cells that come and leave at once don't count."""
    order = np.argsort(angle, kind="stable")
    angle, cell, sign = angle[order], cell[order], sign[order]
    count = under.astype(np.intp)
    breaks = 1 + np.flatnonzero(np.diff(angle) > TOGETHER_RAD)
    if len(breaks) and angle[0] + TURN - angle[-1] <= TOGETHER_RAD:
        # one change astride zero: it begins with what the end of the turn has of it
        last = int(breaks[-1])
        np.subtract.at(count, cell[last:], sign[last:])
        angle, cell, sign = np.roll(angle, -last), np.roll(cell, -last), np.roll(sign, -last)
        angle[: len(angle) - last] -= TURN
        breaks = 1 + np.flatnonzero(np.diff(angle) > TOGETHER_RAD)
    starts = np.concatenate([[0], breaks]).astype(np.intp)[: len(angle)]
    stops = np.concatenate([breaks, [len(angle)]]).astype(np.intp)[: len(starts)]
    change = np.repeat(np.arange(len(starts)), stops - starts)
    key, which = np.unique(change * len(under) + cell, return_inverse=True)
    total = np.bincount(which, weights=sign, minlength=len(key)).astype(np.intp)
    key, total = key[total != 0], total[total != 0]
    real, change = np.unique(key // max(len(under), 1), return_inverse=True)
    middle = np.maximum(0.5 * (angle[starts] + angle[stops - 1]), 0.0)
    return Crossings(middle[real], count > 0, change, key % max(len(under), 1), total)
