"""A second plant, written as plainly as can be, to check the first against.

Nothing here knows of Taylor series, moments of support sets or root isolation. Every call of the right-hand side goes
over all supports with the sums as the paper writes them; loads come from a general least-norm solver; SciPy integrates
at 1e-13 from one support change to the next, and the changes are found by looking at every cell many times a step.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853
from scipy.optimize import nnls

Floats = NDArray[np.float64]


def balances(points: Floats, centre: Floats) -> Floats:
    """The ``(3, n)`` rows of force and both moments about ``centre``, lengths in units of the points' spread."""
    offset = points - centre
    # the lever of one support right under the centre is rounding
    scale = max(float(np.max(np.abs(offset))), 1e-3)
    return np.vstack([np.ones(len(points)), offset.T / scale])


def least_norm_loads(points: Floats, centre: Floats) -> Floats | None:
    """Loads (share of the weight) of the least norm that balance and don't pull; None where there are none.

    Least distance programming (Lawson and Hanson, Solving Least Squares Problems, chapter 23) with the equalities as
    pairs of inequalities, then one exact solve on the supports found.
    """
    a = balances(points, centre)
    b = np.array([1.0, 0.0, 0.0])
    n = len(points)
    g = np.vstack([a, -a, np.eye(n)])
    h = np.concatenate([b, -b, np.zeros(n)])
    e = np.vstack([g.T, h])
    f = np.zeros(n + 1)
    f[-1] = 1.0
    u, misfit = nnls(e, f, maxiter=50 * n + 100)
    if misfit < 1e-9:
        return None
    r = e @ u - f
    loads = -r[:-1] / r[-1]
    carrying = loads > 1e-11
    exact = np.zeros(n)
    exact[carrying] = np.linalg.lstsq(a[:, carrying], b, rcond=1e-12)[0]
    return exact


def is_least_norm(points: Floats, centre: Floats, loads: Floats, tolerance: float = 1e-9) -> str:
    """Check the optimality conditions of ``least_norm_loads``; the empty string, or what fails.

    The problem is strictly convex, so loads that balance, don't pull, lie on one plane where they carry and have that
    plane not above zero where they don't are the solution, however they were found.
    """
    a = balances(points, centre)
    if loads.min() < -1e-14:
        return f"a cell pulls: {loads.min()}"
    misfit = np.abs(a @ loads - [1.0, 0.0, 0.0]).max()
    if misfit > 1e-12:
        return f"out of balance by {misfit}"
    carrying = loads > 1e-13
    plane, *_ = np.linalg.lstsq(a[:, carrying].T, loads[carrying], rcond=1e-12)
    off = np.abs(a[:, carrying].T @ plane - loads[carrying]).max()
    if off > tolerance:
        return f"not on a plane by {off}"
    if np.linalg.matrix_rank(a[:, carrying], tol=1e-9) == 3 and not carrying.all():
        above = (a[:, ~carrying].T @ plane).max()
        if above > tolerance:
            return f"a lifted cell would be pressed: {above}"
    return ""


