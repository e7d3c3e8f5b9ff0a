"""The plant's problem as one who knows SciPy and numba would solve it: DOP853, restarted at every event.

Written from the papers' equations alone, without the plant's kernels, for one rectangle on ideal wheels that all
cells drive. Everything that is called per step is compiled; what never changes is frozen into the machine code, so
that a call passes as little as it can.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from plant.array import CellArray
from plant.specs import PlantSpec

Floats = NDArray[np.float64]
Sides = NDArray[np.int8]
"""``(n,)``: +1 for the cells inside the footprint, -1 for the others."""
Events = Literal["one", "each"]
"""One event function for all cells' edges, or one for each cell in reach."""

BETWEEN = 1e-13
"""How far past an edge a cell must be to count as crossed, m: a cell just handled can't cross back by rounding."""


@dataclass(frozen=True)
class Functions:
    """Compiled for one scene; ``q`` are a support set's constants, ``inside`` is `Sides`.

    Attributes:
        positions: ``(n, 2)`` m.
        reach: cells farther from the centre of mass, m, are not watched one by one.
        constants: ``inside -> q``.
        motion: ``t, y, q, inside -> dy/dt``.
        load: event: the first support stops carrying load.
        all_edges: event: the first cell enters or leaves.
        one_edge: event, a cell each: it enters or leaves.
        cover: ``y -> inside``.
        crossed: ``y, inside -> cells that stand on their other side``.
    """

    positions: Floats
    reach: float
    constants: Callable[..., Floats]
    motion: Callable[..., Floats]
    load: Callable[..., float]
    all_edges: Callable[..., float]
    one_edge: list[Callable[..., float]]
    cover: Callable[..., Sides]
    crossed: Callable[..., NDArray[np.int64]]

    @classmethod
    def of(cls, spec: PlantSpec, speeds: Floats) -> Functions:
        """Compile for a scene of one rectangle; ``speeds`` are the wheels', ``(n, 2)`` m/s."""
        positions = CellArray(spec.array).positions_m.copy()
        parcel = spec.parcels[0]
        assert parcel.size_m is not None
        half = parcel.size_m[0] / 2, parcel.size_m[1] / 2
        kappa = spec.friction.coefficient_s_per_m * spec.gravity_m_s2
        reach = float(np.hypot(*half)) + spec.array.pitch_m
        motion = compile_motion(positions, kappa, kappa * 3.0 / (half[0] * half[0] + half[1] * half[1]))
        constants = compile_constants(positions, speeds.copy())
        return cls(
            positions, reach, constants, motion, compile_load(positions), *compile_edges(positions, *half)
        )


def compile_constants(positions: Floats, speeds: Floats) -> Callable[..., Floats]:
    """Loads as ``P [1; X - c]`` about the centroid c, summed into what force and torque need (eqs. 16-23)."""

    @njit
    def constants(inside: Sides) -> Floats:
        members = np.flatnonzero(inside > 0)
        q = np.zeros(18)
        for i in members:
            q[0] += positions[i, 0] / len(members)
            q[1] += positions[i, 1] / len(members)
        xx = xy = yy = 0.0
        for i in members:
            rx, ry = positions[i, 0] - q[0], positions[i, 1] - q[1]
            xx, xy, yy = xx + rx * rx, xy + rx * ry, yy + ry * ry
        determinant = xx * yy - xy * xy
        q[14], q[15], q[16], q[17] = 1.0 / len(members), yy / determinant, -xy / determinant, xx / determinant
        for i in members:
            rx, ry = positions[i, 0] - q[0], positions[i, 1] - q[1]
            turn, square = rx * speeds[i, 1] - ry * speeds[i, 0], rx * rx + ry * ry
            p = (q[14], q[15] * rx + q[16] * ry, q[16] * rx + q[17] * ry)
            for k in range(3):
                q[2 + k] += speeds[i, 0] * p[k]
                q[5 + k] += speeds[i, 1] * p[k]
                q[8 + k] += turn * p[k]
                q[11 + k] += square * p[k]
        return q

    return constants


def compile_motion(positions: Floats, kappa: float, kappa_inertia: float) -> Callable[..., Floats]:
    """The right-hand side on one support set; ``kappa`` is ``mu g``, 1/s, and ``kappa_inertia`` ``mu g m / I``."""

    @njit
    def motion(t: float, y: Floats, q: Floats, inside: Sides) -> Floats:
        zx, zy = y[0] - q[0], y[1] - q[1]
        fx, fy = q[2] + q[3] * zx + q[4] * zy, q[5] + q[6] * zx + q[7] * zy
        turn = q[8] + q[9] * zx + q[10] * zy - (zx * fy - zy * fx)
        square = q[11] + q[12] * zx + q[13] * zy - (zx * zx + zy * zy)
        out = np.empty(6)
        out[0], out[1], out[2] = y[3], y[4], y[5]
        out[3], out[4] = kappa * (fx - y[3]), kappa * (fy - y[4])
        out[5] = kappa_inertia * (turn - square * y[5])
        return out

    return motion


