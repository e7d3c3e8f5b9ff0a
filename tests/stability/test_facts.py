"""Facts that are known without this project: the scalar problem, and what the paper says of its laws."""

from __future__ import annotations

from math import exp, expm1

import numpy as np
import pytest

import plant.solvers.exact as exact
from plant.errors import PlantError
from plant.plant import Plant
from tests.plant.laws import LAWS, B
from tests.plant.laws import MU as COULOMB_MU
from tests.plant.scenes import MU, SECOND, G, loads, parcel
from tests.stability.solvers import SOLVERS, Claim, Solver, claiming

RETURNS = {5: 6, 10: 39, 20: 1_159, 30: 32_548}
"""How often ``x'' = -sgn x - x'`` from x = 0, x' = 1 is back at zero by then: 912,424 times by 40."""


def _returns(end: float) -> np.ndarray:
    """When it is back, by the closed form between two returns and Newton's method for the next."""
    now, speed, times = 0.0, 1.0, [0.0]
    while now <= end:
        # x = -(u + 1) expm1(-t) - t from the speed u, whichever way
        span = 2.0 * speed / (1.0 + speed / 3.0)
        for _ in range(8):
            span -= (-(speed + 1.0) * expm1(-span) - span) / ((speed + 1.0) * exp(-span) - 1.0)
        now, speed = now + span, 1.0 - (speed + 1.0) * exp(-span)
        times.append(now)
    return np.array(times[1:-1])


def _scalar(solver: Solver, **settings: float) -> tuple[Plant, np.ndarray]:
    """The scalar problem ``x'' = -sgn x - x'`` made of wheels: unit pitch, ``mu g = 1``.

    A parcel as long as three pitches stands on three columns and gains and loses the outer ones as it passes 0. With
    the inner wheels running outward and the outer ones inward at 3 m/s, the loads' lever rule gives a pull of exactly
    -1 on the right and +1 on the left.
    """
    body = parcel(size_m=(3.0, 1.6), position_m=(0.0, 0.0), angle_rad=0.0, velocity_m_s=(1.0, 0.0))
    plant = solver.plant(body, rows=2, columns=6, pitch_m=1.0, mu=1.0 / G, solver=settings)
    x = plant.array.positions_m[:, 0]
    drives = np.zeros((len(plant.array), 2))
    drives[:, 0] = np.where(np.abs(x) < 1.0, 3.0, -3.0) * np.sign(x)
    return plant, drives


@claiming(Claim.LOADS)
def test_wheels_in_a_linear_field_pull_as_the_field_does_at_the_centre_of_mass_whatever_carries_it(
    solver: Solver,
) -> None:
    """``sum N_i V_i = W K X`` for ``V = K p``: on any supports, some of them lifted."""
    draw, field, lifted = np.random.default_rng([40, 1]), np.array([[-1.0, 0.4], [0.3, -2.0]]), 0
    for _ in range(40):
        holes = [divmod(int(i), 12) for i in draw.choice(144, 50, replace=False)]
        body = parcel(
            size_m=(0.6, 0.3),
            centre_of_mass_m=tuple(draw.uniform(-0.1, 0.1, 2)),
            position_m=tuple(draw.uniform(-0.2, 0.2, 2)),
            angle_rad=float(draw.uniform(-3.0, 3.0)),
        )
        try:
            plant = solver.plant(body, rows=12, columns=12, missing=tuple(holes))
        except PlantError:  # it would tip
            continue
        cells, share = loads(plant)
        lifted += bool(np.any(share == 0.0))
        speeds = plant.array.positions_m[cells] @ field.T
        assert share @ speeds == pytest.approx(field @ plant.state[0, :2], abs=1e-14)
    assert lifted > 5


