"""Loads, slips and tractions at an instant, against sums by hand, optimality conditions and the solvers' motion."""

from __future__ import annotations

import math

import numpy as np
import pytest

from plant.analysis.tractions import Tractions
from plant.analysis.unilateral import unilateral_loads
from plant.effects.registry import PlantEffects
from plant.effects.uneven_supports import supports
from plant.friction.registry import FrictionSpec
from plant.plant import Plant
from plant.solver_specs import ImplicitSpec
from plant.specs import PlantSpec
from tests.plant.laws import COULOMB, DAMPED_CONE, FREE, LAWS, MU, STATIC, B
from tests.plant.reference import least_norm_loads
from tests.plant.scenes import G, parcel, spec

MASS = 2.0
STATE = np.array([0.031, -0.017, 0.4, 0.05, -0.02, 0.6])


def _scene(law: FrictionSpec, **effects: object) -> PlantSpec:
    x, y, angle, vx, vy, omega = STATE.tolist()
    moving = parcel(
        size_m=(0.44, 0.33),
        position_m=(x, y),
        angle_rad=angle,
        velocity_m_s=(vx, vy),
        angular_velocity_rad_s=omega,
    )
    return spec(moving, rows=8, columns=8).model_copy(
        update={
            "friction": law,
            "solver": ImplicitSpec(name="implicit", tolerance=1e-9),
            "effects": PlantEffects.model_validate(effects),
        }
    )


def _speeds(cells: int, seed: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(cells, 2)) * 0.3


def _by_hand(name: str, load: float, surface: float, underside: float, size: float) -> float:
    """Force of one wheel as the papers write it; ``size`` is the magnitude of the cell's slip for a cone."""
    slip = surface - underside
    return {
        "viscous": 0.2 * load * slip,
        "coulomb": MU * load * math.copysign(1.0, slip),
        "cone": MU * load * slip / size,
        "damped": MU * load * math.copysign(1.0, slip) + 0.7 * slip,
        "damped_cone": MU * load * slip / size + 0.7 * slip,
        "sliding": MU * load * math.copysign(1.0, surface),
        "rolling": B * (FREE * surface - underside),
        "stick_slip": min(max(B * (FREE * surface - underside), -MU * load), MU * load),
    }[name]


@pytest.mark.parametrize("name", LAWS)
def test_every_wheel_pulls_as_the_papers_write_it(name: str) -> None:
    tractions = Tractions(_scene(LAWS[name]))
    speeds = _speeds(len(tractions.array))
    (one,) = tractions.at(STATE[None], speeds).parcels
    places = tractions.array.positions_m[one.cells]
    expected = least_norm_loads(places, STATE[:2])
    assert expected is not None
    assert len(one.cells) > 10
    assert one.load_n == pytest.approx(MASS * G * expected, rel=1e-9)
    for place, cell, load, pull in zip(places, one.cells, one.load_n, one.traction_n, strict=True):
        lever = place - STATE[:2]
        underside = (STATE[3] - STATE[5] * lever[1], STATE[4] + STATE[5] * lever[0])
        size = math.hypot(*(speeds[cell] - underside))
        for axis in range(2):
            hand = _by_hand(name, load, speeds[cell, axis], underside[axis], size)
            assert pull[axis] == pytest.approx(hand, rel=1e-12, abs=1e-15)


EFFECTS: dict[str, dict[str, object]] = {
    "none": {},
    "uneven_friction": {"uneven_friction": {"cell_spread": 0.3}},
    "roller_drag": {"roller_drag": {"drag_s_per_m": 0.05}},
    "contact_width": {"contact_width": {"width_m": 0.03}},
    "uneven_supports": {
        "uneven_supports": {"stiffness_n_per_m": 3e3, "stiffness_spread": 0.2, "height_spread_m": 2e-4}
    },
}


@pytest.mark.parametrize(
    ("name", "effect"),
    # a law that doesn't depend on the load has no uneven friction; kernels with effects are compiled for the slow tier
    [
        pytest.param(law, effect, marks=[] if effect == "none" else pytest.mark.slow)
        for law in LAWS
        for effect in EFFECTS
        if (law, effect) != ("rolling", "uneven_friction")
    ],
)
def test_tractions_sum_to_what_the_solver_accelerates_the_parcel_by(name: str, effect: str) -> None:
    scene = _scene(LAWS[name], **EFFECTS[effect])
    tractions, plant, span_s = Tractions(scene), Plant(scene), 1e-6
    speeds = _speeds(len(tractions.array))
    one = tractions.at(STATE[None], speeds)
    plant.advance(speeds, round(span_s * 1e9))
    acceleration = (plant.state[0, 3:] - STATE[3:]) / span_s
    force = one.traction_n.sum(axis=0)
    lever = tractions.array.positions_m - STATE[:2]
    torque = float(np.sum(lever[:, 0] * one.traction_n[:, 1] - lever[:, 1] * one.traction_n[:, 0]))
    inertia = scene.parcels[0].moment_of_inertia_kg_m2()
    assert acceleration == pytest.approx([*(force / MASS), torque / inertia], rel=1e-4, abs=1e-4)


