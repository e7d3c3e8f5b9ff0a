"""Contacts resolved: impacts and pressing against closed forms, conserved momentum, energy that never rises."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from plant.effects.parcel_contact.resolve import Resolution
from plant.effects.parcel_contact.spec import ParcelContactSpec
from plant.faults.base import WheelFaults
from plant.parcel_spec import ParcelSpec
from plant.plant import Plant
from tests.plant.effects.parcel_contact.benches import BOX, box, energy, least_gap, plant, run, still, ticks
from tests.plant.scenes import MU, SECOND, TICK_NS, G, spec

KAPPA = MU * G
WALL = ((0.6, -1.0), (0.6, 1.0))
SIDE = ((-2.0, 0.5), (2.0, 0.5))


def _velocity(plant: Plant) -> np.ndarray:
    return plant.state[:, 3:]


# --- impacts ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("restitution", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("mass", [2.0, 5.0])
def test_head_on_two_parcels_part_at_newtons_speeds(restitution: float, mass: float) -> None:
    bench = plant(
        box(-0.4, 0.0, velocity_m_s=(0.5, 0.0)),
        box(0.2, 0.0, velocity_m_s=(-0.1, 0.0), mass_kg=mass),
        restitution=restitution,
    )
    events = run(bench, still(bench), 1.0)
    together = (2.0 * 0.5 - mass * 0.1) / (2.0 + mass)
    first = together - mass * restitution * 0.6 / (2.0 + mass)
    second = together + 2.0 * restitution * 0.6 / (2.0 + mass)
    assert _velocity(bench)[:, 0] == pytest.approx([first, second], abs=1e-9)
    assert np.abs(_velocity(bench)[:, 1:]).max() < 1e-9
    assert [event.kind for event in events] == (["contact", "apart"] if restitution else ["contact"])
    assert events[0].time_s == pytest.approx(0.35 / 0.6, abs=5e-9)


def test_equal_parcels_exchange_their_velocities_when_nothing_is_lost() -> None:
    bench = plant(
        box(-0.4, 0.0, velocity_m_s=(0.5, 0.0)), box(0.2, 0.0, velocity_m_s=(-0.1, 0.0)), restitution=1.0
    )
    run(bench, still(bench), 1.0)
    assert _velocity(bench)[:, 0] == pytest.approx([-0.1, 0.5], abs=1e-11)


@pytest.mark.parametrize("friction", [0.0, 0.1, 5.0])
def test_a_parcel_that_falls_on_a_rail_on_its_corner_rebounds_as_a_rigid_body(friction: float) -> None:
    # the corner under the centre of mass: normal and tangential impulses don't couple through the normal
    restitution, speed, along, arm = 0.6, 0.4, 0.3, BOX * np.sqrt(0.5)
    bench = plant(
        box(-0.3, 0.0, np.pi / 4, velocity_m_s=(along, speed)),
        rails=(SIDE,),
        restitution=restitution,
        friction=friction,
    )
    run(bench, still(bench), (0.5 - arm) / speed + 0.02)
    mass, inertia = 2.0, 2.0 * BOX * BOX / 6.0
    push = (1.0 + restitution) * mass * speed
    held = along / (1.0 / mass + arm * arm / inertia)
    pull = min(friction * push, held)
    expected = [along - pull / mass, -restitution * speed, arm * pull / inertia]
    assert _velocity(bench)[0] == pytest.approx(expected, abs=1e-7)


def test_a_parcel_that_falls_flat_on_a_rail_loses_mu_of_the_push_along_it_and_does_not_turn() -> None:
    bench = plant(box(-0.3, 0.0, velocity_m_s=(0.3, 0.4)), rails=(SIDE,), restitution=0.5, friction=0.2)
    run(bench, still(bench), 1.0)
    assert _velocity(bench)[0] == pytest.approx([0.3 - 0.2 * 1.5 * 0.4, -0.2, 0.0], abs=1e-8)


@settings(max_examples=8, phases=[Phase.explicit, Phase.reuse, Phase.generate])
@given(
    st.lists(st.tuples(*[st.floats(-1.0, 1.0)] * 6), min_size=4, max_size=4),
    st.floats(0.0, 1.0),
    st.floats(0.0, 1.0),
)
def test_parcels_thrown_at_each_other_keep_their_momentum_gain_no_energy_and_never_overlap(
    thrown: list[tuple[float, ...]], restitution: float, friction: float
) -> None:
    places = [(-0.3, -0.3), (0.3, -0.3), (-0.3, 0.3), (0.3, 0.3)]
    parcels: tuple[ParcelSpec, ...] = tuple(
        box(
            x,
            y,
            3.0 * turn,
            size_m=(0.25 + 0.1 * a, 0.2 + 0.05 * b),
            mass_kg=1.5 + a,
            velocity_m_s=(-2.0 * x + 0.5 * vx, -2.0 * y + 0.5 * vy),
            angular_velocity_rad_s=3.0 * omega,
        )
        for (x, y), (turn, a, b, vx, vy, omega) in zip(places, thrown, strict=True)
    )
    bench = plant(*parcels, fine=True, restitution=restitution, friction=friction)
    mass = np.array([one.mass_kg for one in parcels])
    had, before = energy(bench, parcels), mass @ bench.state[:, 3:5]
    for _ in ticks(bench, still(bench), 150):
        now = energy(bench, parcels)
        assert now <= had * (1.0 + 1e-11)
        assert least_gap(bench) >= 0.0
        had = now
    assert {one.state for one in bench.status} <= {"moving", "at_rest"}
    assert mass @ bench.state[:, 3:5] == pytest.approx(before, abs=1e-10)


def test_a_blow_off_the_centres_keeps_the_angular_momentum() -> None:
    parcels = (box(-0.3, 0.0, 0.3, velocity_m_s=(0.5, 0.1)), box(0.1, 0.07, -0.2, angular_velocity_rad_s=1.0))
    bench = plant(*parcels, restitution=0.7, friction=0.4)
    inertia = np.array([one.moment_of_inertia_kg_m2() for one in parcels])

    def spin() -> float:
        x, y, _, vx, vy, omega = bench.state.T
        return float(np.sum(2.0 * (x * vy - y * vx) + inertia * omega))

    before = spin()
    assert any(event.kind == "contact" for event in run(bench, still(bench), 1.0))
    assert spin() == pytest.approx(before, abs=1e-10)


def test_a_parcel_between_two_others_passes_the_blow_on() -> None:
    parcels = (box(-0.6, 0.0, velocity_m_s=(0.5, 0.0)), box(0.0, 0.0), box(BOX + 0.1, 0.0))
    bench = plant(*parcels, restitution=1.0)
    run(bench, still(bench), 1.5)
    assert _velocity(bench)[:, 0] == pytest.approx([0.0, 0.0, 0.5], abs=1e-9)


def test_a_light_parcel_hit_by_a_heavy_one_reaches_one_that_was_out_of_reach() -> None:
    # within one tick it comes four times as far as anything moved when the tick began
    bench = plant(
        box(-BOX - 0.0002, 0.0, mass_kg=2000.0, velocity_m_s=(0.5, 0.0)),
        box(0.0, 0.0, mass_kg=0.01),
        box(BOX + 0.0034, 0.0),
        restitution=1.0,
    )
    for _ in ticks(bench, still(bench), 3):
        assert least_gap(bench) >= 0.0
    assert bench.state[2, 3] > 0.005


# --- pressing ---------------------------------------------------------------------------------------


def _pushed(step_s: float, friction: float = 0.3, **rules: object) -> tuple[Plant, float]:
    """A parcel that lies against a rail, wheels pushing it at it and along it; and its speed after a second."""
    bench = plant(box(-0.5, 0.5 - BOX / 2), rails=(SIDE,), friction=friction, step_s=step_s, mu=MU, **rules)
    drives = np.tile((0.2, 0.1), (len(bench.array), 1))
    run(bench, drives, 1.0)
    return bench, float(bench.state[0, 3])


def test_a_parcel_pushed_along_a_rail_slides_with_mu_of_the_push() -> None:
    # u' = kappa (V - u) - mu_c kappa V_n
    span = round(1e9 / TICK_NS) * TICK_NS / SECOND
    speed, lag = 0.2 - 0.3 * 0.1, -np.expm1(-KAPPA * span) / KAPPA
    errors: list[float] = []
    for step_s in (4.1e-3, 2.05e-3, 1.025e-3):
        bench, reached = _pushed(step_s)
        assert reached == pytest.approx(speed * KAPPA * lag, abs=1e-12)
        errors.append(abs(bench.state[0, 0] + 0.5 - speed * (span - lag)))
    assert errors[2] < 2e-8
    # of second order in the step
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.1)


def test_the_implicit_solver_slides_the_same() -> None:
    other = _pushed(1e-3, implicit=1e-3)[1]
    assert other == pytest.approx(_pushed(1e-3)[1], abs=2e-4)


def test_a_parcel_that_friction_holds_at_a_rail_stays_to_the_last_digit() -> None:
    bench = plant(box(-0.5, 0.5 - BOX / 2), rails=(SIDE,), friction=0.6, mu=MU)
    drives = np.tile((0.05, 0.1), (len(bench.array), 1))
    run(bench, drives, 0.1)
    where = bench.state[0]
    run(bench, drives, 1.0)
    assert np.abs(bench.state[0, 3:]).max() < 1e-14
    assert np.abs(bench.state[0] - where).max() < 1e-14
    assert bench.status[0].state == "at_rest"


def test_bouncing_ends_and_the_parcel_lies_still() -> None:
    bench = plant(box(-0.5, 0.0), rails=(SIDE,), restitution=0.6, mu=MU)
    events = run(bench, np.tile((0.0, 0.2), (len(bench.array), 1)), 6.0)
    bounces = sum(event.kind == "contact" for event in events)
    assert 5 < bounces < 40
    assert events[-1].kind == "contact"
    assert bench.status[0].state == "at_rest"
    assert bench.state[0, 1] == pytest.approx(0.5 - BOX / 2, abs=1e-8)


def test_a_row_of_parcels_is_pressed_against_a_wall_without_sinking_in() -> None:
    bench = plant(*(box(-0.8 + 0.3 * i, 0.0) for i in range(4)), rails=(WALL,), mu=MU)
    drives = np.tile((0.3, 0.0), (len(bench.array), 1))
    worst = min(least_gap(bench) for _ in ticks(bench, drives, 700))
    assert worst >= 0.0
    assert bench.state[:, 0] == pytest.approx([0.6 - BOX * (i - 0.5) for i in (4, 3, 2, 1)], abs=1e-7)
    assert {one.state for one in bench.status} == {"at_rest"}


def test_a_scene_and_its_mirror_image_stay_each_others_image() -> None:
    bench = plant(
        box(-0.5, 0.05, 0.3), box(0.5, 0.05, -0.3), box(0.0, -0.4, 0.0), mu=MU, restitution=0.4, friction=0.2
    )
    drives = -0.5 * bench.array.positions_m
    run(bench, drives, 2.0)
    x, y, turn = bench.state[:, :3].T
    assert x[1] == pytest.approx(-x[0], abs=1e-7)
    assert y[1] == pytest.approx(y[0], abs=1e-7)
    assert turn[1] == pytest.approx(-turn[0], abs=1e-7)
    assert abs(x[2]) < 1e-7


# --- with the rest of the plant ---------------------------------------------------------------------


def test_a_parcel_that_touches_nothing_has_the_bits_it_has_alone() -> None:
    far = box(-0.6, -0.6, 0.4, size_m=(0.3, 0.2))
    bench = plant(box(0.2, 0.4), box(0.6, 0.4), far, mu=MU, restitution=0.5)
    alone = Plant(spec(far, mu=MU))
    drives = np.tile((0.05, 0.02), (len(bench.array), 1))
    drives[bench.array.positions_m[:, 0] > 0.4] = (-0.2, 0.0)
    assert any(run(bench, drives, 2.5))
    for _ in range(round(2.5e9 / TICK_NS)):
        alone.advance(drives, alone.time_ns + TICK_NS)
    assert bench.state[2].tobytes() == alone.state[0].tobytes()


def test_a_simulation_in_one_call_is_the_run_tick_by_tick() -> None:
    def fresh() -> Plant:
        return plant(box(-0.2, 0.1, 0.2), box(0.2, 0.0), rails=(SIDE,), mu=MU, restitution=0.5, friction=0.2)

    one, other = fresh(), fresh()
    drives = -1.2 * one.array.positions_m + (0.0, 0.1)
    events = run(one, drives, 300 * TICK_NS / SECOND)
    trajectory = other.trajectory(drives, 300 * TICK_NS, TICK_NS)
    assert len(events) >= 2
    assert one.state.tobytes() == trajectory.state[-1].tobytes()
    assert [event for event in trajectory.events if event.kind in ("contact", "apart")] == events


def test_a_tipped_parcel_stands_in_the_way() -> None:
    # the cells under its right end are missing: it tips there and stays
    holes = {"missing": [(r, c) for r in range(6, 14) for c in range(12, 15)]}
    tipping = box(-0.05, 0.0, size_m=(0.4, 0.2))
    values = dict(spec(tipping, box(-0.5, 0.0), mu=MU, **holes)) | {
        "effects": {"parcel_contact": ParcelContactSpec(restitution=0.0)}
    }
    bench = Plant(type(spec(tipping)).model_validate(values))
    events = run(bench, np.tile((0.3, 0.0), (len(bench.array), 1)), 3.0)
    assert bench.status[0].state == "tipped"
    assert [(event.kind, event.parcel, event.detail.split(",")[0]) for event in events] == [
        ("contact", 0, "with parcel 1")
    ]
    assert bench.state[1, 0] == pytest.approx(bench.state[0, 0] - 0.2 - BOX / 2, abs=1e-7)
    assert np.abs(bench.state[0, 3:]).max() == 0.0
    assert bench.status[1].state == "at_rest"


@pytest.mark.parametrize(("given", "kinds"), [(None, ["contact"]), (1e-4, ["contact", "apart"])])
def test_what_meets_too_slowly_to_bounce_does_so_where_that_is_said(
    given: float | None, kinds: list[str]
) -> None:
    # 0.8 mm/s: below 0.01 pitches of 0.1 m a second
    made = plant(
        box(-0.2, 0.0, velocity_m_s=(4e-4, 0.0)),
        box(0.0500001, 0.0, velocity_m_s=(-4e-4, 0.0)),
        restitution=1.0,
        bounce_speed_m_s=given,
    )
    assert [event.kind for event in run(made, still(made), 0.1)] == kinds


def test_the_speed_that_still_bounces_goes_with_the_pitch() -> None:
    rules = ParcelContactSpec()
    assert (rules.slow_m_s(0.1), rules.slow_m_s(0.001)) == (1e-3, pytest.approx(1e-5, rel=1e-15))


def test_a_group_at_rest_on_wheels_that_stand_sleeps_until_a_wheel_turns(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls: list[int] = []
    resolve = Resolution.run

    def counted(self: Resolution, span_s: float) -> None:
        calls.append(len(self.group.names))
        resolve(self, span_s)

    monkeypatch.setattr(Resolution, "run", counted)
    bench = plant(box(-BOX / 2.0, 0.0), box(BOX / 2.0, 0.0), mu=0.5)
    belts = still(bench)
    (told,) = run(bench, belts, 0.1)
    assert (told.kind, told.time_s) == ("contact", 0.0)
    assert len(calls) == 1, "the call that finds the contact"
    calls.clear()
    belts[:, 0] = np.where(bench.array.positions_m[:, 0] < 0.0, 0.2, -0.2)
    run(bench, belts, 0.1)
    pressed = len(calls)
    assert pressed > 20
    run(bench, still(bench), 0.1)
    assert len(calls) == pressed, "pressed boxes are at rest at once"
    assert np.array_equal(bench.state[:, 3:], np.zeros((2, 3)))


def test_a_sleeping_parcel_whose_supports_are_pulled_falls() -> None:
    bench = plant(box(-BOX / 2.0, 0.0), box(BOX / 2.0, 0.0), mu=0.5)
    run(bench, still(bench), 0.1)
    wheel_faults = WheelFaults.healthy(len(bench.array))
    wheel_faults.gone[bench.array.positions_m[:, 0] > 0.1] = True
    bench.apply_faults(wheel_faults, still(bench))
    _, events = bench.advance(still(bench), bench.time_ns + TICK_NS)
    assert (events[-1].kind, events[-1].parcel) == ("off_array", 1)
