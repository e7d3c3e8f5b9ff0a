"""The ``scipy`` solver: ``scipy.integrate.solve_ivp`` with terminal events, as one would write it first.

A right-hand side as the papers have it, an event function for every cell near the edge and for every load, and a
restart at each. ``solve_ivp`` looks at the signs of event functions at the ends of its steps: what crosses and comes
back within one is lost. It is here to compare with.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING, Any, final

import numpy as np

from plant.errors import PlantError
from plant.kernels.common import layout
from plant.loads import NO_LOAD, ON_LINE
from plant.solver_api import Segment, SolverEvent
from plant.solver_specs import SciPySpec
from plant.solvers.restarting import EndedError, IntegrationStop, ParcelState, RestartingSolver

if TYPE_CHECKING:
    from plant.array import CellArray
    from plant.loads import Supports
    from plant.solvers.restarting import Cells
    from plant.specs import PlantSpec
    from plant.wheels import Floats, WheelMotion


@final
class SciPy(RestartingSolver):
    """Advances parcels that don't touch, each by itself; a ``plant.solver_api.Solver`` for laws without a jump.

    Args:
        scene: the scene's physics; its law is not set-valued.
        spec: method and tolerance.
        array: the surface.

    Raises:
        PlantError: SciPy is not installed.
    """

    def __init__(self, scene: PlantSpec, spec: SciPySpec, array: CellArray) -> None:
        try:
            self._solve: Any = import_module("scipy.integrate").solve_ivp
        except ImportError:
            raise PlantError(
                'solver.name = "scipy": SciPy is not installed; it comes with the extra accuracy: '
                "pip install 'mdms-emulator[accuracy]'"
            ) from None
        super().__init__(scene, array, spec.max_evaluations_per_s)
        self._spec = spec

    def _integrate(self, parcel: ParcelState, leg: Segment, now_s: float) -> IntegrationStop:
        """See ``RestartingSolver``."""
        forces, until_s, times_s = Forces(self, parcel, leg.motion, leg.grip), leg.span_s, leg.times_s
        signs = EventFunctions(self, parcel)
        y = parcel.shape.y
        reached = signs.reached(now_s, signs(now_s, y))
        if len(reached.crossed) or reached.loads:
            return reached
        wanted = np.flatnonzero(times_s > now_s)
        lead: list[Any] = [forces.drive_at] if self.traction.push_per_load else []
        begun = forces.drive_at(now_s, y) if lead else 0.0
        found = self._solve(
            forces,
            (now_s, until_s),
            y.copy(),
            method=self._spec.method,
            events=[*signs.functions(), *lead],
            dense_output=len(wanted) > 0,
            rtol=self._spec.tolerance,
            atol=self._spec.tolerance,
            max_step=self._spec.max_step_s or np.inf,
        )
        if found.status < 0:
            raise EndedError("no_step")
        at_s = until_s if found.status == 0 else float(found.t[-1])
        for k in wanted[times_s[wanted] <= at_s].tolist():
            leg.out[k] = found.sol(times_s[k])
        y[:] = found.y[:, -1]
        fired = [k for k, times in enumerate(found.t_events[: len(signs)]) if len(times)]
        reached = signs.reached(at_s, signs(at_s, y), *fired)
        if not lead:
            return reached
        noted = self._outrun(parcel, forces, now_s if begun < 0.0 else None, found)
        return reached._replace(noted=noted)

    @staticmethod
    def _outrun(parcel: ParcelState, forces: Forces, since_s: float | None, found: Any) -> list[SolverEvent]:
        """Report the onset of outrunning a wheel; ``since_s``: start of the integration if outrun then, else None."""
        if since_s is None and len(found.t_events[-1]):
            since_s = float(found.t_events[-1][0])
        began, parcel.outrun = not parcel.outrun, forces.drive_at(float(found.t[-1]), found.y[:, -1]) < 0.0
        if since_s is None or not began:
            return []
        return [SolverEvent(since_s, "outrun", forces.outrun)]


class Forces:
    """The right-hand side on one support set: every wheel's pull, summed (eqs. 2, 14 and 15).

    Args:
        solver: whose law it is.
        parcel: on its supports.
        motion: of all wheels.
        grip: ``(n,)`` 1 for a driven cell, 0 for one whose wheels turn freely.
    """

    def __init__(
        self, solver: RestartingSolver, parcel: ParcelState, motion: WheelMotion, grip: Floats
    ) -> None:
        supports = parcel.supports
        assert supports is not None
        self._solver, self._parcel = solver, parcel
        cells = parcel.under[supports.carrying]
        self._law, self._mass, self._weight = solver.traction, parcel.mass_kg, solver.weight_n(parcel)
        self._turn = float(parcel.shape.par[layout.MASS_OVER_INERTIA])
        self._places = solver.array.positions_m[cells]
        self._plane, self._centroid = supports.plane[supports.carrying], supports.centroid_m
        self._steady, self._decay, self._rate = motion.steady[cells], motion.decay[cells], motion.rate
        self._grip = grip[cells, None]
        self._cells = cells
        self.outrun = -1

    def drive_at(self, t: float, y: Floats) -> float:
        """Event: by how much the wheel that leads least leads the parcel, m/s; ``outrun`` is its cell.

        A wheel that stands leads by no more than rounding, and only while the parcel stands on it.
        """
        surface, underside, _ = self._speeds(t, y)
        speed = np.abs(surface)
        least = speed - np.where(surface == 0.0, np.abs(underside), underside * np.sign(surface))
        least = np.where(self._grip > 0.0, least + 1e-9 * speed + 1e-12, np.inf).min(axis=1)
        self.outrun = int(self._cells[np.argmin(least)])
        return float(least.min())

    def _speeds(self, t: float, y: Floats) -> tuple[Floats, Floats, Floats]:
        """Velocity ``(k, 2)`` of the wheels and of the underside above them, and where they are from its centre."""
        lever = self._places - y[:2]
        underside = y[3:5] + y[5] * np.stack([-lever[:, 1], lever[:, 0]], axis=1)
        if not self._rate:
            return self._steady, underside, lever
        return self._steady + self._decay * np.exp(-self._rate * t), underside, lever

    def __call__(self, t: float, y: Floats) -> Floats:
        """``dy/dt`` at ``t`` seconds after the start of the call."""
        self._solver.spend(self._parcel, 1)
        law = self._law
        away = y[:2] - self._centroid
        load = self._weight * np.maximum(self._plane @ np.array([1.0, away[0], away[1]]), 0.0)[:, None]
        surface, underside, lever = self._speeds(t, y)
        slip = law.free_speed * surface - underside
        limit = law.limit + law.limit_per_load * load
        pull = np.clip((law.stiffness + law.stiffness_per_load * load) * slip, -limit, limit)
        pull = self._grip * (pull + law.push_per_load * load * np.sign(surface)) / self._mass
        force = pull.sum(axis=0)
        torque = float(np.sum(lever[:, 0] * pull[:, 1] - lever[:, 1] * pull[:, 0]))
        rate: Floats = np.array([y[3], y[4], y[5], force[0], force[1], self._turn * torque])
        if not np.isfinite(rate).all():
            raise EndedError("not_finite")
        return rate


class EventFunctions:
    """All event functions on one support set; each falls through zero where its event is.

    In this order: every cell near the edge crosses it; every cell under the parcel loses its load or is touched again;
    the centre of mass leaves a line of supports; the parcel has gone so far that other cells are near.

    Args:
        solver: whose surface it is.
        parcel: on its supports.
    """

    def __init__(self, solver: RestartingSolver, parcel: ParcelState) -> None:
        supports = parcel.supports
        assert supports is not None
        shape = parcel.shape
        self._supports: Supports = supports
        self._normal, self._reach = shape.normal.T, shape.offset
        self._start: Floats = shape.y[:2].copy()
        self._pitch = solver.array.pitch_m
        self.near: Cells = solver.array.near(self._start, float(shape.par[layout.RADIUS]) + self._pitch)
        self._places = solver.array.positions_m[self.near]
        self._side = np.where(np.isin(self.near, parcel.under), 1.0, -1.0)
        self._pressed = np.where(supports.carrying, 1.0, -1.0)
        # past an edge by less a cell is on it: one just handled doesn't cross back by rounding
        self._on_edge = float(shape.par[layout.ON_SURFACE])
        self._no_load = 2.0 * NO_LOAD / len(parcel.under)
        self._last: tuple[float, bytes] | None = None
        self._values: Floats = np.zeros(0)

    def __call__(self, t: float, y: Floats) -> Floats:
        """The value of every event function."""
        key = (t, y.tobytes())
        if key == self._last:
            return self._values
        c, s = np.cos(y[2]), np.sin(y[2])
        body = (self._places - y[:2]) @ np.array([[c, -s], [s, c]])
        depth = np.min(self._reach - body @ self._normal, axis=1)
        away = y[:2] - self._supports.centroid_m
        load = self._supports.plane @ np.array([1.0, away[0], away[1]])
        if self._supports.rank < 2:
            # a plane on a line of supports may tilt about it
            load = np.where(self._pressed > 0.0, load, -1.0)
        gone = np.hypot(*(y[:2] - self._start))
        self._last = key
        self._values = np.concatenate(
            [
                self._side * depth + self._on_edge,
                self._pressed * load + self._no_load,
                [1.5 * ON_LINE * self._pitch - self._supports.off_m(y[:2]), 0.9 * self._pitch - gone],
            ]
        )
        return self._values

    def __len__(self) -> int:
        return len(self.near) + len(self._pressed) + 2

    def functions(self) -> list[Callable[[float, Floats], float]]:
        """As ``solve_ivp`` takes them."""
        return [self._function(k) for k in range(len(self))]

    def _function(self, k: int) -> Any:
        def event(t: float, y: Floats) -> float:
            return self(t, y)[k]

        function: Any = event
        function.terminal, function.direction = True, -1.0
        return function

    def reached(self, at_s: float, values: Floats, *fired: int) -> IntegrationStop:
        """Identify the events at given function values; ``fired``: functions that were located at zero.

        ``solve_ivp`` names one event. Simultaneous events are found from the values.
        """
        edges, loads = len(self.near), len(self._pressed)
        happened: Any = np.zeros(len(values), dtype=np.bool_)
        happened[:edges] = values[:edges] <= 0.1 * self._on_edge
        happened[edges : edges + loads] = values[edges : edges + loads] <= 0.1 * self._no_load
        happened[edges + loads] = values[edges + loads] <= 0.0
        happened[list(fired)] = True
        return IntegrationStop(
            at_s, self.near[happened[:edges]], bool(happened[edges : edges + loads + 1].any())
        )
