"""Parcels and cells as compiled kernels read them, for every solver built on these kernels."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, final, overload

import numpy as np
from numpy.typing import NDArray

from plant import geometry
from plant.array import CellArray
from plant.kernels.common import implicit_layout, layout
from plant.kernels.common.parcels import Parcel, Parcels
from plant.kernels.common.surface import Surface
from plant.parcel_spec import ParcelSpec
from plant.solver_api import Body, Ending, SolverEvent
from plant.wheels import Floats

KINDS = {
    layout.ENTER: "support_gained",
    layout.LEAVE: "support_lost",
    layout.UNLOAD: "load_vanished",
    layout.TOUCH: "load_returned",
    layout.ONLY_NEAR: "released",
    layout.ONLY_FAR: "released",
    layout.CORNER: "released",
    layout.CAPTURE_BEGINS: "captured",
    layout.OUTRAN: "outrun",
}
"""Words of the plant's events, by the kernels' codes."""

ENDINGS: dict[int, Ending] = {
    layout.MOVING: "moving",
    layout.TIPPED: "tipped",
    layout.TOO_MANY_EVENTS: "endless_changes",
    layout.NOT_FINITE: "not_finite",
    layout.NO_LOADS: "no_loads",
    layout.ENDLESS_STEPS: "endless_steps",
    layout.STOPPED: "stopped",
    implicit_layout.NOT_SOLVED: "not_solved",
}
"""How a call ended, by the kernels' codes."""


def make_parcel(spec: ParcelSpec, array: CellArray) -> Parcel:
    """Build the kernels' data of a parcel at its start, without solver-specific fields.

    Args:
        spec: footprint, mass and start.
        array: the surface.
    """
    corners = geometry.counter_clockwise(spec.polygon())
    centre = spec.centre_of_mass_m or geometry.centroid(spec.polygon())
    vertices = corners - np.array(centre)
    normal, offset = geometry.edges(vertices)
    radius = float(np.max(np.hypot(vertices[:, 0], vertices[:, 1])))
    par = np.zeros(layout.PAR_SIZE)
    par[layout.MASS_OVER_INERTIA] = spec.mass_kg / spec.moment_of_inertia_kg_m2()
    par[layout.RADIUS] = radius
    par[layout.PITCH] = array.pitch_m
    par[layout.ORIGIN_X], par[layout.ORIGIN_Y] = array.origin_m
    par[layout.ON_SURFACE] = 32.0 * np.finfo(np.float64).eps * (array.far_m + radius)
    par[layout.ON_LINE] = 1e-8 * array.pitch_m
    across = math.ceil(2.0 * radius / array.pitch_m) + 2
    capacity = min(len(array), across * across) + 1
    parcel = Parcel(
        vertices=np.ascontiguousarray(vertices),
        normal=np.ascontiguousarray(normal),
        offset=np.ascontiguousarray(offset),
        par=par,
        y=np.array([*spec.position_m, spec.angle_rad, *spec.velocity_m_s, spec.angular_velocity_rad_s]),
        mem=np.zeros((capacity, layout.MEM_COLUMNS), dtype=np.int64),
        ctl=np.zeros(layout.CTL_SIZE, dtype=np.int64),
    )
    parcel.ctl[layout.CULPRIT] = layout.NO_CELL
    find_members(parcel, array)
    return parcel


def find_members(parcel: Parcel, array: CellArray) -> None:
    """Find the cells under the parcel where it is, the boundary included; each carries load until found otherwise."""
    under = cells_under(parcel, array)
    parcel.mem[: len(under)] = 0
    parcel.mem[: len(under), layout.CELL] = under
    parcel.ctl[layout.N_MEMBERS] = len(under)


def cells_under(parcel: Parcel, array: CellArray) -> NDArray[np.int64]:
    """The cells under the parcel where it is, the boundary included; ascending."""
    near = array.within(parcel.y[:2], float(parcel.par[layout.RADIUS]))
    c, s = math.cos(parcel.y[layout.THETA]), math.sin(parcel.y[layout.THETA])
    offset = array.positions_m[near] - parcel.y[:2]
    body = np.stack([c * offset[:, 0] + s * offset[:, 1], -s * offset[:, 0] + c * offset[:, 1]], axis=1)
    depth = np.min(parcel.offset - body @ parcel.normal.T, axis=1)
    return near[depth >= -parcel.par[layout.ON_SURFACE]]


