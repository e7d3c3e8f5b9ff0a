"""The plant's problem as one who knows heyoka would solve it: a Taylor integrator with the cells' edges as events.

The same equations and constants of a support set as ``dop853``, as heyoka expressions, compiled once. heyoka isolates
the roots of an event's own Taylor series, so it loses no crossing either.
"""

from __future__ import annotations

from typing import Any

import heyoka as hy  # pyright: ignore[reportMissingImports]
import numpy as np
from dop853 import Floats, Functions

from plant.specs import PlantSpec

PARS = 14
"""Of the constants, those of the motion; the rest are for the event that a load vanishes, not watched here."""


class HeyokaSide:
    """One compiled integrator for one rectangle on ideal wheels that all cells drive.

    Args:
        spec: the scene's plant.
        functions: of the same scene: a support set's constants, and which cells are covered.
        near: cells whose edges are watched: those that the footprint may reach in the run.
        tolerance: of the integrator.
    """

    def __init__(self, spec: PlantSpec, functions: Functions, near: Any, tolerance: float) -> None:
        parcel = spec.parcels[0]
        assert parcel.size_m is not None
        self._functions, self._near = functions, near
        half = parcel.size_m[0] / 2.0, parcel.size_m[1] / 2.0
        self._half = half
        self._start = np.array([*parcel.position_m, parcel.angle_rad, 0.0, 0.0, 0.0])
        kappa = spec.friction.coefficient_s_per_m * spec.gravity_m_s2
        x, y, th, u, v, om = hy.make_vars("x", "y", "th", "u", "v", "om")
        q = hy.par
        zx, zy = x - q[0], y - q[1]
        fx, fy = q[2] + q[3] * zx + q[4] * zy, q[5] + q[6] * zx + q[7] * zy
        turn = q[8] + q[9] * zx + q[10] * zy - (zx * fy - zy * fx)
        square = q[11] + q[12] * zx + q[13] * zy - (zx * zx + zy * zy)
        spin = kappa * 3.0 / (half[0] ** 2 + half[1] ** 2)
        system = [
            (x, u), (y, v), (th, om),
            (u, kappa * (fx - u)), (v, kappa * (fy - v)), (om, spin * (turn - square * om)),
        ]  # fmt: skip
        c, s = hy.cos(th), hy.sin(th)
        along, across = c * x + s * y, c * y - s * x
        events = []
        for px, py in functions.positions[near]:
            qx, qy = c * px + s * py - along, c * py - s * px - across
            events += [hy.t_event(half[0] ** 2 - qx * qx), hy.t_event(half[1] ** 2 - qy * qy)]
        self._ta = hy.taylor_adaptive(
            system, self._start, pars=[0.0] * PARS, tol=tolerance, t_events=events, compact_mode=True
        )

    def run(self, end_s: float) -> tuple[int, Floats]:
        """From the start to ``end_s``. Returns (cells that entered or left, the last state)."""
        ta, functions = self._ta, self._functions
        ta.time, ta.state[:] = 0.0, self._start
        ta.reset_cooldowns()
        inside = functions.cover(self._start)
        ta.pars[:] = functions.constants(inside)[:PARS]
        crossings = 0
        while True:
            outcome = ta.propagate_until(end_s)[0]
            if outcome == hy.taylor_outcome.time_limit:
                return crossings, ta.state.copy()
            fired, axis = divmod(-int(outcome) - 1, 2)
            i = self._near[fired]
            # an edge's line goes on past its corner: only within it does the cell enter or leave
            x, y, angle = ta.state[:3]
            dx, dy = functions.positions[i] - (x, y)
            c, s = np.cos(angle), np.sin(angle)
            other = abs(c * dy - s * dx) if axis == 0 else abs(c * dx + s * dy)
            if other < self._half[1 - axis]:
                inside[i] = -inside[i]
                crossings += 1
                ta.pars[:] = functions.constants(inside)[:PARS]