@claiming(Claim.MOTION)
@pytest.mark.parametrize("mass_kg", [0.02, 2.0, 200.0])
def test_the_centre_of_mass_in_a_linear_field_is_a_damped_oscillator_whose_mass_drops_out(
    solver: Solver, mass_kg: float
) -> None:
    """Natural frequency ``sqrt(mu g |k|)``, damping ratio ``sqrt(mu g / |k|) / 2``, through any number of supports."""
    plant = solver.plant(parcel(mass_kg=mass_kg))
    trajectory = plant.trajectory(plant.array.positions_m * (-1.0, -2.0), 10 * SECOND, SECOND // 10)
    t = trajectory.time_ns * 1e-9
    for axis, start, k in ((0, 0.55, 1.0), (1, 0.5, 2.0)):
        natural, damping = np.sqrt(MU * G * k), 0.5 * np.sqrt(MU * G / k)
        swing = natural * np.sqrt(1.0 - damping**2)
        way = np.exp(-damping * natural * t)
        way *= start * (np.cos(swing * t) + damping * natural / swing * np.sin(swing * t))
        assert trajectory.state[:, 0, axis] == pytest.approx(way, abs=solver.within(1e-12, 10.0))
    assert plant.support_changes > 50


@claiming(Claim.EVENTS)
def test_the_scalar_chatter_returns_as_often_as_it_should(solver: Solver) -> None:
    """H6, Zeno: OpenModelica PR #16009 (the ball falls through the floor), modypy #32, Reference-FMUs PR #252."""
    plant, drives = _scalar(solver, **solver.located)
    expected = _returns(20.0)
    gained: list[float] = []
    for second in range(1, 21):
        events = plant.advance(drives, second * SECOND)[1]
        gained += [event.time_s for event in events if event.kind == "support_gained"]
        if second in RETURNS:
            # a return changes a column of two cells on each side, all at one instant
            assert len(gained) // 2 == np.count_nonzero(expected <= second) == RETURNS[second]
            # the column left behind at the start is the odd one
            assert plant.support_changes == 2 * len(gained) + 2
    assert gained[::2] == pytest.approx(expected, abs=1e-9)
    assert np.abs(plant.state[0, [1, 2, 4, 5]]).max() < 1e-12


def test_the_scalar_chatter_followed_for_thirty_seconds_returns_32_548_times(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """H6 as far as it goes in seconds: ten thousand returns in the last one, more than a run would allow."""
    monkeypatch.setattr(exact, "EVENTS_PER_SECOND", 100_000)
    plant, drives = _scalar(SOLVERS["exact"], **SOLVERS["exact"].located)
    for until in range(100_000_000, 30 * SECOND + 1, 100_000_000):
        plant.advance(drives, until)
    # where swings are 1e-9 m, a place known to 1e-16 m leaves the last of them open
    assert (plant.support_changes - 2) / 4 == pytest.approx(RETURNS[30], abs=3)


@claiming(Claim.CHATTER)
def test_the_scalar_chatter_captured_is_motion_on_the_surface(solver: Solver) -> None:
    """H6: with swings below 0.1 mm replaced by their limit it comes to rest at zero, about a hundred returns later."""
    plant, drives = _scalar(solver, capture_m=1e-4)
    _, events = plant.advance(drives, 1000 * SECOND)
    # speed falls by two thirds of its square at each return, and 0.1 mm are 0.014 m/s at 1 m/s^2
    assert 4 * 80 < plant.support_changes < 4 * 140
    assert [event.kind for event in events if event.kind in ("captured", "released")] == ["captured"]
    assert np.abs(plant.state).max() < solver.within(1e-12)


@claiming(Claim.MOTION)
@pytest.mark.parametrize(("left", "right"), [(0.1, 0.1), (0.2, 0.1), (0.1, 0.4), (0.25, 0.05)])
def test_the_equilibrium_between_opposed_wheels_moves_with_their_speeds(
    solver: Solver, left: float, right: float
) -> None:
    """Viscous, two opposed groups of wheels: the loads shift until ``N_left V_left = N_right V_right``."""
    plant = solver.plant(parcel(size_m=(1.0, 0.8), position_m=(0.02, 0.0), angle_rad=0.0), rows=2, columns=2)
    drives = np.zeros((4, 2))
    drives[:, 0] = np.where(plant.array.positions_m[:, 0] < 0.0, left, -right)
    plant.advance(drives, 600 * SECOND)
    assert plant.state[0, 0] == pytest.approx(0.05 * (left - right) / (left + right), abs=solver.within(1e-9))
    assert plant.state[0, 1:] == pytest.approx([0.0] * 5, abs=solver.within(1e-9))


def _opposed(plant: Plant, left: float, right: float) -> np.ndarray:
    """Wheels left of the middle drive to the right, the others to the left."""
    x = plant.array.positions_m[:, 0]
    return np.stack([np.where(x < 0.0, left, -right), np.zeros_like(x)], axis=1)


def _between(solver: Solver, law: str, x: float, velocity: float, mass_kg: float) -> Plant:
    """A long parcel on sixteen columns of four cells, half of which will drive against the others."""
    body = parcel(
        size_m=(1.58, 0.38),
        position_m=(x, 0.0),
        angle_rad=0.0,
        velocity_m_s=(velocity, 0.0),
        mass_kg=mass_kg,
    )
    return solver.plant(body, law=LAWS[law])


@claiming(Claim.MOTION, laws=["coulomb", "cone", "sliding"])
@pytest.mark.parametrize(("left", "right"), [(0.05, 0.05), (0.06, 0.05), (0.05, 0.5)])
def test_the_equilibrium_between_opposed_wheels_does_not_move_with_their_speeds_under_coulomb_friction(
    solver: Solver, law: str, left: float, right: float
) -> None:
    """The paper's second model: what counts is which way a wheel turns. Nothing damps the swing about the middle."""
    plant = _between(solver, law, 0.01, 0.0, 2.0)
    x = np.abs(plant.array.positions_m[plant._solver.covered_cells(0), 0])
    w = np.sqrt(COULOMB_MU * G * x.sum() / (x**2).sum())
    for second in (1, 2, 3):
        plant.advance(_opposed(plant, left, right), second * SECOND)
        assert plant.state[0, 0] == pytest.approx(0.01 * np.cos(w * second), abs=solver.within(1e-11, second))
    assert plant.support_changes == 0


@claiming(Claim.MOTION, laws=["rolling"])
@pytest.mark.parametrize("velocity", [0.05, -0.08])
def test_without_slip_where_a_parcel_ends_between_opposed_wheels_depends_on_how_it_came(
    solver: Solver, law: str, velocity: float
) -> None:
    """The paper's third model: forces balance anywhere on the same n supports, ``m v0 / (n b)`` further on."""
    plant = _between(solver, law, 0.0, velocity, 200.0)
    plant.advance(_opposed(plant, 0.05, 0.05), 20 * SECOND)
    assert plant.support_changes == 0
    assert plant.state[0, 0] == pytest.approx(200.0 * velocity / (64 * B), abs=solver.within(1e-9, 20.0))


@claiming(Claim.MOTION, Claim.STICKING, laws=["coulomb", "cone"])
@pytest.mark.parametrize("speed", [0.05, 0.2])
def test_coulomb_a_stopped_parcel_reaches_its_wheels_at_v_over_mu_g_and_then_sticks_exactly(
    solver: Solver, law: str, speed: float
) -> None:
    plant = solver.plant(parcel(position_m=(0.0, 0.0), angle_rad=0.0), law=LAWS[law])
    drives = np.tile((speed, 0.0), (400, 1))
    reached = speed / (COULOMB_MU * G)
    before = round((reached - 2e-3) * SECOND)
    plant.advance(drives, before)
    assert plant.state[0, 3] == pytest.approx(COULOMB_MU * G * before * 1e-9, abs=solver.within(1e-12))
    for after in (round((reached + 2e-3) * SECOND), SECOND):
        plant.advance(drives, after)
        assert plant.state[0, 3:].tolist() == [speed, 0.0, 0.0]
        way = speed * (after * 1e-9 - 0.5 * reached)
        assert plant.state[0, 0] == pytest.approx(way, abs=solver.within(1e-12))
