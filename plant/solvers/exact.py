"""The ``exact`` solver: event-driven, analytic between events, no crossing missed.

Between two changes of the support set the motion is a Taylor series (translation linear, rotation linear with
polynomial coefficients), so a step is as long as the series is accurate, and event times are isolated roots of
polynomials. See ``plant/kernels``: ``series`` for the motion, ``events`` and ``roots`` for its events, ``loads`` for
the unilateral normal forces, ``capture`` for chatter.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from plant import geometry
from plant.array import CellArray
from plant.kernels import layout
from plant.specs import ParcelSpec, SolverSpec
from plant.wheels import Floats, WheelMotion

EVENTS_PER_SECOND = 4_000
"""Changes of one parcel's supports in a simulated second beyond which its motion counts as unstable, ..."""
EVENTS_PER_MEMBER = 20
"""... plus this many for every cell that fits under it."""
LOG_CAPACITY = 4096
"""Events of one parcel kept per call; more are counted but not listed."""


class Surface(NamedTuple):
    """The cells and their wheels, as the kernels read them."""

    pos: Floats
    grid: NDArray[np.int64]
    steady: Floats
    decay: Floats
    grip: Floats


class Parcel(NamedTuple):
    """One parcel, as the kernels read and change it (see ``plant.kernels.layout``)."""

    vertices: Floats
    normal: Floats
    offset: Floats
    par: Floats
    y: Floats
    mem: NDArray[np.int64]
    ctl: NDArray[np.int64]


class Work(NamedTuple):
    """Scratch of the kernels; one set serves one thread."""

    where: NDArray[np.int8]
    segs: Floats
    grp: Floats
    ser: Floats
    matrix: Floats
    reply: Floats
    fraction: Floats
    change: Floats
    adds: Floats
    seconds: Floats
    scratch: Floats
    newton: Floats
    found: Floats
    g: Floats
    p: Floats
    q: Floats
    cells: NDArray[np.int64]
    edges: NDArray[np.int64]
    signs: NDArray[np.int64]
    kept: NDArray[np.int64]
    before: Floats
    after: Floats
    state: Floats


class RawEvent(NamedTuple):
    """An event as the kernel logs it, all in float64.

    Attributes:
        after_s: seconds after the start of the call.
        kind: one of the event codes of ``plant.kernels.layout``.
        cell: index, or -1.
        other: the edge, group or second cell, by kind.
    """

    after_s: float
    kind: float
    cell: float
    other: float


def make_work(cells: int, capacity: int) -> Work:
    """Scratch for an array of ``cells`` cells and parcels that cover at most ``capacity`` of them."""
    found = max(64, 2 * capacity)
    return Work(
        where=np.zeros(cells, dtype=np.int8),
        segs=np.zeros((layout.MODES, layout.SEG_SIZE)),
        grp=np.zeros((layout.MAX_GROUPS, layout.GRP_SIZE)),
        ser=np.zeros((layout.SER_ROWS, layout.SER_COLUMNS)),
        matrix=np.zeros((layout.MAX_GROUPS, layout.MAX_GROUPS)),
        reply=np.zeros((4, layout.MAX_GROUPS)),
        fraction=np.zeros(layout.MAX_GROUPS),
        change=np.zeros(layout.MAX_GROUPS),
        adds=np.zeros((layout.MODES, 3)),
        seconds=np.zeros((layout.MODES, layout.MAX_GROUPS)),
        scratch=np.zeros((3, 4)),
        newton=np.zeros((8, 3)),
        found=np.zeros((found, 4)),
        g=np.zeros(layout.SER_COLUMNS),
        p=np.zeros(layout.SER_COLUMNS),
        q=np.zeros(layout.SER_COLUMNS),
        cells=np.zeros(found, dtype=np.int64),
        edges=np.zeros(found, dtype=np.int64),
        signs=np.zeros(found, dtype=np.int64),
        kept=np.zeros((capacity, layout.MEM_COLUMNS), dtype=np.int64),
        before=np.zeros(3),
        after=np.zeros(3),
        state=np.zeros(6),
    )


def make_parcel(spec: ParcelSpec, array: CellArray, kappa: float, rate: float, solver: SolverSpec) -> Parcel:
    """A parcel at its start, its members not yet found.

    Args:
        spec: footprint, mass and start.
        array: the surface.
        kappa: ``mu g``, 1/s.
        rate: of the motors, 1/s; 0 without.
        solver: tolerance and capture.
    """
    corners = geometry.counter_clockwise(spec.polygon())
    centre = spec.centre_of_mass_m or geometry.centroid(spec.polygon())
    vertices = corners - np.array(centre)
    normal, offset = geometry.edges(vertices)
    radius = float(np.max(np.hypot(vertices[:, 0], vertices[:, 1])))
    inertia = spec.inertia_kg_m2 or spec.mass_kg * geometry.polar_moment_per_mass(spec.polygon())
    far = float(np.max(np.abs(array.positions_m))) + radius
    par = np.zeros(layout.PAR_SIZE)
    par[layout.KAPPA] = kappa
    par[layout.MASS_OVER_INERTIA] = spec.mass_kg / inertia
    par[layout.RADIUS] = radius
    par[layout.RATE] = rate
    par[layout.TOLERANCE] = solver.tolerance
    par[layout.CAPTURE] = solver.capture_m
    par[layout.PITCH] = array.pitch_m
    par[layout.ORIGIN_X], par[layout.ORIGIN_Y] = array.origin_m
    par[layout.ON_SURFACE] = 32.0 * np.finfo(np.float64).eps * far
    par[layout.ON_LINE] = 1e-8 * array.pitch_m
    par[layout.MEMORY] = min(1.0 / kappa, 10.0)
    par[layout.GAP] = par[layout.MEMORY]
    across = math.ceil(2.0 * radius / array.pitch_m) + 2
    capacity = min(len(array), across * across) + 1
    return Parcel(
        vertices=np.ascontiguousarray(vertices),
        normal=np.ascontiguousarray(normal),
        offset=np.ascontiguousarray(offset),
        par=par,
        y=np.array([*spec.position_m, spec.angle_rad, *spec.velocity_m_s, spec.angular_velocity_rad_s]),
        mem=np.zeros((capacity, layout.MEM_COLUMNS), dtype=np.int64),
        ctl=np.zeros(layout.CTL_SIZE, dtype=np.int64),
    )


