"""The ``heyoka`` solver: its adaptive Taylor integrator, edges and loads as events whose roots it isolates.

The one other integrator that loses no crossing: like ``exact`` it has the Taylor series of an event function on a step,
and isolates the polynomial's roots. It is here to check with. The equations are its expressions, compiled once a
parcel; a support set and the cells in reach are parameters, sums that a change of supports replaces.
"""

from __future__ import annotations

import math
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar, final

import numpy as np

from bus.state import StateFields
from plant.errors import PlantError
from plant.kernels.common import layout
from plant.loads import NO_LOAD, ON_LINE
from plant.solver_api import Segment
from plant.solver_specs import HeyokaSpec
from plant.solvers.restarting import EndedError, IntegrationStop, ParcelState, RestartingSolver

if TYPE_CHECKING:
    from plant.array import CellArray
    from plant.solvers.restarting import Cells
    from plant.specs import PlantSpec
    from plant.wheels import Floats, WheelMotion

SUMS = 7
"""Weighted sums over the wheels that the motion needs, each affine in the place: see ``Course.sums``."""
DECAYING = 3
"""Those of them that go with the wheels' velocities; motors have as many more, which decay."""
COOLDOWN_S = 1e-10
"""After an event its function is checked again: heyoka's own choice grows as the function's rate vanishes, up to
microseconds at a graze, and whatever it finds twice changes nothing (``Course.reached``)."""
MARGIN = 0.5
"""How far, over the pitch, a parcel may go before cells are searched that have come into reach."""


@final
class Heyoka(RestartingSolver):
    """Advances parcels that don't touch, each by itself; a ``plant.solver_api.Solver`` for linear laws.

    Args:
        scene: the scene's physics; its law is linear in the slip.
        spec: tolerance.
        array: the surface.
        rate: of the motors, 1/s; 0 without.

    Raises:
        PlantError: heyoka is not installed.
    """

    # Integrators save no state: what heyoka's objects hold can't be read, and a run on them has no checkpoints.
    state_fields: ClassVar[StateFields] = StateFields("_integrators")

    def __init__(self, scene: PlantSpec, spec: HeyokaSpec, array: CellArray, rate: float) -> None:
        try:
            self._hy: Any = import_module("heyoka")
        except ImportError:
            raise PlantError(
                'solver.name = "heyoka": heyoka is not installed; it comes with the extra accuracy: '
                "pip install 'mdms-emulator[accuracy]'"
            ) from None
        super().__init__(scene, array, spec.max_steps_per_s)
        self._integrators = [
            HeyokaIntegrator(self._hy, self, parcel, rate, spec.tolerance) for parcel in self._parcels
        ]

    def _integrate(self, parcel: ParcelState, leg: Segment, now_s: float) -> IntegrationStop:
        """See ``RestartingSolver``."""
        (own,) = (own for own in self._integrators if own.parcel is parcel)
        if own.gone:
            own.settle(now_s)
        own.load(leg.motion, leg.grip)
        until_s, times_s = leg.span_s, leg.times_s
        wanted = np.flatnonzero(times_s > now_s)
        self.spend(parcel, 0)
        ended: list[EndedError] = []

        def goes_on(_: Any) -> bool:
            try:
                self.spend(parcel, 1)
            except EndedError as error:
                ended.append(error)
            return not ended

        outcome, _, _, _, dense, _ = own.integrator.propagate_until(
            until_s, c_output=len(wanted) > 0, callback=goes_on
        )
        kinds = self._hy.taylor_outcome
        if outcome == kinds.err_nf_state:
            raise EndedError("not_finite")
        event = -int(outcome) - 1
        if outcome not in (kinds.time_limit, kinds.cb_stop) and not 0 <= event < own.events:
            raise EndedError("no_step")
        at_s = until_s if outcome == kinds.time_limit else float(own.integrator.time)
        for k in wanted[times_s[wanted] <= at_s].tolist():
            leg.out[k] = own.state(dense(times_s[k]))
        parcel.shape.y[:] = own.state(own.integrator.state)
        if ended:
            raise EndedError(ended[0].ending, at_s)
        return own.reached(at_s, None if outcome == kinds.time_limit else event)