@dataclass
class Bench:
    """A parcel on cells.

    Attributes:
        cells: ``(n, 2)`` positions, m.
        steady, decay: ``(n, 2)`` wheel velocity is ``steady + decay exp(-rate t)``, t from the start of a call.
        corners: ``(v, 2)`` footprint about the centre of mass, counter-clockwise.
        kappa: mu g, 1/s.
        mass_over_inertia: 1/m².
        grip: ``(n,)`` 1 for a driven wheel, 0 for a coasting one.
    """

    cells: Floats
    steady: Floats
    corners: Floats
    kappa: float
    mass_over_inertia: float
    rate: float = 0.0
    decay: Floats | None = None
    grip: Floats | None = None
    samples: int = 24
    longest_step: float = 0.02
    events: list[tuple[float, str, int]] = field(default_factory=list)

    def body(self, y: Floats, cells: Floats) -> Floats:
        c, s = np.cos(y[2]), np.sin(y[2])
        offset = cells - y[:2]
        return offset @ np.array([[c, -s], [s, c]])

    def depth(self, y: Floats, cells: Floats) -> Floats:
        """How far inside the footprint each cell lies, m."""
        edge = np.roll(self.corners, -1, axis=0) - self.corners
        normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1) / np.hypot(edge[:, 0], edge[:, 1])[:, None]
        reach = np.sum(normal * self.corners, axis=1)
        return np.min(reach - self.body(y, cells) @ normal.T, axis=1)

    def under(self, y: Floats) -> NDArray[np.int64]:
        return np.flatnonzero(self.depth(y, self.cells) >= 0.0)

    def plane_loads(self, y: Floats, supports: NDArray[np.int64]) -> tuple[Floats, Floats]:
        """Loads of ``supports`` when all are in contact (least norm), and their plane about the centre of mass."""
        offset = self.cells[supports] - y[:2]
        a = np.vstack([np.ones(len(supports)), offset.T])
        loads = np.linalg.lstsq(a, np.array([1.0, 0.0, 0.0]), rcond=1e-11)[0]
        plane = np.linalg.lstsq(a.T, loads, rcond=1e-11)[0]
        return loads, plane

    def rates(self, t: float, y: Floats, supports: NDArray[np.int64]) -> Floats:
        """The right-hand side with ``supports`` in contact, eqs. 2, 14 and 15 as they are written."""
        loads, _ = self.plane_loads(y, supports)
        velocity = self.steady[supports]
        if self.decay is not None:
            velocity = velocity + self.decay[supports] * np.exp(-self.rate * t)
        offset = self.cells[supports] - y[:2]
        under = y[3:5] + y[5] * np.stack([-offset[:, 1], offset[:, 0]], axis=1)
        pull = self.pull(loads, velocity, under)
        if self.grip is not None:
            pull = pull * self.grip[supports][:, None]
        force = pull.sum(axis=0)
        torque = float(np.sum(offset[:, 0] * pull[:, 1] - offset[:, 1] * pull[:, 0]))
        return np.array([y[3], y[4], y[5], force[0], force[1], self.mass_over_inertia * torque])

    def pull(self, loads: Floats, velocity: Floats, under: Floats) -> Floats:
        """Force of the wheels ``(n, 2)`` per kilogram: viscous, eq. 14.

        Args:
            loads: ``(n,)`` shares of the weight.
            velocity: ``(n, 2)`` of the wheels, m/s.
            under: ``(n, 2)`` of the underside above them, m/s.
        """
        return self.kappa * loads[:, None] * (velocity - under)

    def contact(self, y: Floats, members: NDArray[np.int64]) -> NDArray[np.int64] | None:
        """Which of the cells under the parcel carry load."""
        loads, _ = self.plane_loads(y, members)
        if loads.min() >= -1e-13:
            exact = balances(self.cells[members], y[:2]) @ loads
            if abs(exact[1:]).max() < 1e-9:
                return members
        found = least_norm_loads(self.cells[members], y[:2])
        return None if found is None else members[found > 0.0]

    def run(self, y: Floats, span: float) -> Floats:
        """State after ``span`` seconds. Support changes are appended to ``events`` with the time from here."""
        y = np.array(y, dtype=np.float64)
        members = self.under(y)
        now, drift = 0.0, np.append(y[3:], np.zeros(3))
        for _ in range(4000):
            # a load that has just reached zero is told by where it is a moment later
            active = self.contact(y + 1e-7 * drift, members)
            if active is None:
                active = self.contact(y, members)
            if active is None:
                self.events.append((now, "tip", -1))
                return y
            now, y, members, drift = self._segment(now, y, span, members, active)
            if now >= span:
                return y
        raise AssertionError("the reference meets changes without end")

    def _solver(self, t: float, y: Floats, until: float, active: NDArray[np.int64], step: float) -> DOP853:
        return DOP853(
            lambda at, state: self.rates(at, state, active),
            t,
            y,
            until,
            rtol=1e-13,
            atol=1e-15,
            max_step=self.longest_step,
            first_step=min(step, abs(until - t)) or None,
        )

    def _flags(self, y: Floats, near: NDArray[np.int64], inside: NDArray[np.bool_], members, active, lifted):
        """Signs whose change is an event: near cells inside or not, supports pushed, lifted ones clear."""
        depth = self.depth(y, self.cells[near])
        _, plane = self.plane_loads(y, active)
        load = plane[0] + (self.cells[members] - y[:2]) @ plane[1:]
        return depth, load

    def _segment(self, now: float, y: Floats, span: float, members, active):
        radius = float(np.max(np.hypot(*self.corners.T))) + 1e-9
        lifted = np.setdiff1d(members, active)
        solver = self._solver(now, y, span, active, 1e-3)
        state = np.isin(np.arange(len(self.cells)), members)
        spans_plane = (
            np.linalg.matrix_rank(self.cells[active] - self.cells[active].mean(axis=0), tol=1e-9) == 2
        )
        first = True
        while True:
            begin_t, begin_y = solver.t, solver.y.copy()
            solver.step()
            assert solver.status != "failed"
            dense = solver.dense_output()
            times = np.linspace(begin_t, solver.t, self.samples + 1)[1:]
            if first:
                times = np.concatenate([begin_t + (times[0] - begin_t) * np.array([1e-3, 1e-2, 0.1]), times])
            first = False
            reach = radius + float(np.hypot(*(solver.y[:2] - begin_y[:2]))) + 0.05 * radius
            near = np.flatnonzero(np.hypot(*(self.cells - begin_y[:2]).T) < reach)
            last = begin_t
            for t in times:
                change = self._changed(dense(t), near, state, active, lifted, spans_plane)
                if change:
                    return self._locate(
                        begin_t, begin_y, dense, last, t, change, members, active, spans_plane
                    )
                last = t
            if solver.status == "finished":
                return span, solver.y, members, np.zeros(6)

    def _changed(self, y: Floats, near, state, active, lifted, spans_plane) -> list[tuple[str, int]]:
        depth = self.depth(y, self.cells[near])
        change = [("edge", int(i)) for i in near[(depth >= 0.0) != state[near]]]
        _, plane = self.plane_loads(y, active)
        pushed = plane[0] + (self.cells[active] - y[:2]) @ plane[1:]
        change += [("load", int(i)) for i in active[pushed < 0.0]]
        if spans_plane and len(lifted):
            clear = plane[0] + (self.cells[lifted] - y[:2]) @ plane[1:]
            change += [("load", int(i)) for i in lifted[clear > 0.0]]
        return change

    def _locate(self, begin_t, begin_y, dense, low, high, change, members, active, spans_plane):
        """The earliest change between ``low`` and ``high``, by bisection, then the state there by integration."""

        def sign(t: float, kind: str, cell: int) -> float:
            y = dense(t)
            if kind == "edge":
                return float(self.depth(y, self.cells[[cell]])[0])
            _, plane = self.plane_loads(y, active)
            return float(plane[0] + (self.cells[cell] - y[:2]) @ plane[1:])

        times = []
        for kind, cell in change:
            after = sign(high, kind, cell) >= 0.0
            a, b = low, high
            while b - a > 4e-16 * max(1.0, b):
                middle = 0.5 * (a + b)
                if middle in (a, b):
                    break
                if (sign(middle, kind, cell) >= 0.0) == after:
                    b = middle
                else:
                    a = middle
            times.append(b)
        earliest = min(times)
        solver = self._solver(begin_t, begin_y, earliest, active, 1.0)
        while solver.status == "running":
            solver.step()
        y = solver.y
        for (kind, cell), t in zip(change, times, strict=True):
            if t - earliest > 1e-11:
                continue
            if kind == "edge":
                entering = cell not in members
                members = np.union1d(members, [cell]) if entering else np.setdiff1d(members, [cell])
                self.events.append((earliest, "in" if entering else "out", cell))
            else:
                self.events.append((earliest, "load", cell))
        drift = self.rates(earliest, y, active)
        return earliest + 1e-11, y + 1e-11 * drift, members, drift
