"""Parcels and cells as compiled kernels read them, for every solver built on these kernels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant import geometry
from plant.array import CellArray
from plant.kernels import implicit_layout, layout
from plant.solvers.solver import Body, Ending, SolverEvent
from plant.specs import ParcelSpec
from plant.wheels import Floats

LOG_CAPACITY = 4096
"""Events of one parcel kept per call; more are counted but not listed."""

KINDS = {
    layout.ENTER: "support_gained",
    layout.LEAVE: "support_lost",
    layout.UNLOAD: "load_vanished",
    layout.TOUCH: "load_returned",
    layout.ONLY_NEAR: "released",
    layout.ONLY_FAR: "released",
    layout.CORNER: "released",
    layout.CAPTURE_BEGINS: "captured",
    implicit_layout.OUTRAN: "outrun",
}
"""Words of the plant's events, by the kernels' codes."""

ENDINGS: dict[int, Ending] = {
    layout.MOVING: "moving",
    layout.TIPPED: "tipped",
    layout.TOO_MANY_EVENTS: "endless_changes",
    layout.NOT_FINITE: "not_finite",
    layout.NO_LOADS: "no_loads",
    implicit_layout.ENDLESS_STEPS: "endless_steps",
    implicit_layout.NOT_SOLVED: "not_solved",
}
"""How a call ended, by the kernels' codes."""


class Springs(NamedTuple):
    """The cells' springs under one parcel, where they are not all equal (see ``plant.kernels.uneven_springs``).

    Attributes:
        rate: ``(n,)`` over the mean.
        height: ``(n,)`` m.
        per_m: mean rate over the parcel's weight, 1/m.
        span: largest height, over the sag of one mean spring under the whole parcel.
        moments: ``(3,)`` scratch: ``sum k h`` and ``sum k h r`` of the active supports.
    """

    rate: Floats
    height: Floats
    per_m: float
    span: float
    moments: Floats


class Surface(NamedTuple):
    """The cells and their wheels, as the kernels read them.

    What is None by default belongs to effects: a kernel is compiled for what is there, and for nothing else.
    """

    pos: Floats
    grid: NDArray[np.int64]
    steady: Floats
    decay: Floats
    grip: Floats
    springs: Springs | None = None


class Parcel(NamedTuple):
    """One parcel, as the kernels read and change it (see ``plant.kernels.layout``)."""

    vertices: Floats
    normal: Floats
    offset: Floats
    par: Floats
    y: Floats
    mem: NDArray[np.int64]
    ctl: NDArray[np.int64]


def make_parcel(spec: ParcelSpec, array: CellArray) -> Parcel:
    """A parcel at its start with the cells under it, and without what only one solver needs to know.

    Args:
        spec: footprint, mass and start.
        array: the surface.
    """
    corners = geometry.counter_clockwise(spec.polygon())
    centre = spec.centre_of_mass_m or geometry.centroid(spec.polygon())
    vertices = corners - np.array(centre)
    normal, offset = geometry.edges(vertices)
    radius = float(np.max(np.hypot(vertices[:, 0], vertices[:, 1])))
    inertia = spec.inertia_kg_m2 or spec.mass_kg * geometry.polar_moment_per_mass(spec.polygon())
    far = float(np.max(np.abs(array.positions_m))) + radius
    par = np.zeros(layout.PAR_SIZE)
    par[layout.MASS_OVER_INERTIA] = spec.mass_kg / inertia
    par[layout.RADIUS] = radius
    par[layout.PITCH] = array.pitch_m
    par[layout.ORIGIN_X], par[layout.ORIGIN_Y] = array.origin_m
    par[layout.ON_SURFACE] = 32.0 * np.finfo(np.float64).eps * far
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
    _find_members(parcel, array)
    return parcel


def _find_members(parcel: Parcel, array: CellArray) -> None:
    """Cells under the parcel at its start, the boundary included."""
    c, s = math.cos(parcel.y[layout.THETA]), math.sin(parcel.y[layout.THETA])
    offset = array.positions_m - parcel.y[:2]
    body = np.stack([c * offset[:, 0] + s * offset[:, 1], -s * offset[:, 0] + c * offset[:, 1]], axis=1)
    depth = np.min(parcel.offset - body @ parcel.normal.T, axis=1)
    under = np.flatnonzero(depth >= -parcel.par[layout.ON_SURFACE])
    parcel.mem[: len(under), layout.CELL] = under
    parcel.ctl[layout.N_MEMBERS] = len(under)


def body_of(parcel: Parcel) -> Body:
    """The parcel as the plant sees it; shares its state."""
    return Body(parcel.vertices, float(parcel.par[layout.RADIUS]), parcel.y)


def members(parcel: Parcel) -> NDArray[np.int64]:
    """Indices of the cells under the parcel."""
    return parcel.mem[: int(parcel.ctl[layout.N_MEMBERS]), layout.CELL].copy()


def logged(parcel: Parcel, log: Floats) -> Sequence[SolverEvent]:
    """What the kernel noted in the last call, without the tipping."""
    count = min(int(parcel.ctl[layout.N_LOGGED]), len(log))
    if not count:
        return ()
    return [
        SolverEvent(after_s, KINDS[int(kind)], int(cell))
        for after_s, kind, cell, _ in log[:count].tolist()
        if int(kind) != layout.TIP
    ]


class SensorCover:
    """Which presence sensors lie under parcels.

    Args:
        array: the surface.
    """

    def __init__(self, array: CellArray) -> None:
        from plant.kernels import entry  # compiles or loads: only where a plant is really built

        self._entry: Any = entry
        self._sensors_m = array.sensors_m
        self._reach = float(np.max(np.hypot(array.sensors_m[:, 0], array.sensors_m[:, 1])))
        still: Floats = np.zeros((len(array), 2))
        self._surface = Surface(array.positions_m, array.grid, still, still, still[:, 0])

    def mark(self, parcels: Sequence[Parcel], bits: NDArray[np.bool_]) -> None:
        """Set the presence bits ``(n, sensors)`` under the parcels."""
        for parcel in parcels:
            # a sensor exactly under the edge is covered: the edge of a parcel at rest must not flicker
            slack = 4.0 * parcel.par[layout.ON_SURFACE]
            self._entry.cover(self._surface, parcel, self._sensors_m, self._reach, slack, bits)
