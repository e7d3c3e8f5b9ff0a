"""Loads shifted by traction: a braking parcel's loads, closed forms of the motion, and parcels that traction tips."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError
from scipy.integrate import solve_ivp

from plant.friction.registry import FrictionSpec
from plant.kernels.common import layout
from plant.parcel_spec import ParcelSpec
from plant.plant import Plant
from tests.plant.laws import COULOMB, MU, ROLLING, STATIC, VISCOUS
from tests.plant.scenes import SECOND, Floats, G, elliptic, parcel, solved

HEIGHT = 0.08
IMPLICIT: dict[str, object] = {"name": "implicit", "tolerance": 1e-9}
RK4: dict[str, object] = {"name": "fixed_step", "step_s": 1e-3}
SOLVERS = pytest.mark.parametrize("solver", [IMPLICIT, RK4], ids=["implicit", "fixed_step"])
WIDE = parcel(size_m=(2.0, 2.0), position_m=(0.0, 0.0), angle_rad=0.0)


def tall(
    body: ParcelSpec = WIDE,
    *,
    law: FrictionSpec = VISCOUS,
    solver: dict[str, object] | None = None,
    height_m: float = HEIGHT,
    **array: object,
) -> Plant:
    """A plant of nine by nine cells whose parcels' centres of mass are raised."""
    effects = {"load_transfer": {"centre_of_mass_height_m": height_m}}
    size = {"rows": 9, "columns": 9} | array
    return solved(solver or IMPLICIT, body, law=law, effects=effects, **size)


def uniform(plant: Plant, vx: float, vy: float = 0.0) -> Floats:
    """The same speed of all wheels."""
    return np.tile([vx, vy], (len(plant.array), 1))


def carried(plant: Plant) -> tuple[NDArray[np.int64], Floats]:
    """Cells under the parcel, and the share of its weight on each, as the solver has them."""
    solver = plant._solver
    inner, work = solver.parcels[0], solver.workspace(0).work  # type: ignore[attr-defined]
    seg = getattr(work, "pulls", work).seg
    listed = inner.mem[: inner.ctl[layout.N_MEMBERS]]
    cells = listed[:, layout.CELL].astype(np.int64)
    offset = plant.array.positions_m[cells] - inner.y[:2] - seg[[layout.CX, layout.CY]]
    inverse = np.array([[seg[layout.PXX], seg[layout.PXY]], [seg[layout.PXY], seg[layout.PYY]]])
    centre = solver._transfer.shift[0, 0] - seg[[layout.CX, layout.CY]]  # type: ignore[attr-defined]
    share = 1.0 / seg[layout.N_ACTIVE] + offset @ inverse @ centre
    return cells, np.where(listed[:, layout.MARK] == layout.ACTIVE, share, 0.0)


@pytest.mark.slow
@SOLVERS
@pytest.mark.parametrize("law", [COULOMB, VISCOUS, ROLLING], ids=["coulomb", "viscous", "rolling"])
def test_a_braking_parcel_leans_on_its_front_cells_by_m_a_h_over_the_lever(
    solver: dict[str, object], law: FrictionSpec
) -> None:
    """Two columns of cells a lever L apart: the front one gains ``m a H / L``, the rear one loses as much."""
    body = parcel(size_m=(0.3, 0.3), position_m=(0.0, 0.0), angle_rad=0.0, velocity_m_s=(0.02, 0.0))
    plant = tall(body, law=law, solver=solver, rows=2, columns=2)
    plant.advance(uniform(plant, 0.0), 1_000_000)
    before = plant.state[0, 3]
    # a microsecond's step: the loads are those of its mean deceleration
    plant.advance(uniform(plant, 0.0), 1_001_000)
    deceleration = (before - plant.state[0, 3]) / 1e-6
    assert deceleration > 0.01
    if law is COULOMB:
        assert deceleration == pytest.approx(MU * G, rel=1e-6)
    cells, share = carried(plant)
    front = share[plant.array.positions_m[cells, 0] > 0.0].sum()
    lean = plant.state[0, 0] / 0.1 + deceleration / G * HEIGHT / 0.1
    assert front == pytest.approx(0.5 + lean, abs=1e-6)
    assert share.sum() == pytest.approx(1.0, abs=1e-12)


