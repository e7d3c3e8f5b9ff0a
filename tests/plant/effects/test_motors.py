"""Motors: what a data sheet comes to, and dry friction, against SciPy with located events and closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.integrate import solve_ivp

from plant.effects.motors import DcMotorSpec, Motors, MotorsSpec
from plant.plant import Plant
from plant.sampling import Timing
from plant.specs import PlantSpec
from tests.plant.scenes import TICK_NS, Floats, bench, parcel, spec

TAU, GAIN, COULOMB, STATIC = 0.03, 0.1, 1.0, 1.5
RUBBING = MotorsSpec(time_constant_s=TAU, speed_per_volt_m_s=GAIN, coulomb_v=COULOMB, static_v=STATIC)
MS = 1_000_000
SHEET = {
    "gear_ratio": 20.0,
    "rotor_inertia_kg_m2": 2e-7,
    "wheel_inertia_kg_m2": 4e-5,
    "wheel_radius_m": 0.025,
    "damping_n_m_s": 1e-6,
    "resistance_ohm": 6.0,
    "torque_constant_n_m_per_a": 0.012,
}


def scipy_wheel(volts: list[tuple[float, float]], until_s: float) -> tuple[float, float]:
    """Speed and travel of one wheel from rest by SciPy, which locates where it stops.

    Args:
        volts: instants, ascending from 0, and the voltage from then on.
        until_s: when it ends.
    """
    y = np.zeros(2)
    instants = [*(at for at, _ in volts), until_s]
    for (at, u), end in zip(volts, instants[1:], strict=True):
        now, direction = at, float(np.sign(y[0]))
        while now < end:
            if direction == 0.0:
                if abs(u) <= STATIC:
                    break
                direction = math.copysign(1.0, u)
            # what stops is put past zero, so that the start is not its own event
            stops = lambda t, y, direction=direction: direction * y[0] + (1.0 if t == now else 0.0)  # noqa: B023, E731
            stops.terminal, stops.direction = True, -1.0
            found = solve_ivp(
                lambda t, y, u=u, direction=direction: [
                    (GAIN * (u - direction * COULOMB) - y[0]) / TAU,
                    y[0],
                ],
                (now, end),
                y,
                events=stops,
                rtol=1e-12,
                atol=1e-14,
                max_step=2e-3,
            )
            now, y = found.t[-1], found.y[:, -1]
            if found.status == 1:
                direction = 0.0
                y[0] = 0.0
    return float(y[0]), float(y[1])


def wheels(history: list[tuple[int, int, float]], pieces: int = 1) -> tuple[Floats, Floats]:
    """Speed and travel of the wheels of a cell that acts within calls.

    Args:
        history: for every call, how long it is and when in it the cell acts, ns, and on which voltage.
        pieces: into how many calls those are divided in which it acts at the start.
    """
    motors = Motors(RUBBING, 1)
    for span_ns, acts_ns, volts in history:
        times = 1 if acts_ns else pieces
        for _ in range(times):
            span = span_ns * 1e-9 / times
            acts = np.array([acts_ns * 1e-9]) if acts_ns else None
            motors.elapse(motors.command(np.array([[volts, -volts]]), span, acts), span)
    assert motors.speed[0, 0] == -motors.speed[0, 1]
    assert motors.travel[0, 0] == -motors.travel[0, 1]
    return motors.speed[0], motors.travel[0]


@pytest.mark.parametrize(
    "history",
    [
        [(40 * MS, 0, 8.0), (40 * MS, 0, 0.5), (40 * MS, 0, 0.9)],
        [(40 * MS, 0, 8.0), (40 * MS, 0, -8.0)],
        [(40 * MS, 0, 8.0), (40 * MS, 0, -1.4)],
        [(40 * MS, 0, 8.0), (400 * MS, 100 * MS, -8.0)],
        [(5 * MS, 0, 8.0), (100 * MS, 80 * MS, 3.0), (5 * MS, 0, 0.0), (100 * MS, 90 * MS, -9.0)],
        [(5 * MS, 0, 2.0), (100 * MS, 50 * MS, 1.2), (100 * MS, 99 * MS, -1.6), (9 * MS, 2 * MS, 1.49)],
        [(5 * MS, 0, 2.0), (100 * MS, 0, -1.0), (100 * MS, 99 * MS, -1.6), (9 * MS, 1 * MS, 1.0)],
    ],
    ids=[
        "stops",
        "turns",
        "sticks",
        "acts_and_turns",
        "stops_restarts",
        "starts_twice",
        "stops_after_acting",
    ],
)
def test_dry_friction_stops_sticks_starts_and_turns_as_scipy_locates_it(
    history: list[tuple[int, int, float]],
) -> None:
    now, volts = 0, []
    for span_ns, acts_ns, u in history:
        volts.append(((now + acts_ns) * 1e-9, u))
        now += span_ns
    speed, travel = scipy_wheel(volts, now * 1e-9)
    found, passed = wheels(history)
    assert found[0] == pytest.approx(speed, abs=1e-10)
    assert passed[0] == pytest.approx(travel, abs=1e-10)


def test_a_wheel_that_turns_stops_at_the_closed_form_s_instant_and_then_stands_exactly() -> None:
    motors = Motors(RUBBING, 1)
    motors.elapse(motors.command(np.full((1, 2), 8.0), 0.05), 0.05)
    begun = motors.speed[0, 0]
    assert begun == pytest.approx(0.7 * -np.expm1(-0.05 / TAU), rel=1e-14)
    stops = TAU * np.log1p(begun / (GAIN * 0.5))
    run = motors.command(np.full((1, 2), 0.5), 1.0)
    assert run.changes is not None
    assert run.changes.after_s == pytest.approx(np.full((1, 1, 2), stops), rel=1e-14)
    motors.elapse(run, 1.0)
    assert np.all(motors.speed == 0.0)
    stood = motors.travel.copy()
    motors.elapse(motors.command(np.full((1, 2), -STATIC), 5.0), 5.0)
    assert motors.travel.tobytes() == stood.tobytes()
    assert np.all(motors.speed == 0.0)
    motors.elapse(motors.command(np.full((1, 2), -STATIC * (1 + 1e-12)), 1e-3), 1e-3)
    assert motors.speed == pytest.approx(np.full((1, 2), GAIN * -0.5 * -np.expm1(-1e-3 / TAU)), rel=1e-9)


@pytest.mark.parametrize("volts", [(8.0, -8.0), (8.0, 0.3), (8.0, -1.2), (-1.6, 1.7)])
def test_one_call_is_ten_calls_of_a_tenth(volts: tuple[float, float]) -> None:
    history = [(40 * MS, 0, u) for u in volts]
    whole, passed = wheels(history)
    parts, also = wheels(history, pieces=10)
    assert whole == pytest.approx(parts, abs=1e-12)
    assert passed == pytest.approx(also, abs=1e-12)


def test_travel_is_the_integral_of_speed_until_a_wheel_has_stopped() -> None:
    """Without voltage: way and time until it stops balance the speed lost."""
    motors = Motors(RUBBING, 1)
    motors.elapse(motors.command(np.full((1, 2), 9.0), 0.2), 0.2)
    begun, before = motors.speed[0, 0], motors.travel[0, 0]
    stops = TAU * np.log1p(begun / (GAIN * COULOMB))
    motors.elapse(motors.command(np.zeros((1, 2)), 0.5), 0.5)
    # the integral of dV/dt = -(V + gain c) / tau until it stops
    assert motors.travel[0, 0] - before == pytest.approx(TAU * begun - GAIN * COULOMB * stops, rel=1e-12)
    assert motors.travel[0, 0] - before < TAU * begun


def test_a_wheel_s_changes_are_in_order_and_within_the_call() -> None:
    draw, motors = np.random.default_rng(9), Motors(RUBBING, 200)
    for span_s in (0.05, 0.002):
        motors.elapse(motors.command(draw.uniform(-9.0, 9.0, (200, 2)), span_s), span_s)
    run = motors.command(draw.uniform(-3.0, 3.0, (200, 2)), 0.04, draw.uniform(1e-3, 0.04, 200))
    assert run.changes is not None
    after = run.changes.after_s
    assert len(after) == 3
    assert np.all(np.isinf(after) | (after < 0.04))
    for first, then in ((0, 1), (0, 2), (1, 2)):
        assert np.any(np.isfinite(after[first]) & np.isfinite(after[then]))
        assert not np.any((after[first] >= after[then]) & np.isfinite(after[first]))


def test_encoders_at_any_instant_are_the_travel_of_a_call_that_ends_there() -> None:
    draw, spans = np.random.default_rng(4), np.linspace(1e-3, 0.1, 37)
    motors, acts = Motors(RUBBING, 37), draw.uniform(1e-3, 0.09, 37)
    motors.elapse(motors.command(np.full((37, 2), 6.0), 0.02), 0.02)
    run = motors.command(np.full((37, 2), -4.0), 0.1, acts)
    found = motors.elapse(run, 0.1, spans)
    assert found is not None
    for cell, (span, act) in enumerate(zip(spans, acts, strict=True)):
        alone = Motors(RUBBING, 1)
        alone.elapse(alone.command(np.full((1, 2), 6.0), 0.02), 0.02)
        first = min(span, act)
        alone.elapse(alone.command(np.full((1, 2), 6.0), first), first)
        if span > act:
            alone.elapse(alone.command(np.full((1, 2), -4.0), span - act), span - act)
        assert found[cell] == pytest.approx(alone.travel[0], abs=1e-14)


@pytest.mark.parametrize("timed", [False, True])
def test_a_parcel_on_wheels_that_stop_within_the_call_moves_as_in_the_plain_plant(timed: bool) -> None:
    """Every wheel is stopped by friction within the call; DOP853 restarted there."""
    plant = Plant(spec(parcel(), motors=RUBBING))
    drives = 20.0 * np.sign(plant.array.positions_m)
    plant.advance(drives, 30 * MS)
    y, speed = plant.state[0], plant.wheel_speed.copy()
    stops = TAU * np.log1p(np.abs(speed[0, 0]) / (GAIN * COULOMB))
    assert np.all(np.abs(speed) == np.abs(speed[0, 0]))
    assert stops < 0.1
    none = np.full(400, -1)
    plant.advance(np.zeros((400, 2)), 130 * MS, Timing(none, none) if timed else None)
    steady = -GAIN * COULOMB * np.sign(speed)
    slowing = bench(plant, steady, rate=1.0 / TAU, decay=speed - steady)
    y = slowing.run(y, stops)
    y = bench(plant, np.zeros((400, 2))).run(y, 0.1 - stops)
    assert plant.state[0] == pytest.approx(y, abs=1e-10)
    assert np.all(plant.wheel_speed == 0.0)


def test_a_call_of_forty_ms_over_stopping_wheels_is_ten_of_four() -> None:
    whole, parts = (Plant(spec(parcel(), motors=RUBBING)) for _ in range(2))
    draw = np.random.default_rng(6)
    for tick in range(1, 5):
        drives = draw.uniform(-4.0, 4.0, size=(400, 2))
        whole.advance(drives, 40 * MS * tick)
        for part in range(1, 11):
            parts.advance(drives, 40 * MS * (tick - 1) + 4 * MS * part)
    assert whole.state == pytest.approx(parts.state, abs=1e-12)
    assert whole.sense().encoder_m == pytest.approx(parts.sense().encoder_m, abs=1e-12)
    sampled = Plant(spec(parcel(), motors=RUBBING))
    draw = np.random.default_rng(6)
    drives = draw.uniform(-4.0, 4.0, size=(400, 2))
    trajectory = sampled.trajectory(drives, 40 * MS, 7 * MS)
    stepped = Plant(spec(parcel(), motors=RUBBING))
    for time_ns, state in zip(trajectory.time_ns[1:].tolist(), trajectory.state[1:], strict=True):
        stepped.advance(drives, time_ns)
        assert state == pytest.approx(stepped.state, abs=1e-12)


def test_a_data_sheet_gives_the_equation_of_motion_at_the_surface() -> None:
    """Against the torques at the shaft, integrated by SciPy: rotor angle and current, not surface quantities."""
    dc = DcMotorSpec.model_validate(SHEET | {"coulomb_torque_n_m": 4e-3, "static_torque_n_m": 6e-3})
    u, g, r = 7.0, dc.gear_ratio, dc.wheel_radius_m

    def shaft(t: float, w: Floats) -> Floats:
        """rad/s of the wheel's shaft."""
        current = (u - dc.torque_constant_n_m_per_a * g * w) / dc.resistance_ohm
        torque = g * (dc.torque_constant_n_m_per_a * current - dc.damping_n_m_s * g * w) - 4e-3
        return torque / (dc.wheel_inertia_kg_m2 + dc.rotor_inertia_kg_m2 * g**2)

    found = solve_ivp(shaft, (0.0, 0.05), [0.0], rtol=1e-12, atol=1e-12)
    motors = Motors(MotorsSpec(dc=dc), 1)
    motors.elapse(motors.command(np.full((1, 2), u), 0.05), 0.05)
    assert motors.speed == pytest.approx(np.full((1, 2), r * found.y[0, -1]), rel=1e-9)
    # a stalled wheel: all torque, no back voltage; volts that friction eats
    assert dc.stall_force_n_per_v == pytest.approx(g * dc.torque_constant_n_m_per_a / dc.resistance_ohm / r)
    assert dc.stall_force_n_per_v * dc.coulomb_v == pytest.approx(4e-3 / r)
    assert dc.stall_force_n_per_v * dc.static_v == pytest.approx(6e-3 / r)
    assert dc.damping_n_s_per_m * dc.speed_per_volt_m_s == pytest.approx(dc.stall_force_n_per_v)
    assert dc.inertia_kg == pytest.approx(dc.damping_n_s_per_m * dc.time_constant_s)


