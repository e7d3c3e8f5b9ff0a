"""The ``exact`` solver: event-driven, analytic between events, no crossing missed.

Between two changes of the support set the motion is a Taylor series (translation linear, rotation linear with
polynomial coefficients), so a step is as long as the series is accurate, and event times are isolated roots of
polynomials. See ``plant/kernels``: ``series`` for the motion, ``events`` and ``roots`` for its events, ``loads`` for
the unilateral normal forces, ``capture`` for chatter.
"""

from __future__ import annotations

from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from plant.array import CellArray
from plant.kernels import layout
from plant.kernels.parcels import Parcel
from plant.solver_specs import ExactSpec
from plant.solvers.threaded import Desk, Errand, ThreadedSolver
from plant.specs import ParcelSpec
from plant.wheels import Floats

EVENTS_PER_SECOND = 4_000
"""Changes of one parcel's supports in a simulated second beyond which its motion counts as unstable, ..."""
EVENTS_PER_MEMBER = 20
"""... plus this many for every cell that fits under it."""


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


@final
class Exact(ThreadedSolver[Work]):
    """Advances parcels that don't touch, each by itself; a ``plant.solvers.solver.Solver`` for the viscous law.

    Args:
        array: the surface.
        parcels: footprint, mass and start of each.
        kappa: ``mu g``, 1/s.
        rate: of the motors, 1/s; 0 without.
        spec: tolerance and capture.
    """

    def __init__(
        self, array: CellArray, parcels: tuple[ParcelSpec, ...], kappa: float, rate: float, spec: ExactSpec
    ) -> None:
        from plant.kernels import entry  # compiles or loads: only where a plant is really built
        from plant.kernels.block import ALLOWANCE_SIZE

        super().__init__(array, parcels, rate)
        self._entry: Any = entry
        self._allowance: Floats = np.zeros((len(parcels), ALLOWANCE_SIZE))
        for parcel, allowance in zip(self.parcels, self._allowance, strict=True):
            _prepare(parcel, kappa, spec)
            allowance[:] = EVENTS_PER_SECOND + EVENTS_PER_MEMBER * len(parcel.mem)

    def _make_work(self) -> Work:
        return make_work(len(self._array), self.capacity)

    def _advance_block(self, desk: Desk[Work], block: NDArray[np.int64], errand: Errand) -> tuple[int, int]:
        surface, span_s, times_s, out = errand
        return self._entry.advance_block(
            surface,
            self.packed,
            desk.work,
            self._allowance,
            block,
            span_s,
            times_s,
            out,
            desk.log,
            desk.report,
        )


def _prepare(parcel: Parcel, kappa: float, spec: ExactSpec) -> None:
    """Add what this solver needs to know of a parcel."""
    par = parcel.par
    par[layout.KAPPA] = kappa
    par[layout.TOLERANCE] = spec.tolerance
    par[layout.CAPTURE] = spec.capture_m
    par[layout.MEMORY] = min(1.0 / kappa, 10.0)
    par[layout.GAP] = par[layout.MEMORY]