@pytest.mark.slow
@SOLVERS
def test_in_a_linear_field_the_centre_of_mass_is_an_oscillator_of_other_inertia(
    solver: dict[str, object],
) -> None:
    """``sum N_i V_i = W k (X + s)``, ``s = -H x''/g``: ``(1 + mu k H) x'' = mu g (k x - x')`` on any supports.

    Of a parcel that does not turn: where loads don't balance about the centre of mass, turning pulls along.
    """
    plant = tall(parcel(inertia_kg_m2=1e9), solver=solver, rows=20, columns=20)
    plant.advance(elliptic(plant), SECOND // 2)
    assert plant.support_changes > 5
    bound = 1e-7 if solver is IMPLICIT else 1e-5
    for axis, k in ((0, -1.0), (1, -2.0)):
        rate = 0.2 * G / (1.0 + 0.2 * k * HEIGHT)
        values, vectors = np.linalg.eig(np.array([[0.0, 1.0], [rate * k, -rate]]).astype(complex))
        start = np.linalg.solve(vectors, np.array([(0.55, 0.5)[axis], 0.0], dtype=complex))
        place, speed = (vectors @ (np.exp(values * 0.5) * start)).real
        assert plant.state[0, axis] == pytest.approx(place, abs=bound)
        assert plant.state[0, 3 + axis] == pytest.approx(speed, abs=10.0 * bound)


@pytest.mark.slow
@SOLVERS
def test_the_motion_is_that_of_scipy_with_the_balance_as_linear_equations(solver: dict[str, object]) -> None:
    """On one set of supports under the viscous law the shift solves two linear equations, at every instant."""
    body = WIDE.model_copy(update={"position_m": (0.05, -0.03), "angular_velocity_rad_s": 0.5})
    plant = tall(body, solver=solver)
    cells, inertia = plant.array.positions_m, body.moment_of_inertia_kg_m2()
    wheels = cells @ np.array([[-1.0, 2.0], [-2.0, -1.5]]) + np.array([0.3, -0.2])
    squares, n = np.sum(cells * cells, axis=0), len(cells)

    def rates(_: float, y: Floats) -> list[float]:
        arm = cells - y[:2]
        slip = wheels - (y[3:5] + y[5] * np.stack([-arm[:, 1], arm[:, 0]], axis=1))
        # a = a0 + A s, s = -(H / g) a
        level = 0.2 * G * (1.0 / n + cells @ (y[:2] / squares)) @ slip
        tilt = 0.2 * G * slip.T @ (cells / squares)
        a = np.linalg.solve(np.eye(2) + HEIGHT / G * tilt, level)
        load = 1.0 / n + cells @ ((y[:2] - HEIGHT / G * a) / squares)
        assert load.min() > 0.0
        force = 0.2 * body.mass_kg * G * load[:, None] * slip
        torque = float(np.sum(arm[:, 0] * force[:, 1] - arm[:, 1] * force[:, 0]))
        return [*y[3:], *a, torque / inertia]

    known = solve_ivp(rates, (0.0, 0.1), plant.state[0], method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    plant.advance(wheels, SECOND // 10)
    assert plant.state[0] == pytest.approx(known, abs=1e-9)
    flat = tall(body, solver=solver, height_m=0.0)
    flat.advance(wheels, SECOND // 10)
    assert np.abs(flat.state[0] - known).max() > 1e-4


@pytest.mark.slow
@SOLVERS
def test_a_parcel_that_brakes_tips_where_its_load_s_centre_leaves_the_supports(
    solver: dict[str, object],
) -> None:
    """A flat one would tip at the hole's edge: this one ``mu H`` before it."""
    hole = tuple((r, c) for r in range(9) for c in range(6, 9))
    body = parcel(size_m=(0.5, 0.5), position_m=(-0.1, 0.0), angle_rad=0.0, velocity_m_s=(1.2, 0.0))
    plant = tall(body, law=COULOMB, solver=solver, height_m=0.2, missing=hole)
    _, events = plant.advance(uniform(plant, 0.0), SECOND)
    tip = events[-1]
    assert tip.kind in ("tipped", "off_array")
    place, pull = 0.1 - MU * 0.2, MU * G
    assert tip.position_m == pytest.approx((place, 0.0), abs=1e-6 if solver is IMPLICIT else 2e-3)
    time_s = (1.2 - np.sqrt(1.44 - 2.0 * pull * (place + 0.1))) / pull
    assert tip.time_s == pytest.approx(time_s, abs=1e-6 if solver is IMPLICIT else 2e-3)
    assert {column for _, column in tip.cells} == {5}


@pytest.mark.slow
def test_traction_too_strong_for_a_narrow_parcel_tips_it_at_once_and_a_wider_one_stands() -> None:
    """Sliding shifts the load's centre by ``mu H``, 0.09 m: two columns bear 0.05 m, three 0.1 m."""
    for size, place, stands in ((0.15, 0.05, False), (0.25, 0.0, True)):
        body = parcel(size_m=(size, 0.5), position_m=(place, 0.0), angle_rad=0.0)
        plant = tall(body, law=COULOMB, height_m=0.3)
        plant.advance(uniform(plant, 5.0), SECOND // 1000)
        assert (plant.status[0].state == "moving") == stands


@pytest.mark.slow
def test_a_parcel_carried_at_its_wheels_speed_has_its_loads_back() -> None:
    plant = tall(law=COULOMB)
    plant.advance(uniform(plant, 0.1), SECOND // 50)
    shift = plant._solver._transfer.shift[0, 0]  # type: ignore[attr-defined]
    assert shift == pytest.approx([-MU * HEIGHT, 0.0], abs=1e-9)
    plant.advance(uniform(plant, 0.1), SECOND)
    assert plant.state[0, 3:].tolist() == [0.1, 0.0, 0.0]
    assert np.abs(shift).max() < 1e-12


@pytest.mark.slow
def test_a_height_of_its_own_counts_before_that_of_the_effect_and_zero_changes_nothing() -> None:
    own = WIDE.model_copy(update={"centre_of_mass_height_m": 0.0})
    ends = []
    for plant in (tall(own), tall(height_m=0.0), solved(IMPLICIT, WIDE, rows=9, columns=9)):
        plant.advance(uniform(plant, 0.2) + 0.3 * plant.array.positions_m, SECOND // 5)
        ends.append(plant.state[0])
    assert np.array_equal(ends[0], ends[1])
    assert ends[0] == pytest.approx(ends[2], abs=1e-12)


@pytest.mark.parametrize(
    ("law", "more", "rule"),
    [
        (
            VISCOUS,
            {"parcel_contact": {}},
            r"effects\.load_transfer .*doesn't go with effects\.parcel_contact",
        ),
        (
            VISCOUS,
            {"roller_impacts": {"spacing_m": 4e-3, "impulse_s": 8e-5}},
            r"effects\.load_transfer .*doesn't go with effects\.roller_impacts",
        ),
        (STATIC, {}, r"friction\.static_coefficient .*doesn't go with effects\.load_transfer"),
    ],
)
def test_what_does_not_go_together_is_refused(law: FrictionSpec, more: dict[str, object], rule: str) -> None:
    effects = {"load_transfer": {"centre_of_mass_height_m": 0.1}} | more
    with pytest.raises(ValidationError, match=rule):
        solved(IMPLICIT, law=law, effects=effects)


@pytest.mark.parametrize("name", ["exact", "quasi_static", "scipy", "heyoka"])
def test_solvers_that_leave_it_out_are_refused_by_name(name: str) -> None:
    with pytest.raises(ValidationError, match=rf"solver\.name {name} leaves out effects\.load_transfer"):
        tall(solver={"name": name})
