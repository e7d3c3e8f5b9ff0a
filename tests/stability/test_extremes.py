"""Masses, frictions and motors over many decades: the closed forms hold at each."""

from __future__ import annotations

import numpy as np
import pytest

from plant.effects.motors import MotorsSpec
from tests.plant.scenes import MU, SECOND, TICK_NS, G, elliptic, parcel
from tests.stability.solvers import Claim, Solver, claiming

KAPPA = MU * G


@claiming(Claim.MOTION, Claim.STIFFNESS)
@pytest.mark.parametrize("mass_kg", [1e-3, 1e-1, 1e3, 1e5])
def test_mass_drops_out(solver: Solver, mass_kg: float) -> None:
    """Mass ratios of eight decades on one array: loads scale with weight, so nothing else may see it."""
    light, plain = solver.plant(parcel(mass_kg=mass_kg)), solver.plant(parcel())
    for plant in (light, plain):
        plant.advance(elliptic(plant), 10 * SECOND)
    assert light.state == pytest.approx(plain.state, abs=solver.within(1e-12, 10.0))


@claiming(Claim.STIFFNESS)
def test_parcels_of_very_different_mass_do_not_disturb_each_other(solver: Solver) -> None:
    """Mass ratios: engines that solve all contacts at once lose the light body's digits to the heavy one."""
    light = parcel(size_m=(0.3, 0.3), position_m=(-0.4, -0.4), mass_kg=1e-3)
    heavy = parcel(size_m=(0.3, 0.3), position_m=(0.4, 0.4), mass_kg=1e5)
    both, alone = solver.plant(light, heavy), solver.plant(light)
    for plant in (both, alone):
        plant.advance(np.tile((0.02, 0.01), (400, 1)), 5 * SECOND)
    assert np.array_equal(both.state[0], alone.state[0])


@claiming(Claim.MOTION, Claim.STIFFNESS)
@pytest.mark.parametrize("mass_over_inertia", [1e-6, 1e-2, 1e4, 1e6])
def test_spin_on_stopped_wheels_decays_at_its_rate_whatever_the_inertia(
    solver: Solver, mass_over_inertia: float
) -> None:
    """Mass against moment of inertia, over twelve decades: a ring of lead, and a pin with a wide flat foot."""
    body = parcel(
        size_m=(3.0, 3.0),
        mass_kg=2.0,
        inertia_kg_m2=2.0 / mass_over_inertia,
        position_m=(0.0, 0.0),
        angular_velocity_rad_s=1.0,
    )
    plant = solver.plant(body, rows=4, columns=4)
    plant.advance(np.zeros((16, 2)), 2 * SECOND)
    square = float(np.mean(np.sum(plant.array.positions_m**2, axis=1)))
    rate = KAPPA * mass_over_inertia * square
    assert plant.state[0, 5] == pytest.approx(np.exp(-2.0 * rate), abs=solver.within(1e-12, 2.0))
    assert plant.state[0, 2] - 0.9 == pytest.approx(
        -np.expm1(-2.0 * rate) / rate, rel=1e-9, abs=solver.within(0.0, 2.0)
    )


@claiming(Claim.MOTION, Claim.STIFFNESS)
@pytest.mark.parametrize("mu", [1e-6, 1e-4, 1e-2, 1.0, 1e2, 1e4])
def test_friction_over_ten_decades_gives_the_closed_form(solver: Solver, mu: float) -> None:
    """Friction 1e-6 to 1e4 s/m: from frictionless to a stiffness that an explicit step would have to resolve."""
    plant = solver.plant(parcel(position_m=(0.3, 0.25), velocity_m_s=(-0.05, 0.02)), mu=mu)
    start = plant.state[0]
    plant.advance(elliptic(plant), 2 * SECOND)
    for axis, k in ((0, 1.0), (1, 2.0)):
        # roots of s^2 + kappa s + kappa k, the smaller without cancellation
        kappa = mu * G
        fast = -0.5 * (kappa + np.sqrt(complex(kappa * kappa - 4.0 * kappa * k)))
        slow = kappa * k / fast
        x, u = start[axis], start[3 + axis]
        of_fast, of_slow = (u - slow * x) / (fast - slow), (fast * x - u) / (fast - slow)
        at = of_fast * np.exp(2.0 * fast) + of_slow * np.exp(2.0 * slow)
        moving = fast * of_fast * np.exp(2.0 * fast) + slow * of_slow * np.exp(2.0 * slow)
        assert plant.state[0, axis] == pytest.approx(at.real, abs=solver.within(1e-10, 2.0))
        assert plant.state[0, 3 + axis] == pytest.approx(moving.real, abs=solver.within(1e-10, 2.0))
    assert plant.support_changes > 3


@claiming(Claim.MOTION, Claim.STIFFNESS)
@pytest.mark.parametrize("time_constant_s", [1e-6, 1e-4, 1e-2, 1.0, 1e2])
@pytest.mark.parametrize("tick_ns", [TICK_NS, SECOND])
def test_motors_over_eight_decades_give_the_closed_form(
    solver: Solver, time_constant_s: float, tick_ns: int
) -> None:
    """Motor time constants 1e-6 to 1e2 s: much shorter than a tick, and much longer than the run."""
    motors = MotorsSpec(time_constant_s=time_constant_s, speed_per_volt_m_s=0.1, supply_v=12.0)
    plant = solver.plant(parcel(position_m=(-0.4, -0.2)), motors=motors)
    for until in range(tick_ns, SECOND + tick_ns, tick_ns):
        plant.advance(np.tile((3.0, 1.5), (400, 1)), until)
    t, rate = plant.time_ns * 1e-9, 1.0 / time_constant_s
    # U' = kappa (V (1 - exp(-rate t)) - U) from rest, and its integral
    a, b = rate / (KAPPA - rate), KAPPA / (KAPPA - rate)
    way = t - a * np.expm1(-KAPPA * t) / KAPPA + b * np.expm1(-rate * t) / rate
    speed = 1.0 + a * np.exp(-KAPPA * t) - b * np.exp(-rate * t)
    for axis, (start, wheel) in enumerate(((-0.4, 0.3), (-0.2, 0.15))):
        assert plant.state[0, axis] == pytest.approx(start + wheel * way, abs=solver.within(1e-11))
        assert plant.state[0, 3 + axis] == pytest.approx(wheel * speed, abs=solver.within(1e-11))
    assert plant.state[0, 2] == pytest.approx(0.9, abs=solver.within(1e-12))
