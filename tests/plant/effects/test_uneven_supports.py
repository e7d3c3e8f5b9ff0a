"""Supports of unequal rates and heights: loads by their optimality conditions, motion by an independent integration."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.integrate import solve_ivp
from scipy.optimize import nnls

from bus.lattice import Lattice
from plant.effects.uneven_supports import SupportSpec, UnevenSupportsSpec, supports
from plant.errors import PlantError
from plant.friction.registry import FrictionSpec
from plant.friction.viscous import Viscous
from plant.kernels.common import layout
from plant.parcel_spec import ParcelSpec
from plant.plant import Plant
from plant.specs import PlantSpec
from tests.plant.laws import VISCOUS
from tests.plant.reference import balances
from tests.plant.scenes import SECOND, Floats, G, elliptic, lawful, parcel

pytestmark = pytest.mark.slow  # kernels of this effect are compiled

WEIGHT = 2.0 * G


def uneven(
    *parcels: ParcelSpec,
    tolerance: float = 1e-8,
    seed: int = 0,
    array: dict[str, object] | None = None,
    solver: dict[str, object] | None = None,
    law: FrictionSpec = VISCOUS,
    **effect: object,
) -> Plant:
    """A plant on supports of their own, under the viscous law unless said otherwise."""
    settings = UnevenSupportsSpec.model_validate({"stiffness_n_per_m": 1e4} | effect)
    plain = lawful_spec(*parcels, tolerance=tolerance, **(array or {})) | {"friction": law}
    plain |= {"effects": {"uneven_supports": settings}, "seed": seed}
    return Plant(PlantSpec.model_validate(plain | ({"solver": solver} if solver else {})))


def lawful_spec(*parcels: ParcelSpec, tolerance: float, **array: object) -> dict[str, object]:
    settings: dict[str, object] = {"rows": 20, "columns": 20, "pitch_m": 0.1} | array
    return {
        "array": settings,
        "parcels": parcels or (parcel(),),
        "friction": VISCOUS,
        "solver": {"name": "implicit", "tolerance": tolerance},
    }


def drawn(plant: Plant, seed: int, **effect: object) -> tuple[Floats, Floats]:
    """Rates in N/m and heights in m of all cells."""
    spec = UnevenSupportsSpec.model_validate({"stiffness_n_per_m": 1e4} | effect)
    found = supports(spec, plant.array.lattice, seed)
    return spec.stiffness_n_per_m * found.rate, found.height_m


def carried(plant: Plant) -> tuple[np.ndarray, Floats]:
    """Cells under the parcel, ascending, and their loads in N as the solver has them."""
    inner, work = plant._solver.parcels[0], plant._solver.workspace(0).work
    seg = getattr(work, "pulls", work).seg
    springs = plant._solver._springs
    listed = inner.mem[: inner.ctl[layout.N_MEMBERS]]
    listed = listed[np.argsort(listed[:, layout.CELL])]
    cells = listed[:, layout.CELL]
    r = plant.array.positions_m[cells] - inner.y[:2] - seg[[layout.CX, layout.CY]]
    inverse = np.array([[seg[layout.PXX], seg[layout.PXY]], [seg[layout.PXY], seg[layout.PYY]]])
    tilt = inverse @ (springs.moments[0, 1:] - seg[[layout.CX, layout.CY]])
    level = (1.0 + springs.moments[0, 0]) / seg[layout.N_ACTIVE]
    share = springs.rate[cells] * (level + r @ tilt - springs.per_m[0] * springs.gap_m[cells])
    return cells, WEIGHT * np.where(listed[:, layout.MARK] == layout.ACTIVE, share, 0.0)


def spring_loads(place: Floats, rate: Floats, height: Floats, centre: Floats) -> Floats | None:
    """Loads that minimise the springs' energy ``sum N^2 / (2 K) - N h`` under the balances and ``N >= 0``, in N.

    Least distance programming (Lawson and Hanson, chapter 23) for the supports, then an exact solve on them.
    """
    scale = np.sqrt(rate / rate.mean())
    rows = balances(place, centre)
    a, b = rows * scale, np.array([1.0, 0.0, 0.0])
    lift = -scale * height * rate.mean() / WEIGHT
    g = np.vstack([a, -a, np.eye(len(place))])
    h = np.concatenate([b, -b, np.zeros(len(place))]) + g @ lift
    e = np.vstack([g.T, h])
    f = np.zeros(len(e))
    f[-1] = 1.0
    u, misfit = nnls(e, f, maxiter=100 * len(place) + 1000)
    if misfit < 1e-10:
        return None
    r = e @ u - f
    on = -r[:-1] / r[-1] - lift > 1e-9
    k, gap = (rate / rate.mean())[on], -(height * rate.mean() / WEIGHT)[on]
    plane = np.linalg.solve((rows[:, on] * k) @ rows[:, on].T, b + rows[:, on] @ (k * gap))
    loads = np.zeros(len(place))
    loads[on] = WEIGHT * k * (rows[:, on].T @ plane - gap)
    return loads


def optimal(place: Floats, rate: Floats, height: Floats, centre: Floats, loads: Floats) -> str:
    """Check the optimality conditions; the empty string, or what fails. They single out one solution."""
    rows = balances(place, centre)
    if loads.min() < -1e-9 * WEIGHT:
        return f"a cell pulls: {loads.min()}"
    off = np.abs(rows @ loads / WEIGHT - [1.0, 0.0, 0.0]).max()
    if off > 1e-10:
        return f"out of balance by {off}"
    on = loads > 1e-10 * WEIGHT
    sag = loads / rate - height
    plane, *_ = np.linalg.lstsq(rows[:, on].T, sag[on], rcond=None)
    span = np.abs(sag).max()
    off = np.abs(rows[:, on].T @ plane - sag[on]).max()
    if off > 1e-9 * span:
        return f"not on a plane by {off}"
    if not on.all() and (rows[:, ~on].T @ plane + height[~on]).max() > 1e-9 * span:
        return "a lifted cell would be pressed"
    return ""


# --- loads --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["implicit", "fixed_step", "quasi_static"])
@pytest.mark.parametrize("height_spread_m", [0.0, 1e-5, 1e-3, 0.1])
def test_loads_are_the_springs_own_and_never_pull(height_spread_m: float, solver: str) -> None:
    draw = np.random.default_rng(3)
    effect = {"stiffness_spread": 0.5, "height_spread_m": height_spread_m}
    lifted = 0
    for seed in range(25):
        body = parcel(
            size_m=tuple(draw.uniform(0.25, 0.8, 2)),
            position_m=tuple(draw.uniform(-0.3, 0.3, 2)),
            angle_rad=float(draw.uniform(-4.0, 4.0)),
        )
        plant = uneven(body, seed=seed, solver={"name": solver}, **effect)
        # and at the end of a call, not only at the start
        plant.advance(elliptic(plant), 20_000_000)
        rate, height = drawn(plant, seed, **effect)
        cells, loads = carried(plant)
        place, centre = plant.array.positions_m[cells], plant.state[0, :2]
        assert optimal(place, rate[cells], height[cells], centre, loads) == ""
        if height_spread_m < 0.1:  # where the conditions alone tell; NNLS loses its digits there
            known = spring_loads(place, rate[cells], height[cells], centre)
            assert known is not None
            assert loads == pytest.approx(known, abs=1e-7 * WEIGHT)
        lifted += int(np.sum(loads == 0.0))
    assert (lifted > 0) == (height_spread_m > 1e-4)


def test_three_springs_in_a_row_share_by_hand() -> None:
    # the middle one is higher by h: N = W/3 + (2/3) K h there, until the outer two are free
    body = parcel(size_m=(0.25, 0.05), position_m=(0.0, 0.0), angle_rad=0.0)
    for h in (0.0, 2e-4, -3e-4, 5e-3):
        known = np.clip(WEIGHT / 3.0 + 2.0 / 3.0 * 1e4 * h, 0.0, WEIGHT)
        plant = uneven(body, array={"rows": 1, "columns": 3}, cells=[{"cell": (0, 1), "height_m": h}])
        _, loads = carried(plant)
        assert loads == pytest.approx([(WEIGHT - known) / 2.0, known, (WEIGHT - known) / 2.0], abs=1e-9)


def test_a_stiff_spring_carries_in_proportion_to_its_rate() -> None:
    # centred on all four, so that the plane stays level along y: 3 K + K on either row
    body = parcel(size_m=(0.15, 0.15), position_m=(0.0, 0.0), angle_rad=0.0)
    stiff = [{"cell": (0, 0), "stiffness_n_per_m": 3e4}, {"cell": (1, 1), "stiffness_n_per_m": 3e4}]
    _, loads = carried(uneven(body, array={"rows": 2, "columns": 2}, cells=stiff))
    assert loads == pytest.approx(WEIGHT * np.array([3.0, 1.0, 1.0, 3.0]) / 8.0, abs=1e-9)


def test_whether_a_parcel_stands_depends_on_where_cells_are_and_not_on_their_height() -> None:
    array = {"rows": 2, "columns": 4}
    low = [{"cell": (r, 0), "height_m": -0.5} for r in range(2)]
    # its centre of mass is between the last two columns: it can lean on the low cells if it must
    inside = parcel(size_m=(0.45, 0.25), position_m=(-0.08, 0.0), angle_rad=0.0)
    assert carried(uneven(inside, array=array, cells=low))[1].sum() == pytest.approx(WEIGHT)
    beside = parcel(
        size_m=(0.45, 0.25), position_m=(-0.16, 0.0), angle_rad=0.0, centre_of_mass_m=(-0.06, 0.0)
    )
    with pytest.raises(PlantError, match="would tip"):
        uneven(beside, array=array, cells=low)


# --- motion -------------------------------------------------------------------------------------------------------


def test_equal_springs_of_the_effect_are_those_without_it() -> None:
    plain, effect = lawful(VISCOUS, tolerance=1e-8), uneven(tolerance=1e-8)
    for plant in (plain, effect):
        plant.advance(elliptic(plant), SECOND)
    assert effect.state == pytest.approx(plain.state, abs=1e-12)
    assert effect.support_changes == plain.support_changes


def test_the_motion_is_that_of_an_independent_integration_and_turns_the_parcel_otherwise() -> None:
    effect = {"stiffness_spread": 0.4, "height_spread_m": 4e-4}
    body = parcel(
        position_m=(0.05, 0.03), angle_rad=0.4, velocity_m_s=(0.3, -0.2), angular_velocity_rad_s=0.5
    )
    plant = uneven(body, seed=5, tolerance=1e-9, **effect)
    rate, height = drawn(plant, 5, **effect)
    wheels, cells = elliptic(plant), plant.array.positions_m
    half, inertia = np.array([0.27, 0.16]), (0.54**2 + 0.32**2) / 12.0
    counts = set()

    def slope(_: float, y: Floats) -> Floats:
        c, s = np.cos(y[2]), np.sin(y[2])
        under = np.flatnonzero(np.all(np.abs((cells - y[:2]) @ np.array([[c, -s], [s, c]])) <= half, axis=1))
        loads = spring_loads(cells[under], rate[under], height[under], y[:2])
        assert loads is not None
        counts.add(int(np.sum(loads > 0.0)))
        arm = cells[under] - y[:2]
        below = y[3:5] + y[5] * np.stack([-arm[:, 1], arm[:, 0]], axis=1)
        force = 0.2 * loads[:, None] * (wheels[under] - below)
        turn = float(np.sum(arm[:, 0] * force[:, 1] - arm[:, 1] * force[:, 0]))
        return np.array([*y[3:], *(force.sum(axis=0) / 2.0), turn / (2.0 * inertia)])

    known = solve_ivp(
        slope, (0.0, 0.4), plant.state[0], method="RK23", max_step=2e-3, rtol=1e-8, atol=1e-11
    ).y[:, -1]
    plant.advance(wheels, 2 * SECOND // 5)
    assert len(counts) > 2
    assert plant.state[0] == pytest.approx(known, abs=2e-6)
    plain = lawful(VISCOUS, body, tolerance=1e-9)
    plain.advance(wheels, 2 * SECOND // 5)
    # moments balance on any springs, so that a linear field carries the centre of mass all the same
    assert plant.state[0, [0, 1, 3, 4]] == pytest.approx(plain.state[0, [0, 1, 3, 4]], abs=1e-8)
    assert abs(plant.state[0, 2] - plain.state[0, 2]) > 1e-4


UNEVEN = {"stiffness_spread": 0.4, "height_spread_m": 4e-4}
MOVES = parcel(position_m=(0.05, 0.03), angle_rad=0.4, velocity_m_s=(0.3, -0.2), angular_velocity_rad_s=0.5)


def test_fixed_steps_come_to_the_motion_of_implicit_at_first_order() -> None:
    fine = uneven(MOVES, seed=5, tolerance=1e-9, **UNEVEN)
    fine.advance(elliptic(fine), 2 * SECOND // 5)
    off, steps_s = [], (1e-3, 1e-4, 1e-5)
    for step_s in steps_s:
        solver = {"name": "fixed_step", "method": "euler", "step_s": step_s}
        plant = uneven(MOVES, seed=5, solver=solver, **UNEVEN)
        plant.advance(elliptic(plant), 2 * SECOND // 5)
        off.append(np.abs(plant.state - fine.state).max())
    assert fine.support_changes > 4
    assert np.polyfit(np.log(steps_s), np.log(off), 1)[0] == pytest.approx(1.0, abs=0.1)
    assert off[-1] < 1e-5


def test_without_inertia_a_parcel_has_the_velocity_at_which_its_own_springs_balance_what_wheels_pull() -> (
    None
):
    plant = uneven(MOVES, seed=5, solver={"name": "quasi_static"}, **UNEVEN)
    rate, height = drawn(plant, 5, **UNEVEN)
    wheels, counts = elliptic(plant), set()
    for tick in range(1, 26):
        plant.advance(wheels, tick * 20_000_000)
        cells, _ = carried(plant)
        place, centre = plant.array.positions_m[cells], plant.state[0, :2]
        loads = spring_loads(place, rate[cells], height[cells], centre)
        assert loads is not None
        counts.add(int(np.sum(loads > 0.0)))
        arm = place - centre
        across = np.stack([-arm[:, 1], arm[:, 0]], axis=1)
        # moments balance about the centre of mass, so that no turning pulls it along: sums of N r vanish
        velocity = loads @ wheels[cells] / WEIGHT
        turn = loads @ np.sum(across * wheels[cells], axis=1) / (loads @ np.sum(arm * arm, axis=1))
        assert plant.state[0, 3:] == pytest.approx([*velocity, turn], abs=1e-9)
    assert len(counts) > 1


def test_quasi_static_motion_is_that_of_implicit_where_inertia_hardly_counts() -> None:
    ends = []
    for mu in (50.0, 500.0):
        law = Viscous(coefficient_s_per_m=mu)
        pair = [
            uneven(MOVES, seed=5, law=law, solver=solver, **UNEVEN)
            for solver in (
                {"name": "quasi_static", "tolerance": 1e-8},
                {"name": "implicit", "tolerance": 1e-8},
            )
        ]
        for plant in pair:
            plant.advance(elliptic(plant), SECOND // 2)
        ends.append(np.abs(pair[0].state[0, :3] - pair[1].state[0, :3]).max())
    # what is left falls with the time 1 / (mu g) in which wheels take the parcel along
    assert ends[1] < 0.2 * ends[0]
    assert ends[1] < 1e-3


# --- what is drawn ------------------------------------------------------------------------------------------------


def test_what_is_drawn_depends_on_the_seed_and_on_nothing_else() -> None:
    lattice = Lattice((r, c) for r in range(40) for c in range(50))
    spec = UnevenSupportsSpec(stiffness_n_per_m=1e4, stiffness_spread=0.3, height_spread_m=2e-4)
    one, again, other = (supports(spec, lattice, seed) for seed in (1, 1, 2))
    assert one.rate.tobytes() == again.rate.tobytes()
    assert one.height_m.tobytes() == again.height_m.tobytes()
    assert not np.any(one.rate == other.rate)
    known = SupportSpec(cell=(3, 1), height_m=0.1)
    own = supports(spec.model_copy(update={"cells": (known,)}), lattice, 1)
    assert np.flatnonzero(own.height_m != one.height_m).tolist() == [151]
    assert np.array_equal(own.rate, one.rate)
    assert one.rate.mean() == pytest.approx(1.0, abs=4 * 0.3 / np.sqrt(2000))
    assert np.log(one.rate).std() == pytest.approx(0.3, rel=0.08)
    assert one.height_m.std() == pytest.approx(2e-4, rel=0.08)


def test_the_effect_is_refused_where_it_does_not_fit() -> None:
    plain = lawful_spec(tolerance=1e-6)
    effect: dict[str, object] = {"stiffness_n_per_m": 1e4}
    with pytest.raises(
        ValidationError,
        match=r"solver\.name exact leaves out effects\.uneven_supports; use implicit or fixed_step or quasi_static",
    ):
        PlantSpec.model_validate(
            plain | {"solver": {"name": "exact"}, "effects": {"uneven_supports": effect}}
        )
    strange = effect | {"cells": [{"cell": (3, 20)}]}
    with pytest.raises(
        ValidationError, match=r"effects\.uneven_supports\.cells\.0\.cell \[3, 20\]: the array has no"
    ):
        PlantSpec.model_validate(plain | {"effects": {"uneven_supports": strange}})
    with pytest.raises(ValidationError, match=r"cells names \[3, 2\] twice"):
        UnevenSupportsSpec.model_validate(effect | {"cells": [{"cell": (3, 2)}, {"cell": (3, 2)}]})
