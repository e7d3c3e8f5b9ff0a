"""Trace of a run for plots, from a recording or straight from the plant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Exit = tuple[str, NDArray[np.float64]]
"""Name of an exit, and its corners ``(v, 2)`` in world coordinates."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunTrace:
    """Trace of a run: scene, parcel states over time, events and faults.

    Attributes:
        title: Of the scene.
        scene: Its name or file.
        pitch_m: Distance of neighbouring cells.
        cells: ``(row, column)`` of each cell, row-major.
        positions_m: ``(n, 2)`` centre of each cell.
        footprints_m: For each parcel ``(v, 2)`` corners about its centre of mass, in its axes.
        time_s: ``(T,)`` instants, rising.
        parcels: ``(T, m, 6)`` states at the instants; NaN while a parcel is not there.
        wheel_speeds: ``(n, 2)`` wheel speeds to draw, m/s, or None.
        exits: Where parcels leave.
        events: Events of the plant, each at least ``time_s`` and ``kind``; ``parcel`` where it has one.
        faults: Faults, each at least ``time_s`` and ``kind``; ``cell`` where it has one.
        rails_m: Corners of each fixed guide rail.
        status: Final status of the run; None where unknown.
    """

    title: str
    scene: str
    pitch_m: float
    cells: Sequence[tuple[int, int]]
    positions_m: NDArray[np.float64]
    footprints_m: Sequence[NDArray[np.float64]]
    time_s: NDArray[np.float64]
    parcels: NDArray[np.float64]
    wheel_speeds: NDArray[np.float64] | None = None
    exits: Sequence[Exit] = ()
    events: Sequence[Mapping[str, Any]] = ()
    faults: Sequence[Mapping[str, Any]] = ()
    rails_m: Sequence[Sequence[tuple[float, float]]] = ()
    status: str | None = None


def mask_absent(
    states: NDArray[np.float64], time_s: NDArray[np.float64], own: int, events: Sequence[Mapping[str, Any]]
) -> NDArray[np.float64]:
    """Return the states with NaN where a parcel has not been fed yet or has left.

    Args:
        states: ``(T, m, 6)``.
        time_s: ``(T,)`` their instants.
        own: How many parcels are there from the start; those after them are fed.
        events: Of the plant, ``fed`` and ``left`` among them; an instant of either shows the parcel.
    """
    fed = {event["parcel"]: event["time_s"] for event in events if event["kind"] == "fed"}
    left = {event["parcel"]: event["time_s"] for event in events if event["kind"] == "left"}
    if own == states.shape[1] and not left:
        return states
    shown = states.copy()
    for parcel in range(own, states.shape[1]):
        shown[time_s < fed.get(parcel, np.inf), parcel] = np.nan
    for parcel, gone_s in left.items():
        shown[time_s > gone_s, parcel] = np.nan
    return shown
