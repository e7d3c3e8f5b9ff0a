"""Where a call is divided: where wheels change their motion, or cells read, that a parcel may be near to."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from plant.array import CellArray
from plant.wheels import Floats, WheelRun

BESIDE_M = 1e-6
"""A cell this far outside the footprint may be under it to rounding."""


def margins_m(states: Floats, radius_m: Floats, fastest_m_s: float, span_s: float) -> Floats:
    """How far beyond where its footprint is now a parcel's corners can be within a span, ``(m,)``.

    Traction only draws a parcel towards the wheels' speed. Its centre gains no more speed than its corners and the
    fastest wheels have together; twice that leaves room for what turns it on the way.

    Args:
        states: ``(m, 6)``.
        radius_m: ``(m,)`` farthest corner of each from its centre of mass.
        fastest_m_s: of the wheels.
        span_s: how long.
    """
    speed = np.hypot(states[:, 3], states[:, 4]) + radius_m * np.abs(states[:, 5])
    return 2.0 * (speed + fastest_m_s) * span_s + BESIDE_M


def cells_near(array: CellArray, states: Floats, reach_m: Floats) -> NDArray[np.bool_]:
    """``(n,)`` which cells, or their sensors, may come under one of the parcels.

    Args:
        array: the cells.
        states: ``(m, 6)`` of the parcels.
        reach_m: ``(m,)`` from their centres.
    """
    # wheels may have a width, and sensors a spot: a pitch across and a pitch round at most
    beside = array.pitch_m + array.sensor_reach_m
    near: NDArray[np.bool_] = np.zeros(len(array), dtype=np.bool_)
    for state, reach in zip(states, reach_m.tolist(), strict=True):
        cells = array.within(state[:2], reach + beside)
        away = array.positions_m[cells] - state[:2]
        near[cells[np.hypot(away[:, 0], away[:, 1]) <= reach + beside]] = True
    return near


def ends_s(run: WheelRun, reads_s: Floats, near: NDArray[np.bool_], span_s: float) -> list[float]:
    """When the legs of a call end, s after its start, ascending; the last at ``span_s``.

    Args:
        run: of all wheels.
        reads_s: ``(n,)`` when cells read; infinite: not on the way.
        near: ``(n,)`` the cells that matter.
        span_s: of the call.
    """
    changed = np.zeros(0) if run.changes is None else run.changes.after_s[:, near].ravel()
    found = np.unique(np.concatenate([changed, reads_s[near]]))
    return [*found[found < span_s].tolist(), span_s]
