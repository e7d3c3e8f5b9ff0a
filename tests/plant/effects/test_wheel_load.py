"""Wheels that feel what they pull: against SciPy, closed forms, balances, and the motors by themselves."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError
from scipy.integrate import solve_ivp

from plant.friction.registry import FrictionSpec
from plant.parcel_spec import ParcelSpec
from plant.plant import Plant
from plant.solvers.implicit import Implicit
from plant.specs import PlantSpec
from tests.plant.laws import CONE, COULOMB, DAMPED, DAMPED_CONE, MU, SLIDING, VISCOUS
from tests.plant.reference import Bench
from tests.plant.scenes import SECOND, Floats, G, bench, parcel, spec

pytestmark = pytest.mark.slow

TAU = 0.06
INERTIA = 0.3
MASS = 2.0
VOLTS = 10.0
"""For 1 m/s."""
ROLLERS = {"spacing_m": 2e-3, "impulse_s": 1e-3}
"""They pull more than the law does."""
JUST_AFTER_S = 1e-6
"""So long after an event its function is clear of zero."""
Pull = Callable[[Floats, Floats, Floats], Floats]
LAWS = [VISCOUS, COULOMB, CONE, SLIDING, DAMPED]
NAMES = ["viscous", "coulomb", "cone", "sliding", "damped"]
EVERY = [VISCOUS, COULOMB, CONE, DAMPED, DAMPED_CONE]
"""But full sliding, which stopped wheels brake by nothing."""
ALL_NAMES = ["viscous", "coulomb", "cone", "damped", "damped cone"]


def scene(
    law: FrictionSpec,
    *bodies: ParcelSpec,
    inertia_kg: float | None = INERTIA,
    tau: float = TAU,
    solver: dict[str, object] | None = None,
    width_m: float | None = None,
    rollers: dict[str, float] | None = None,
    **array: object,
) -> PlantSpec:
    """A small array of motors, which feel what they pull but where ``inertia_kg`` is None."""
    effects: dict[str, object] = {"motors": {"time_constant_s": tau, "supply_v": 1e3}}
    if inertia_kg is not None:
        effects["wheel_load"] = {"inertia_kg": inertia_kg}
    if width_m is not None:
        effects["contact_width"] = {"width_m": width_m}
    if rollers is not None:
        effects["roller_impacts"] = rollers
    values = dict(spec(*bodies, **({"rows": 8, "columns": 10} | array)))  # type: ignore[arg-type]
    values |= {"friction": law, "effects": effects}
    values["solver"] = {"name": "implicit"} | ({"tolerance": 1e-9} if solver is None else solver)
    return PlantSpec.model_validate(values)


def box(**values: object) -> ParcelSpec:
    """A parcel that turns while it slides, on some twenty cells."""
    settings: dict[str, object] = {"size_m": (0.54, 0.32), "position_m": (0.02, 0.01), "angle_rad": 0.3}
    return parcel(**(settings | values))


def field(plant: Plant) -> Floats:
    """Volts for a field that brings parcels to the middle, and turns them."""
    x, y = plant.array.positions_m.T
    return VOLTS * np.stack([0.4 - x - 0.5 * y, 0.2 + 0.5 * x - 2.0 * y], axis=1)


def energy(plant: Plant, inertia_kg: float) -> float:
    """Of the parcel's motion and the wheels', J."""
    state = plant.state[0]
    turning = plant._solver.parcels[0].par[1]  # type: ignore[attr-defined]
    return float(
        0.5 * MASS * (state[3] ** 2 + state[4] ** 2 + state[5] ** 2 / turning)
        + 0.5 * inertia_kg * np.sum(plant.wheel_speed**2)
    )


def viscous(loads: Floats, speed: Floats, under: Floats) -> Floats:
    """Force per kilogram of the parcel, eq. 14."""
    return VISCOUS.coefficient_s_per_m * G * loads[:, None] * (speed - under)


def damped(loads: Floats, speed: Floats, under: Floats) -> Floats:
    """Force per kilogram of wheels that all slip, Coulomb's with viscous friction."""
    slip = speed - under
    return MU * G * loads[:, None] * np.sign(slip) + DAMPED.viscous_n_s_per_m / MASS * slip


