"""Coulomb's law without any time stepping of its own: an event-driven Filippov solution for a few cells.

Independent of the plant's kernels. Each wheel axis slips one way, slips the other, or sticks. While none changes, the
motion is a smooth ordinary differential equation, integrated by SciPy's DOP853 at 1e-13. A wheel whose slip reaches
zero, a sticking wheel whose force reaches its limit, and a cell that enters or leaves the footprint end a piece. Which
axes stick from there on, and which way the others slip, follows from the accelerations: of all forces within the limits
those that leave the least rate of slip (Filippov's rule under independent wheels, Gauss's principle), a bounded least
squares problem in the forces of the axes at no slip.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853
from scipy.optimize import brentq, lsq_linear

from tests.plant.reference import Bench, Floats

SAMPLES = 8
"""Looks at the event functions in a step of the integrator, ..."""
LONGEST_S = 4e-3
"""... which is no longer."""
Signs = Callable[[Floats], tuple[Floats, list[tuple[str, int]]]]
"""Event functions at a state, and what each is of."""
NONE = 1e-13
"""A slip, m/s, that is none."""
SLIPS = 1e-9
"""A rate of slip, m/s^2, over that of full traction, below which an axis sticks."""


class LiftedError(Exception):
    """A support would pull: this reference knows only those that push."""


@dataclass
class Filippov:
    """A parcel on wheels with Coulomb friction, each axis by itself.

    Attributes:
        bench: cells, wheels' speeds (``steady``), footprint, and ``kappa``: mu g, m/s^2.
        modes: modes that the motion has been in: number of sticking axes, and of slipping ones.
        events: time, kind (``slip ends``, ``stick ends``, ``edge``), cell.
    """

    bench: Bench
    modes: list[tuple[int, int]] = field(default_factory=list)
    events: list[tuple[float, str, int]] = field(default_factory=list)

    def rows(self, y: Floats, cells: NDArray[np.int64]) -> Floats:
        """Velocity of the underside along each wheel axis per velocity of the parcel: ``(2 n, 3)``, x axes first."""
        offset = self.bench.cells[cells] - y[:2]
        zero, one = np.zeros(len(cells)), np.ones(len(cells))
        return np.vstack(
            [np.stack([one, zero, -offset[:, 1]], axis=1), np.stack([zero, one, offset[:, 0]], axis=1)]
        )

    def slip(self, y: Floats, cells: NDArray[np.int64]) -> Floats:
        """Slip of each axis, ``(2 n,)`` m/s."""
        return self.speeds(y)[cells].T.ravel() - self.rows(y, cells) @ y[3:6]

    def speeds(self, _y: Floats) -> Floats:
        """Surface speeds of all wheels, ``(n, 2)`` m/s."""
        return self.bench.steady

    def yielding(self, _y: Floats, cells: NDArray[np.int64]) -> tuple[float, Floats]:
        """How wheels answer to their force per kilogram of the parcel, and how fast their speeds change without it."""
        return 0.0, np.zeros(2 * len(cells))

    def limits(self, y: Floats, cells: NDArray[np.int64]) -> Floats:
        """Largest force of each axis per kilogram, ``(2 n,)`` m/s^2."""
        loads, _ = self.bench.plane_loads(y, cells)
        if loads.min() <= 0.0:
            raise LiftedError
        return np.tile(self.bench.kappa * loads, 2)

    def _inverse(self) -> Floats:
        return np.array([1.0, 1.0, self.bench.mass_over_inertia])

    @staticmethod
    def _turning(y: Floats) -> Floats:
        """Acceleration that has the same effect on slips as the cells' moving under the parcel."""
        return np.array([y[5] * y[4], -y[5] * y[3], 0.0])

    def forces(self, y: Floats, cells: NDArray[np.int64], mode: Floats) -> Floats:
        """Force of each axis: at its limit where it slips, what keeps it from slipping where it sticks."""
        rows, inverse = self.rows(y, cells), self._inverse()
        force = mode * self.limits(y, cells)
        stuck = mode == 0.0
        if stuck.any():
            held = rows[stuck]
            free = inverse * (rows.T @ force) + self._turning(y)
            own, drift = self.yielding(y, cells)
            answer = held @ (inverse[:, None] * held.T) + own * np.eye(len(held))
            force[stuck] = np.linalg.lstsq(answer, drift[stuck] - held @ free, rcond=1e-11)[0]
        return force

    def rate_of(self, y: Floats, cells: NDArray[np.int64], mode: Floats) -> Floats:
        """Time derivative of the state."""
        force = self.forces(y, cells, mode)
        return np.concatenate([y[3:6], self._inverse() * (self.rows(y, cells).T @ force)])

    def next_mode(
        self, y: Floats, cells: NDArray[np.int64], mode: Floats, still: NDArray[np.bool_]
    ) -> Floats:
        """The mode from here on, the axes ``still`` having no slip and the others slipping as in ``mode``."""
        rows, limit, root = self.rows(y, cells), self.limits(y, cells), np.sqrt(self._inverse())
        mode = np.where(still, 0.0, mode)
        if not still.any():
            return mode
        free = self._inverse() * (rows.T @ (mode * limit)) + self._turning(y)
        matrix = root[:, None] * rows[still].T
        bound, wanted = limit[still], -free / root
        own, drift = self.yielding(y, cells)
        drift = drift[still]
        if own > 0.0:
            matrix = np.vstack([matrix, np.sqrt(own) * np.eye(len(bound))])
            wanted = np.concatenate([wanted, drift / np.sqrt(own)])
        found = lsq_linear(matrix, wanted, (-bound, bound), method="bvls", tol=1e-15)
        slip_rate = drift - own * found.x - rows[still] @ (free + root * (matrix[:3] @ found.x))
        mode[still] = np.where(np.abs(slip_rate) > SLIPS * self.bench.kappa, np.sign(slip_rate), 0.0)
        return mode

    def start(self, y: Floats) -> Floats:
        """The whole state where the parcel's is ``y``."""
        return np.array(y, dtype=np.float64)

    def run(self, y: Floats, span: float) -> Floats:
        """State after ``span`` seconds."""
        y = self.start(y)
        cells = self.bench.under(y)
        slip = self.slip(y, cells)
        now, mode = 0.0, self.next_mode(y, cells, np.sign(slip), slip == 0.0)
        for _ in range(2000):
            self.modes.append((int(np.sum(mode == 0.0)), int(np.sum(mode != 0.0))))
            now, y, event = self._piece(now, y, span, cells, mode)
            if event is None:
                return y
            kind, which = event
            still = mode == 0.0
            if kind == "edge":
                self.events.append((now, kind, which))
                kept = dict(zip(cells.tolist(), mode.reshape(2, -1).T, strict=True))
                cells = np.setdiff1d(cells, [which]) if which in cells else np.union1d(cells, [which])
                slip = np.sign(self.slip(y, cells)).reshape(2, -1).T
                mode = np.array([kept.get(cell, slip[k]) for k, cell in enumerate(cells.tolist())]).T.ravel()
                still = mode == 0.0
            else:
                self.events.append((now, kind, int(np.tile(cells, 2)[which])))
                if kind == "slip ends":
                    # with all that end at the same instant
                    still |= np.abs(self.slip(y, cells)) < NONE
                    still[which] = True
                else:
                    # its rate of slip is still zero, and grows the way in which its force gives way
                    mode[which], still[which] = np.sign(self.forces(y, cells, mode)[which]), False
            mode = self.next_mode(y, cells, mode, still)
        raise AssertionError("the reference meets changes without end")

    def _signs(self, cells: NDArray[np.int64], mode: Floats) -> Signs:
        """Event functions, positive within the piece, and what each is of."""
        slipping, sticking = np.flatnonzero(mode != 0.0), np.flatnonzero(mode == 0.0)
        inside = np.where(np.isin(np.arange(len(self.bench.cells)), cells), 1.0, -1.0)
        kinds = [("slip ends", int(k)) for k in slipping] + [("edge", k) for k in range(len(inside))]

        def signs(y: Floats) -> tuple[Floats, list[tuple[str, int]]]:
            values = np.concatenate(
                [(mode * self.slip(y, cells))[slipping], inside * self.bench.depth(y, self.bench.cells)]
            )
            held = self.rows(y, cells)[sticking]
            unique = self.yielding(y, cells)[0] > 0.0
            if len(sticking) == 0 or (not unique and np.linalg.matrix_rank(held, tol=1e-9) < len(sticking)):
                # forces of axes that hold each other are not unique: that they are enough is checked by the caller
                return values, kinds
            force = self.forces(y, cells, mode)[sticking]
            room = self.limits(y, cells)[sticking] - np.abs(force)
            return np.concatenate([values, room]), kinds + [("stick ends", int(k)) for k in sticking]

        return signs

    def _piece(
        self, now: float, y: Floats, span: float, cells: NDArray[np.int64], mode: Floats
    ) -> tuple[float, Floats, tuple[str, int] | None]:
        """The motion in one mode. Returns (time and state where it ends, which event ends it)."""
        signs = self._signs(cells, mode)
        solver = DOP853(
            lambda _, at: self.rate_of(at, cells, mode),
            now,
            y,
            span,
            rtol=1e-13,
            atol=1e-15,
            max_step=LONGEST_S,
        )
        # what has just begun is at its root: followed from where it has left it
        armed = signs(y)[0] > 1e-12
        while solver.status == "running":
            begin = solver.t
            solver.step()
            dense = solver.dense_output()
            times = np.linspace(begin, solver.t, SAMPLES + 1)
            for low, high in pairwise(times.tolist()):
                values, kinds = signs(dense(high))
                wrong = [kinds[k] for k in np.flatnonzero((values < -1e-9) & ~armed)]
                assert not wrong, f"at {high} s a mode is left that has just begun: {wrong}"
                past = [
                    (self._root(signs, dense, low, high, int(k)), kinds[k])
                    for k in np.flatnonzero((values < 0.0) & armed)
                ]
                armed |= values > 1e-12
                if past:
                    first, event = min(past)
                    return first, dense(first), event
            self._check_grip(solver.y, cells, mode)
        return span, solver.y, None

    @staticmethod
    def _root(signs: Signs, dense: Callable[[float], Floats], low: float, high: float, k: int) -> float:
        """Time at which event function ``k`` reaches zero, between two looks."""

        def value(t: float) -> float:
            return float(signs(dense(t))[0][k])

        return float(brentq(value, low, high, xtol=1e-16, rtol=1e-15)) if value(low) > 0.0 else low

    def _check_grip(self, y: Floats, cells: NDArray[np.int64], mode: Floats) -> None:
        """Sticking axes can hold: the rule for the next mode leaves them as they are."""
        stuck = mode == 0.0
        assert np.array_equal(self.next_mode(y, cells, mode, stuck), mode), "a stick has ended unseen"