def test_the_law_of_rolling_and_the_motor_agree_on_b_without_a_controller() -> None:
    """Eq. 27 with its gain taken to zero: ``b = B + K^2 / R``, and ``f0 = K u / R``."""
    from plant.friction.rolling import Rolling

    dc = DcMotorSpec.model_validate(SHEET)
    leverage = dc.gear_ratio / dc.wheel_radius_m
    gain = 1e-9
    law = Rolling(
        law="rolling",
        motor_constant_n_per_a=dc.torque_constant_n_m_per_a * leverage,
        resistance_ohm=dc.resistance_ohm,
        gain_v_s_per_m=gain,
        drag_n_s_per_m=dc.damping_n_m_s * leverage**2,
    )
    assert law.damping_n_s_per_m == pytest.approx(dc.damping_n_s_per_m, rel=1e-9)
    assert law.free_speed * law.damping_n_s_per_m / gain == pytest.approx(dc.stall_force_n_per_v, rel=1e-9)


def test_dc_and_its_first_order_form_are_the_same_motors() -> None:
    dc = DcMotorSpec.model_validate(SHEET | {"coulomb_torque_n_m": 4e-3})
    plain = MotorsSpec(
        time_constant_s=dc.time_constant_s,
        speed_per_volt_m_s=dc.speed_per_volt_m_s,
        coulomb_v=dc.coulomb_v,
        static_v=dc.coulomb_v,
    )
    assert MotorsSpec(dc=dc).first_order == plain.first_order
    again = MotorsSpec.model_validate(MotorsSpec(dc=dc).model_dump())
    assert again.first_order == plain.first_order