def test_loads_on_uneven_springs_are_optimal_and_balance() -> None:
    draw = np.random.default_rng(5)
    lifted = 0
    for seed in range(200):
        scene = _scene(
            COULOMB,
            uneven_supports={"stiffness_n_per_m": 3e3, "stiffness_spread": 0.4, "height_spread_m": 5e-4},
        ).model_copy(update={"seed": seed})
        tractions = Tractions(scene)
        state = STATE + np.append(draw.uniform(-0.05, 0.05, 3), [0.0, 0.0, 0.0])
        load = tractions.at(state[None], _speeds(len(tractions.array))).load_n
        drawn = supports(scene.effects.uneven_supports, tractions.array.lattice, seed)  # type: ignore[arg-type]
        lever = tractions.array.positions_m - state[:2]
        assert load.sum() == pytest.approx(MASS * G, rel=1e-9)
        assert load @ lever == pytest.approx([0.0, 0.0], abs=1e-7)
        # where a cell carries, the plane of the springs is pressed to its height; elsewhere it is above the spring
        carrying = load > 0.0
        sag = load / (drawn.stiffness_n_per_m * drawn.rate) - drawn.height_m
        q = np.column_stack([np.ones(len(load)), lever])
        plane, *_ = np.linalg.lstsq(q[carrying], sag[carrying], rcond=None)
        assert q[carrying] @ plane == pytest.approx(sag[carrying], abs=1e-9)
        c, s = np.cos(state[2]), np.sin(state[2])
        body = lever @ np.array([[c, -s], [s, c]])
        under = (np.abs(body[:, 0]) < 0.22) & (np.abs(body[:, 1]) < 0.165)
        assert not carrying[~under].any()
        lifted += int(np.count_nonzero(under & ~carrying))
        assert np.all(q[under & ~carrying] @ plane <= -drawn.height_m[under & ~carrying] + 1e-9)
    assert lifted > 100


def test_no_loads_balance_a_weight_beside_its_springs() -> None:
    square = np.array([[1.0, 1.0], [2.0, 1.0], [1.0, 2.0], [2.0, 2.0]])
    assert unilateral_loads(square, np.ones(4), np.zeros(4)) is None
    assert unilateral_loads(np.zeros((0, 2)), np.zeros(0), np.zeros(0)) is None


@pytest.mark.parametrize(("law", "ratio"), [(COULOMB, 1.0), (DAMPED_CONE, 1.0), (STATIC, 1.5)])
def test_a_wheel_that_sticks_has_no_known_traction_and_its_limit(law: FrictionSpec, ratio: float) -> None:
    tractions = Tractions(_scene(law))
    state = STATE * [1.0, 1.0, 1.0, 1.0, 1.0, 0.0]
    speeds = np.tile(state[3:5], (len(tractions.array), 1))
    speeds[::2, 0] += 0.1
    found = tractions.at(state[None], speeds)
    (one,) = found.parcels
    slips = one.slip_m_s[:, 0] > 0.05
    assert slips.any()
    assert not slips.all()
    assert not one.sticking[slips, 0].any()
    assert one.sticking[~slips].all()
    assert np.isnan(one.traction_n[one.sticking]).all()
    assert np.isfinite(one.traction_n[~one.sticking]).all()
    assert one.limit_n[~slips] == pytest.approx(
        np.repeat(ratio * MU * one.load_n[~slips, None], 2, axis=1), rel=1e-12
    )


def test_coasting_cells_carry_and_don_t_pull_and_absent_ones_don_t_carry() -> None:
    tractions = Tractions(_scene(LAWS["viscous"]))
    speeds = _speeds(len(tractions.array))
    (one,) = tractions.at(STATE[None], speeds).parcels
    marked = np.zeros(len(tractions.array), dtype=np.bool_)
    marked[one.cells[3]] = True
    coasts = tractions.at(STATE[None], speeds, coasting=marked)
    assert coasts.load_n[marked] == one.load_n[3]
    assert np.all(coasts.traction_n[marked] == 0.0)
    away = tractions.at(STATE[None], speeds, absent=marked)
    assert away.load_n[marked] == 0.0
    assert away.load_n.sum() == pytest.approx(MASS * G)
    assert np.isnan(away.slip_m_s[marked]).all()
    again = tractions.at(STATE[None], speeds)
    assert np.array_equal(again.load_n[one.cells], one.load_n)


def test_parcels_that_are_not_there_load_nothing_and_wrong_shapes_are_refused() -> None:
    tractions = Tractions(_scene(COULOMB))
    speeds = _speeds(len(tractions.array))
    assert tractions.at(np.full((1, 6), np.nan), speeds).parcels == ()
    assert tractions.at(STATE[None], speeds, parcels=()).load_n.sum() == 0.0
    beside = STATE + np.array([3.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert tractions.at(beside[None], speeds).parcels == ()
    with pytest.raises(ValueError, match=r"must be \(1, 6\) and \(64, 2\)"):
        tractions.at(np.zeros((2, 6)), speeds)


def test_effects_that_are_not_included_are_named() -> None:
    effects = {"load_transfer": {"centre_of_mass_height_m": 0.05}, "contact_width": {"width_m": 0.02}}
    assert Tractions(_scene(COULOMB, **effects)).left_out == ("load_transfer",)