@dataclass
class LoadedFilippov(Filippov):
    """The same on wheels that start from rest and feel what they pull: their speeds are part of the state.

    Attributes:
        rate: of the motors, 1/s, which would run at ``bench.steady``.
        lightness: mass of the parcel over the inertia of a wheel.
    """

    rate: float = 0.0
    lightness: float = 0.0

    def start(self, y: Floats) -> Floats:
        """Speeds of all wheels, ``(2 n,)`` cell by cell, after the parcel's state."""
        return np.concatenate([y, np.zeros(2 * len(self.bench.cells))])

    def speeds(self, y: Floats) -> Floats:
        """Those of the state."""
        return y[6:].reshape(-1, 2)

    def yielding(self, y: Floats, cells: NDArray[np.int64]) -> tuple[float, Floats]:
        """By their inertia, and as the motors draw them to their speeds."""
        return self.lightness, self.rate * (self.bench.steady - self.speeds(y))[cells].T.ravel()

    def rate_of(self, y: Floats, cells: NDArray[np.int64], mode: Floats) -> Floats:
        """Time derivative of the state."""
        force = self.forces(y, cells, mode)
        wheels = self.rate * (self.bench.steady - self.speeds(y))
        wheels[cells] -= self.lightness * force.reshape(2, -1).T
        return np.concatenate([y[3:6], self._inverse() * (self.rows(y, cells).T @ force), wheels.ravel()])