def together(plant: Plant, volts: Floats, pull: Pull, span_s: float) -> tuple[Floats, Floats, Floats, int]:
    """SciPy's account of parcel and wheels as one system: (parcel, speed, travel, changes of support)."""
    n = len(volts)
    free, sheet = volts / VOLTS, bench(plant, volts)
    mass_over_inertia = sheet.mass_over_inertia

    def rates(supports: NDArray[np.int64]) -> Callable[[float, Floats], Floats]:
        def slope(_: float, z: Floats) -> Floats:
            y, speed = z[:6], z[6 : 6 + 2 * n].reshape(n, 2)
            loads, _ = sheet.plane_loads(y, supports)
            assert np.all(loads > 0.0)
            offset = sheet.cells[supports] - y[:2]
            under = y[3:5] + y[5] * np.stack([-offset[:, 1], offset[:, 0]], axis=1)
            force = pull(loads, speed[supports], under)
            torque = np.sum(offset[:, 0] * force[:, 1] - offset[:, 1] * force[:, 0])
            change = (free - speed) / TAU
            change[supports] -= MASS / INERTIA * force
            return np.concatenate(
                [y[3:], force.sum(axis=0), [mass_over_inertia * torque], change.ravel(), speed.ravel()]
            )

        return slope

    z = np.concatenate([plant.state[0], np.zeros(4 * n)])
    now, changes, inside = 0.0, 0, sheet.depth(z[:6], sheet.cells) >= 0.0

    def solve(until_s: float, *events: Callable[[float, Floats], float]) -> tuple[float, Floats]:
        solved = solve_ivp(
            rates(np.flatnonzero(inside)),
            (now, until_s),
            z,
            method="DOP853",
            rtol=1e-12,
            atol=1e-13,
            events=events,
            max_step=0.01,
        )
        assert solved.success
        return float(solved.t[-1]), solved.y[:, -1]

    while now < span_s:
        if changes:
            # away from the event that began this set: by rounding it is on either side of where it starts
            now, z = solve(min(now + JUST_AFTER_S, span_s))
        now, z = solve(span_s, _margin(sheet, inside))
        if now < span_s:
            toggled = np.argmin(np.abs(sheet.depth(z[:6], sheet.cells)))
            inside[toggled] = not inside[toggled]
            changes += 1
    return z[:6], z[6 : 6 + 2 * n].reshape(n, 2), z[6 + 2 * n :].reshape(n, 2), changes


def _margin(sheet: Bench, inside: NDArray[np.bool_]) -> Callable[[float, Floats], float]:
    def margin(_: float, z: Floats) -> float:
        depth = sheet.depth(z[:6], sheet.cells)
        return float(np.min(np.where(inside, depth, -depth)))

    margin.terminal = True  # type: ignore[attr-defined]
    margin.direction = -1.0  # type: ignore[attr-defined]
    return margin


@pytest.mark.parametrize(
    ("body", "span_s", "changes"),
    [
        (box(), 0.05, 0),
        (box(velocity_m_s=(0.3, 0.2), angular_velocity_rad_s=1.0), 0.12, 2),
        (box(velocity_m_s=(0.2, 0.1), angular_velocity_rad_s=-1.0), 0.2, 3),
    ],
    ids=["one set of supports", "two changes", "three changes"],
)
def test_parcel_and_wheels_move_as_scipy_has_them_move_together(
    body: ParcelSpec, span_s: float, changes: int
) -> None:
    plant = Plant(scene(VISCOUS, body))
    volts = field(plant)
    state, speed, travel, changed = together(plant, volts, viscous, span_s)
    sense, _ = plant.advance(volts, round(span_s * SECOND))
    assert plant.support_changes == changed == changes
    assert plant.state[0] == pytest.approx(state, abs=1e-9)
    assert plant.wheel_speed == pytest.approx(speed, abs=1e-8)
    assert sense.encoder_m == pytest.approx(travel, abs=1e-9)