def compile_load(positions: Floats) -> Callable[..., float]:
    """The event that a support stops carrying load."""

    @njit
    def load(t: float, y: Floats, q: Floats, inside: Sides) -> float:
        zx, zy = y[0] - q[0], y[1] - q[1]
        bx, by = q[15] * zx + q[16] * zy, q[16] * zx + q[17] * zy
        least = 1e300
        for i in range(len(inside)):
            if inside[i] > 0:
                least = min(least, q[14] + bx * (positions[i, 0] - q[0]) + by * (positions[i, 1] - q[1]))
        return least

    return terminal(load)


def compile_edges(positions: Floats, length: float, width: float) -> tuple[Any, list[Any], Any, Any]:
    """``all_edges``, ``one_edge``, ``cover`` and ``crossed`` for a rectangle of these half sides, m."""

    @njit
    def margin(i: int, y: Floats, c: float, s: float) -> float:
        """How far cell i lies inside the footprint, m; negative outside."""
        dx, dy = positions[i, 0] - y[0], positions[i, 1] - y[1]
        return min(length - abs(c * dx + s * dy), width - abs(c * dy - s * dx))

    @njit
    def all_edges(t: float, y: Floats, q: Floats, inside: Sides) -> float:
        c, s = np.cos(y[2]), np.sin(y[2])
        least = 1e300
        for i in range(len(inside)):
            least = min(least, inside[i] * margin(i, y, c, s))
        return least + BETWEEN

    @njit
    def edge(y: Floats, inside: Sides, i: int) -> float:
        return inside[i] * margin(i, y, np.cos(y[2]), np.sin(y[2])) + BETWEEN

    def edge_of(i: int) -> Any:
        return terminal(lambda t, y, q, inside: edge(y, inside, i))

    @njit
    def cover(y: Floats) -> Sides:
        c, s = np.cos(y[2]), np.sin(y[2])
        inside = np.empty(len(positions), dtype=np.int8)
        for i in range(len(positions)):
            inside[i] = 1 if margin(i, y, c, s) >= 0.0 else -1
        return inside

    @njit
    def crossed(y: Floats, inside: Sides) -> NDArray[np.int64]:
        over = np.empty(len(inside))
        c, s = np.cos(y[2]), np.sin(y[2])
        for i in range(len(inside)):
            over[i] = inside[i] * margin(i, y, c, s)
        return np.flatnonzero(over <= -0.9 * BETWEEN)

    return terminal(all_edges), [edge_of(i) for i in range(len(positions))], cover, crossed


def terminal(event: Any) -> Any:
    """Mark a function as an event that ends the integration where it falls through zero.

    numba's compiled functions take attributes like any other: SciPy calls the machine code with nothing in between.
    """
    event.terminal, event.direction = True, -1
    return event


def integrate(
    functions: Functions,
    start: Floats,
    end_s: float,
    times_s: Floats | None = None,
    *,
    tolerance: float,
    events: Events,
    max_step: float = np.inf,
) -> tuple[int, Floats]:
    """From ``start`` to ``end_s``, from one event to the next.

    Args:
        functions: compiled for the scene.
        start: ``(6,)`` state.
        end_s: when to stop.
        times_s: ``(T,)``, ascending, the last of them ``end_s``: where states are asked for; None: at the end alone.
        tolerance: ``rtol`` and ``atol``.
        events: one event function for all cells, or one for each in reach.
        max_step: s.

    Returns:
        How many cells entered or left; states ``(T, 6)``, or ``(1, 6)``.
    """
    t, y, crossings = 0.0, start.copy(), 0
    inside = functions.cover(y)
    parts: list[Floats] = []
    while True:
        near = np.flatnonzero(np.hypot(*(functions.positions - y[:2]).T) < functions.reach)
        edges = [functions.all_edges] if events == "one" else [functions.one_edge[i] for i in near]
        solution: Any = solve_ivp(
            functions.motion,
            (t, end_s),
            y,
            method="DOP853",
            t_eval=None if times_s is None else times_s[np.searchsorted(times_s, t, side="right") :],
            events=(functions.load, *edges),
            args=(functions.constants(inside), inside),
            rtol=tolerance,
            atol=tolerance,
            max_step=max_step,
        )
        if times_s is not None and len(solution.t):
            parts.append(solution.y.T)
        if solution.status == 0:
            return crossings, np.concatenate(parts) if parts else solution.y.T[-1:]
        if len(solution.t_events[0]):
            raise RuntimeError(
                f"a support stopped carrying load at {solution.t_events[0][0]:g} s: not written for that"
            )
        fired = [k for k in range(len(edges)) if len(solution.t_events[k + 1])]
        t, y = float(solution.t_events[fired[0] + 1][0]), solution.y_events[fired[0] + 1][0]
        over = functions.crossed(y, inside) if events == "one" else near[fired]
        inside[over] = -inside[over]
        crossings += len(over)