class HeyokaIntegrator:
    """One parcel's compiled integrator and the present values of its parameters.

    Positions are relative to ``origin_m``, near the parcel: the expressions' x and y.

    Args:
        hy: the heyoka module.
        solver: solver with the surface and the law.
        parcel: parcel at its start.
        rate: rate of the motors, 1/s; 0 without motors.
        tolerance: tolerance of the integrator.

    Attributes:
        parcel: parcel that is integrated.
        integrator: heyoka's integrator.
        events: number of event functions.
        gone: whether ``settle`` must be called: other cells may have come into reach, or a call has ended.
    """

    def __init__(
        self, hy: Any, solver: RestartingSolver, parcel: ParcelState, rate: float, tolerance: float
    ) -> None:
        self.parcel, self._solver = parcel, solver
        self._origin_m: Floats = parcel.shape.y[:2].copy()
        self._near: Cells = np.zeros(0, dtype=np.int64)
        self.gone = True
        pitch, radius = solver.array.pitch_m, float(parcel.shape.par[layout.RADIUS])
        self._reach_m = radius + MARGIN * pitch
        self._slots = _most_cells(self._reach_m / pitch)
        self._loads = _most_cells(radius / pitch)
        self._motors = rate > 0.0
        self._pars_at = np.cumsum(
            [0, 3 * (SUMS + DECAYING * self._motors), 3 * self._slots, 3 * self._loads, 6]
        ).tolist()
        system, events = self._expressions(hy, rate)
        self.events = len(events)
        self.integrator: Any = hy.taylor_adaptive(
            system,
            np.zeros(6),
            pars=np.zeros(self._pars_at[-1]),
            tol=tolerance,
            t_events=[hy.t_event(event, cooldown=COOLDOWN_S) for event in events],
            compact_mode=True,
        )

    # --- what is compiled once --------------------------------------------------------------------------------------

    def _expressions(self, hy: Any, rate: float) -> tuple[list[Any], list[Any]]:
        """The equations of motion, and the event functions: edges slot by slot, loads, off a line, out of reach."""
        x, y, th, u, v, om = hy.make_vars("x", "y", "th", "u", "v", "om")
        sums_at, slots_at, loads_at, lines_at, _ = self._pars_at

        def affine(at: int) -> Any:
            return hy.par[at] + hy.par[at + 1] * x + hy.par[at + 2] * y

        weight, first_x, first_y, second, fx, fy, turn = (affine(sums_at + 3 * k) for k in range(SUMS))
        if self._motors:
            left = hy.exp(-rate * hy.time)
            fx, fy, turn = (
                now + left * affine(sums_at + 3 * (SUMS + k)) for k, now in enumerate((fx, fy, turn))
            )
        arm_x, arm_y = first_x - weight * x, first_y - weight * y
        square = second - 2.0 * (x * first_x + y * first_y) + (x * x + y * y) * weight
        torque = turn - (x * fy - y * fx) - (arm_x * v - arm_y * u) - om * square
        system = [
            (x, u), (y, v), (th, om),
            (u, fx - weight * u + om * arm_y), (v, fy - weight * v - om * arm_x),
            (om, float(self.parcel.shape.par[layout.MASS_OVER_INERTIA]) * torque),
        ]  # fmt: skip
        events: list[Any] = []
        c, s = hy.cos(th), hy.sin(th)
        for slot in range(self._slots):
            px, py, beyond = (hy.par[slots_at + 3 * slot + k] for k in range(3))
            dx, dy = px - x, py - y
            along, across = c * dx + s * dy, c * dy - s * dx
            for nx, ny, near, far in self._bands():
                reach, near_edge = nx * along + ny * across, near + beyond
                # the two edges of a band at once
                events.append(
                    near_edge - reach if far is None else (near_edge - reach) * (far + beyond + reach)
                )
        events += [affine(loads_at + 3 * k) for k in range(self._loads)]
        off, beside = affine(lines_at), affine(lines_at + 3)
        events.append(1.0 - off * off - beside * beside)
        events.append((MARGIN * self._solver.array.pitch_m) ** 2 - x * x - y * y)
        return system, events

    def _bands(self) -> list[tuple[float, float, float, float | None]]:
        """The footprint's edges: normal, offset, and the offset of the edge opposite where there is one."""
        shape = self.parcel.shape
        left = list(range(len(shape.offset)))
        bands: list[tuple[float, float, float, float | None]] = []
        while left:
            edge = left.pop(0)
            nx, ny = shape.normal[edge].tolist()
            opposite = [k for k in left if np.hypot(*(shape.normal[k] + (nx, ny))) < 1e-15]
            far = None
            if opposite:
                left.remove(opposite[0])
                far = float(shape.offset[opposite[0]])
            bands.append((nx, ny, float(shape.offset[edge]), far))
        return bands

    # --- what changes -----------------------------------------------------------------------------------------------

    def settle(self, now_s: float) -> None:
        """Begin at ``now_s`` from the parcel's place: watch the cells in reach of it."""
        y, pars, places = self.parcel.shape.y, self.integrator.pars, self._solver.array.positions_m
        self._origin_m = y[:2].copy()
        self._near = self._solver.array.near(self._origin_m, self._reach_m)
        slots: Floats = np.zeros((self._slots, 3))
        slots[: len(self._near), :2] = places[self._near] - self._origin_m
        slots[len(self._near) :, 2] = 10.0 * self._reach_m  # no cell: edges so far out that none is met
        pars[self._pars_at[1] : self._pars_at[2]] = slots.ravel()
        self.integrator.time = now_s
        self.integrator.state[:] = [0.0, 0.0, *y[2:]]
        self.integrator.reset_cooldowns()
        self.gone = False

    def load(self, motion: WheelMotion, grip: Floats) -> None:
        """Put in the present supports."""
        supports, pars = self.parcel.supports, self.integrator.pars
        assert supports is not None
        away = self._origin_m - supports.centroid_m
        plane = supports.plane.copy()
        plane[:, 0] += plane[:, 1:] @ away
        pars[: self._pars_at[1]] = self.sums(plane[supports.carrying], motion, grip).ravel()
        sign = np.where(supports.carrying, 1.0, -1.0)
        margin: Floats = np.zeros((self._loads, 3))
        margin[:, 0] = 1.0
        used = slice(0, len(sign))
        margin[used] = sign[:, None] * plane
        margin[used, 0] += 2.0 * NO_LOAD / len(sign)
        if supports.rank < 2:
            # a plane on a line of supports may tilt about it
            margin[used][~supports.carrying] = (1.0, 0.0, 0.0)
        pars[self._pars_at[2] : self._pars_at[3]] = margin.ravel()
        across = {2: np.zeros((2, 2)), 1: np.stack([supports.across, np.zeros(2)]), 0: np.eye(2)}
        off = across[supports.rank] / (1.5 * ON_LINE * self._solver.array.pitch_m)
        pars[self._pars_at[3] :] = np.column_stack([off @ away, off]).ravel()

    def sums(self, plane: Floats, motion: WheelMotion, grip: Floats) -> Floats:
        """Sums over the wheels, each times ``[1, x, y]``, of what one newton second a metre of slip does, per kilogram.

        Args:
            plane: ``(n, 3)`` load shares of the cells that carry, times ``[1, x, y]``.
            motion: of all wheels.
            grip: ``(N,)`` 1 for a driven cell, 0 for one whose wheels turn freely.

        Returns:
            ``(7, 3)``: resistance; times place x, y and squared; times free speed x, y and its turning. Three more
            with motors: the last three of the part that decays.
        """
        parcel, law = self.parcel, self._solver.traction
        supports = parcel.supports
        assert supports is not None
        cells = parcel.under[supports.carrying]
        weight = law.stiffness_per_load * self._solver.weight_n(parcel) / parcel.mass_kg * plane
        weight[:, 0] += law.stiffness / parcel.mass_kg
        weight *= grip[cells, None]
        x, y = (self._solver.array.positions_m[cells] - self._origin_m).T
        rows = [np.ones(len(cells)), x, y, x * x + y * y]
        for speed in (motion.steady, motion.decay)[: 1 + self._motors]:
            vx, vy = law.free_speed * speed[cells].T
            rows += [vx, vy, x * vy - y * vx]
        return np.stack(rows) @ weight

    def state(self, found: Floats) -> Floats:
        """The parcel's state of heyoka's."""
        state: Floats = np.array(found, dtype=np.float64)
        state[:2] += self._origin_m
        return state

    def reached(self, at_s: float, event: int | None) -> IntegrationStop:
        """Translate an event index to an integration stop.

        A zero of an edge's line counts as a crossing only within the edge's length. Of several events at one instant
        heyoka names one, and none at the end of a call.
        """
        x, y = self.integrator.state[:2].tolist()
        margin = MARGIN * self._solver.array.pitch_m - float(self.parcel.shape.par[layout.ON_SURFACE])
        # the next call has another zero of time
        self.gone = event is None or math.hypot(x, y) >= margin
        if event is None:
            return IntegrationStop(at_s, self._crossed(-1), False)
        edges = self.events - self._loads - 2
        slot = event // (edges // self._slots) if event < edges else -1
        return IntegrationStop(at_s, self._crossed(slot), edges <= event < self.events - 1)

    def _crossed(self, slot: int) -> Cells:
        """Cells on the footprint's edge that are about to be on its other side.

        The one whose event it is (``slot``, or -1) is on an edge's line to the integrator's tolerance only.
        """
        shape = self.parcel.shape
        c, s = np.cos(shape.y[2]), np.sin(shape.y[2])
        turn = np.array([[c, -s], [s, c]])
        places = (self._solver.array.positions_m[self._near] - shape.y[:2]) @ turn
        inside = shape.offset - places @ shape.normal.T
        edge = np.argmin(inside, axis=1)
        zero = shape.par[layout.ON_SURFACE]
        on_edge = np.abs(inside.min(axis=1)) <= zero
        if slot >= 0:
            edge[slot] = np.argmin(np.abs(inside[slot]))
            on_edge[slot] = np.all(np.delete(inside[slot], edge[slot]) >= -zero)
        # the place moves against the parcel
        moves = -(shape.y[3:5] @ turn) - shape.y[5] * np.stack([-places[:, 1], places[:, 0]], axis=1)
        inward = -np.sum(shape.normal[edge] * moves, axis=1)
        under = np.isin(self._near, self.parcel.under)
        return self._near[on_edge & np.where(under, inward < 0.0, inward > 0.0)]


def _most_cells(reach: float) -> int:
    """A bound on the points of a unit lattice within ``reach`` of any point: the area of their squares."""
    return int(np.pi * (reach + np.sqrt(0.5)) ** 2)