@final
class Exact:
    """Advances parcels that don't touch, each by itself.

    Args:
        array: the surface.
        parcels: footprint, mass and start of each.
        kappa: ``mu g``, 1/s.
        rate: of the motors, 1/s; 0 without.
        spec: tolerance and capture.
    """

    def __init__(
        self, array: CellArray, parcels: tuple[ParcelSpec, ...], kappa: float, rate: float, spec: SolverSpec
    ) -> None:
        from plant.kernels import entry  # compiles or loads: only where a plant is really built

        self._entry: Any = entry
        self._array = array
        self.parcels = [make_parcel(parcel, array, kappa, rate, spec) for parcel in parcels]
        capacity = max((len(parcel.mem) for parcel in self.parcels), default=1)
        self._work = make_work(len(array), capacity)
        self._still: Floats = np.zeros((len(array), 2))
        self._reach = float(np.max(np.hypot(array.sensors_m[:, 0], array.sensors_m[:, 1])))
        self._log: Floats = np.zeros((LOG_CAPACITY, 4))
        self._allowed = [self._refill(parcel) for parcel in self.parcels]
        for parcel in self.parcels:
            self._find_members(parcel)

    def _find_members(self, parcel: Parcel) -> None:
        """Cells under the parcel at its start, the boundary included."""
        c, s = math.cos(parcel.y[layout.THETA]), math.sin(parcel.y[layout.THETA])
        offset = self._array.positions_m - parcel.y[:2]
        body = np.stack([c * offset[:, 0] + s * offset[:, 1], -s * offset[:, 0] + c * offset[:, 1]], axis=1)
        depth = np.min(parcel.offset - body @ parcel.normal.T, axis=1)
        under = np.flatnonzero(depth >= -parcel.par[layout.ON_SURFACE])
        parcel.mem[: len(under), layout.CELL] = under
        parcel.ctl[layout.N_MEMBERS] = len(under)

    @staticmethod
    def _refill(parcel: Parcel) -> float:
        """Changes allowed for every simulated second."""
        return float(EVENTS_PER_SECOND + EVENTS_PER_MEMBER * len(parcel.mem))

    def stand(self, index: int, grip: Floats) -> bool:
        """Find a parcel's loads at its start. False where its supports can't carry it."""
        none = np.zeros(0)
        self.advance(index, WheelMotion(self._still, self._still, 0.0), grip, 0.0, none, np.zeros((0, 6)))
        return bool(self.parcels[index].ctl[layout.STATUS] == layout.MOVING)

    def advance(
        self, index: int, motion: WheelMotion, grip: Floats, span_s: float, times_s: Floats, out: Floats
    ) -> tuple[float, list[RawEvent]]:
        """Move one parcel by ``span_s``; see ``plant.kernels.advance.advance``.

        Returns:
            Seconds moved (less than ``span_s`` where the parcel tipped or its motion is unstable) and its events.
        """
        parcel = self.parcels[index]
        surface = Surface(self._array.positions_m, self._array.grid, motion.steady, motion.decay, grip)
        # a bucket that fills with simulated time and holds one second's worth, so that chatter spread over many
        # short calls is bounded like chatter in a long one
        rate = self._refill(parcel)
        budget = min(self._allowed[index], rate) + rate * span_s
        changes = int(parcel.ctl[layout.N_CHANGES])
        moved = self._entry.advance(surface, parcel, self._work, span_s, int(budget), times_s, out, self._log)
        self._allowed[index] = budget - (int(parcel.ctl[layout.N_CHANGES]) - changes)
        logged = min(int(parcel.ctl[layout.N_LOGGED]), LOG_CAPACITY)
        if not logged:
            return float(moved), []
        return float(moved), [RawEvent(*row) for row in self._log[:logged].tolist()]

    def presence(self, bits: NDArray[np.bool_]) -> None:
        """Set the presence bits ``(n, sensors)`` under every parcel."""
        surface = Surface(
            self._array.positions_m, self._array.grid, self._still, self._still, self._still[:, 0]
        )
        for parcel in self.parcels:
            # a sensor exactly under the edge is covered: the edge of a parcel at rest must not flicker
            slack = 4.0 * parcel.par[layout.ON_SURFACE]
            self._entry.cover(surface, parcel, self._array.sensors_m, self._reach, slack, bits)