def test_wheels_that_slip_under_viscous_friction_too_are_slowed_as_scipy_has_it() -> None:
    plant = Plant(scene(DAMPED, box(velocity_m_s=(0.9, 0.8))))
    volts = np.full((len(plant.array), 2), -0.1 * VOLTS)
    state, speed, travel, changed = together(plant, volts, damped, 0.03)
    sense, _ = plant.advance(volts, 3 * SECOND // 100)
    assert plant.support_changes == changed
    assert np.all(speed[plant._solver.covered_cells(0)] < state[3:5])
    assert plant.state[0] == pytest.approx(state, abs=1e-9)
    assert plant.wheel_speed == pytest.approx(speed, abs=1e-8)
    assert sense.encoder_m == pytest.approx(travel, abs=1e-9)


@pytest.mark.parametrize("law", [COULOMB, CONE], ids=["coulomb", "cone"])
def test_a_parcel_that_sticks_is_inertia_that_its_motors_share(law: FrictionSpec) -> None:
    # n wheels at U: (M + n m) dU/dt = n m (V - U) / tau
    body = box(size_m=(0.38, 0.38), position_m=(0.0, 0.0), angle_rad=0.0)
    plant = Plant(scene(law, body))
    volts = np.zeros((len(plant.array), 2))
    volts[:, 0] = 0.1 * VOLTS
    plant.advance(volts, SECOND // 20)
    assert plant.support_changes == 0
    rate = 16 * INERTIA / (MASS + 16 * INERTIA) / TAU
    assert plant.state[0, 3] == pytest.approx(0.1 * -np.expm1(-rate * 0.05), abs=1e-8)
    assert plant.state[0, [4, 5]] == pytest.approx([0.0, 0.0], abs=1e-9)


@pytest.mark.parametrize("law", LAWS, ids=NAMES)
def test_wheels_of_great_inertia_run_as_motors_without_load(law: FrictionSpec) -> None:
    # one wheel's pull, at most 0.3 M g, changes the speed of 1e6 kg by some 1e-6 m/s at most
    body = box(velocity_m_s=(0.2, 0.1))
    alone, loaded = Plant(scene(law, body, inertia_kg=None)), Plant(scene(law, body, inertia_kg=1e6))
    for plant in (alone, loaded):
        plant.advance(field(plant), SECOND // 10)
    assert loaded.state == pytest.approx(alone.state, abs=1e-6)
    assert 0.0 < np.abs(loaded.wheel_speed - alone.wheel_speed).max() < 1e-6


@pytest.mark.parametrize("law", EVERY, ids=ALL_NAMES)
@pytest.mark.parametrize("solver", [{"tolerance": 1e-9}, {"step_s": 0.01}], ids=["controlled", "fixed"])
def test_what_a_parcel_loses_free_wheels_gain(law: FrictionSpec, solver: dict[str, object]) -> None:
    # motors with a time constant of 30 years: nothing but the parcel and the wheels acts
    body = box(velocity_m_s=(0.3, 0.1))
    plant = Plant(scene(law, body, tau=1e9, solver=solver))
    still = np.zeros((len(plant.array), 2))
    for tick in range(1, 6):
        plant.advance(still, tick * SECOND // 50)
        total = MASS * plant.state[0, 3:5] + INERTIA * plant.wheel_speed.sum(axis=0)
        assert total == pytest.approx([MASS * 0.3, MASS * 0.1], abs=1e-8)
    assert np.abs(plant.wheel_speed).max() > 1e-3


@pytest.mark.parametrize("law", EVERY, ids=ALL_NAMES)
@pytest.mark.parametrize("tau", [1e-6, 1e6])
@pytest.mark.parametrize("inertia_kg", [1e-6, 1e6])
def test_on_wheels_without_command_long_steps_gain_no_energy(
    law: FrictionSpec, tau: float, inertia_kg: float
) -> None:
    body = box(velocity_m_s=(0.3, 0.1), angular_velocity_rad_s=1.0)
    plant = Plant(scene(law, body, tau=tau, inertia_kg=inertia_kg, solver={"step_s": 0.05}))
    still = np.zeros((len(plant.array), 2))
    before = energy(plant, inertia_kg)
    for tick in range(1, 6):
        plant.advance(still, tick * SECOND // 20)
        after = energy(plant, inertia_kg)
        assert after <= before * (1.0 + 1e-9)
        before = after


def test_rollers_however_hard_add_no_energy_to_parcel_and_wheels_together() -> None:
    """Light wheels: an impact that stopped the slip as if they were fast would throw them back."""
    body = box(velocity_m_s=(0.3, 0.1), angular_velocity_rad_s=1.0)
    slick = VISCOUS.model_copy(update={"coefficient_s_per_m": 1e-9})
    plant = Plant(scene(slick, body, tau=1e6, rollers={"spacing_m": 2e-3, "impulse_s": 1.0}))
    still = np.zeros((len(plant.array), 2))
    energies = [energy(plant, INERTIA)]
    for tick in range(1, 40):
        plant.advance(still, tick * SECOND // 1000)
        energies.append(energy(plant, INERTIA))
    assert np.diff(energies).max() <= 1e-9 * energies[0]
    assert np.abs(plant.wheel_speed).max() > 0.05
    # what is left is what parcel and some twenty wheels that run along with it have together
    assert energies[-1] < 0.6 * energies[0]


def test_fixed_steps_are_of_first_order_in_the_wheels_too() -> None:
    fine = Plant(scene(VISCOUS, box()))
    volts = field(fine)
    fine.advance(volts, SECOND // 25)
    off = []
    for step_s in (4e-3, 2e-3, 1e-3):
        plant = Plant(scene(VISCOUS, box(), solver={"step_s": step_s}))
        plant.advance(volts, SECOND // 25)
        off.append(np.abs(plant.wheel_speed - fine.wheel_speed).max())
    assert np.log2(np.array(off[:-1]) / off[1:]) == pytest.approx([1.0, 1.0], abs=0.15)


@pytest.mark.parametrize("rollers", [None, ROLLERS], ids=["smooth", "rollers"])
@pytest.mark.parametrize("step_s", [2e-3, 0.05])
@pytest.mark.parametrize("axis", [0, 1])
def test_in_steps_of_any_length_wheels_lose_what_the_parcel_gets_less_what_motors_make_up(
    step_s: float, axis: int, rollers: dict[str, float] | None
) -> None:
    """Speed and encoder together: ``m sum (D + integral of D / tau) = -M U`` for what the load takes, D, of speeds."""
    plant = Plant(scene(VISCOUS, box(angle_rad=0.0), solver={"step_s": step_s}, rollers=rollers))
    drives = np.zeros((len(plant.array), 2))
    drives[:, axis] = VOLTS
    plant.advance(drives, SECOND // 5)
    encoders = plant.sense().encoder_m
    assert encoders is not None
    settled = -np.expm1(-0.2 / TAU)
    slower = plant.wheel_speed[:, axis] - settled
    behind = encoders[:, axis] - (0.2 - TAU * settled)
    assert slower.min() < -0.02
    lost = INERTIA * np.sum(slower + behind / TAU)
    assert lost == pytest.approx(-MASS * plant.state[0, 3 + axis], abs=1e-12)


def test_many_calls_come_to_what_one_does() -> None:
    whole, parts = (Plant(scene(VISCOUS, box(velocity_m_s=(0.3, 0.2)))) for _ in range(2))
    volts = field(whole)
    whole.advance(volts, SECOND // 10)
    for tick in range(1, 26):
        parts.advance(volts, tick * SECOND // 250)
    assert parts.state == pytest.approx(whole.state, abs=1e-9)
    assert parts.wheel_speed == pytest.approx(whole.wheel_speed, abs=1e-8)
    assert parts.sense().encoder_m == pytest.approx(whole.sense().encoder_m, abs=1e-9)


def test_a_wheel_under_four_parcels_is_slowed_by_each_whatever_thread_moves_them() -> None:
    corners = [(x, y) for x in (-0.15, 0.15) for y in (-0.15, 0.15)]
    bodies = [box(size_m=(0.3, 0.3), position_m=place, angle_rad=0.0) for place in corners]
    outcomes = []
    for threads in (1, 2, 3):
        plant = Plant(scene(VISCOUS, *bodies, width_m=0.02, rows=9, columns=9))
        assert isinstance(plant._solver, Implicit)
        plant._solver.thread_pool.threads = threads
        plant.advance(field(plant), SECOND // 2)
        outcomes.append(plant.state.tobytes() + plant.wheel_speed.tobytes())
    assert outcomes[0] == outcomes[1] == outcomes[2]
    shared = []
    for some in (bodies[:1], bodies):
        plant = Plant(scene(VISCOUS, *some, width_m=0.02, rows=9, columns=9))
        plant.advance(np.full((81, 2), VOLTS), SECOND // 1000)
        free = -np.expm1(-1e-3 / TAU)
        shared.append(free - plant.wheel_speed[40, 0])
    assert shared[0] > 1e-6
    assert shared[1] == pytest.approx(4.0 * shared[0], rel=1e-4)


def test_it_is_refused_without_motors_and_by_other_solvers() -> None:
    table = dict(scene(VISCOUS, box()))
    with pytest.raises(ValidationError, match=r"effects\.motors .* effects\.wheel_load needs it"):
        PlantSpec.model_validate(table | {"effects": {"wheel_load": {"inertia_kg": 1.0}}})
    with pytest.raises(
        ValidationError, match=r"solver\.name exact leaves out effects\.wheel_load; use implicit"
    ):
        PlantSpec.model_validate(table | {"solver": {"name": "exact"}})