def cells_changed(
    parcel: Parcel, under: NDArray[np.int64], cells: NDArray[np.int64], array: CellArray
) -> list[SolverEvent]:
    """Which of the cells that have come or gone were under a parcel, or are now, as events of this instant.

    Args:
        parcel: where it is.
        under: cells known to be under it before.
        cells: that have come or gone.
        array: as it is now.
    """
    lost, gained = np.intersect1d(under, cells), np.intersect1d(cells_under(parcel, array), cells)
    return [
        *(SolverEvent(0.0, "support_lost", cell) for cell in lost.tolist()),
        *(SolverEvent(0.0, "support_gained", cell) for cell in gained.tolist()),
    ]


def body_of(parcel: Parcel) -> Body:
    """The parcel as the plant sees it; shares its state."""
    return Body(parcel.vertices, float(parcel.par[layout.RADIUS]), parcel.y)


def members(parcel: Parcel) -> NDArray[np.int64]:
    """Indices of the cells under the parcel."""
    return parcel.mem[: int(parcel.ctl[layout.N_MEMBERS]), layout.CELL].copy()


def pack(parcels: Sequence[Parcel]) -> Parcels:
    """The parcels side by side in arrays of their own; ``plant.kernels.common.select.parcel_view`` finds each again."""

    def joined(name: str, empty: NDArray[Any]) -> NDArray[Any]:
        return np.concatenate([empty, *(getattr(parcel, name) for parcel in parcels)])

    def starts(lengths: Sequence[int]) -> NDArray[np.int64]:
        return np.cumsum([0, *lengths], dtype=np.int64)

    m = len(parcels)
    return Parcels(
        corner=starts([len(parcel.vertices) for parcel in parcels]),
        vertices=joined("vertices", np.zeros((0, 2))),
        normal=joined("normal", np.zeros((0, 2))),
        offset=joined("offset", np.zeros(0)),
        slot=starts([len(parcel.mem) for parcel in parcels]),
        mem=joined("mem", np.zeros((0, layout.MEM_COLUMNS), dtype=np.int64)),
        par=joined("par", np.zeros(0)).reshape(m, layout.PAR_SIZE),
        y=joined("y", np.zeros(0)).reshape(m, 6),
        ctl=joined("ctl", np.zeros(0, dtype=np.int64)).reshape(m, layout.CTL_SIZE),
    )


@final
class LoggedEvents(Sequence[SolverEvent]):
    """Events that a kernel logged for one parcel, except tipping, converted on iteration.

    Threads that move parcels don't convert events: conversion needs the interpreter lock, which one thread holds at a
    time.

    Args:
        rows: Log ``(k, 4)``, kept without copying; see ``plant.kernels.common.layout``.
    """

    def __init__(self, rows: Floats) -> None:
        tipped = len(rows) > 0 and rows[-1, layout.EV_KIND] == layout.TIP
        self._rows = rows[:-1] if tipped else rows

    def __len__(self) -> int:
        return len(self._rows)

    def __iter__(self) -> Iterator[SolverEvent]:
        after_s: list[float] = self._rows[:, layout.EV_TIME].tolist()
        codes: list[int] = self._rows[:, layout.EV_KIND].astype(np.int64).tolist()
        cells: list[int] = self._rows[:, layout.EV_CELL].astype(np.int64).tolist()
        return map(SolverEvent, after_s, [KINDS[code] for code in codes], cells)

    @overload
    def __getitem__(self, index: int) -> SolverEvent: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[SolverEvent]: ...
    def __getitem__(self, index: int | slice) -> SolverEvent | Sequence[SolverEvent]:
        return list(self)[index]


class SensorCover:
    """Which presence sensors lie under parcels.

    Args:
        array: the surface.
    """

    def __init__(self, array: CellArray) -> None:
        from plant.kernels.exact import entry  # compiles or loads: only where a plant is really built

        self._entry: Any = entry
        self._sensors_m = array.sensors_m
        self._reach = array.sensor_reach_m
        still: Floats = np.zeros((len(array), 2))
        # not a column of ``still``: that of one cell is contiguous and others are not, two types to numba
        self._surface = Surface(array.positions_m, array.grid, still, still, np.zeros(len(array)))

    def mark(self, parcels: Parcels, indices: NDArray[np.int64], bits: NDArray[np.bool_]) -> None:
        """Set the presence bits ``(n, sensors)`` under those of the parcels."""
        self._entry.cover(self._surface, parcels, indices, self._sensors_m, self._reach, bits)