@pytest.mark.parametrize(
    ("motors", "rule"),
    [
        ({"dc": SHEET, "time_constant_s": 0.06}, "time_constant_s follows from dc: give one or the other"),
        ({"dc": SHEET, "coulomb_v": 0.0}, "coulomb_v follows from dc"),
        ({"coulomb_v": 1.0, "static_v": 0.5}, "static_v = 0.5: must be at least coulomb_v, 1"),
        (
            {"dc": SHEET | {"coulomb_torque_n_m": 2e-3, "static_torque_n_m": 1e-3}},
            "static_torque_n_m = 0.001: must be at least coulomb_torque_n_m, 0.002",
        ),
        ({"dc": SHEET | {"wheel_radius_m": 0.0}}, "wheel_radius_m"),
    ],
)
def test_motors_that_contradict_themselves_are_refused(motors: dict[str, object], rule: str) -> None:
    with pytest.raises(ValidationError, match=rule):
        MotorsSpec.model_validate(motors)


@pytest.mark.slow
def test_a_load_needs_an_inertia_that_dc_gives_and_goes_with_no_dry_friction() -> None:
    base = dict(spec(parcel())) | {"solver": {"name": "implicit"}}

    def loaded(motors: dict[str, object], **load: float) -> PlantSpec:
        return PlantSpec.model_validate(base | {"effects": {"motors": motors, "wheel_load": load}})

    dc = DcMotorSpec.model_validate(SHEET)
    assert loaded({"dc": SHEET}).effects.wheel_inertia_kg == dc.inertia_kg
    assert loaded({"dc": SHEET}, inertia_kg=0.5).effects.wheel_inertia_kg == 0.5
    with pytest.raises(ValidationError, match=r"effects.wheel_load .*needs inertia_kg"):
        loaded({})
    for motors in ({"coulomb_v": 1.0}, {"static_v": 1.0}, {"dc": SHEET | {"coulomb_torque_n_m": 1e-3}}):
        with pytest.raises(ValidationError, match=r"effects.motors .*doesn't go with effects.wheel_load"):
            loaded(motors, inertia_kg=0.5)
    stalled = Plant(loaded({"dc": SHEET})), Plant(loaded({"dc": SHEET}, inertia_kg=dc.inertia_kg))
    for plant in stalled:
        plant.advance(np.full((400, 2), 3.0), 10 * TICK_NS)
    assert stalled[0].state.tobytes() == stalled[1].state.tobytes()
