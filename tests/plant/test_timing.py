"""Cells that act and read at instants of their own: against SciPy, division by hand, and cells that don't."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from plant.effects.analogue_sensors.spec import AnalogueSensorsSpec
from plant.effects.motors import MotorsSpec
from plant.errors import PlantError
from plant.parcel_spec import ParcelSpec
from plant.plant import Plant
from plant.sampling import Timing
from plant.specs import PlantSpec
from tests.plant.laws import VISCOUS
from tests.plant.scenes import MU, TICK_NS, Floats, G, bench, elliptic, parcel, solved, spec

TAU = 0.02
MOTORS = MotorsSpec(time_constant_s=TAU, speed_per_volt_m_s=0.1, supply_v=100.0)
RUBBING = MotorsSpec(time_constant_s=TAU, speed_per_volt_m_s=0.1, supply_v=100.0, coulomb_v=0.4, static_v=0.7)
SOLVERS = ["exact", "implicit", "quasi_static", "fixed_step", "scipy"]


def everyone(n: int, acts_ns: int, reads_ns: int) -> Timing:
    return Timing(np.full(n, acts_ns), np.full(n, reads_ns))


def drawn(draw: np.random.Generator, n: int, now_ns: int, until_ns: int) -> Timing:
    return Timing(draw.integers(now_ns, until_ns, n), draw.integers(now_ns, until_ns + 1, n))


def apart(first: ParcelSpec) -> list[ParcelSpec]:
    return [first, parcel(position_m=(-0.5, -0.55), angle_rad=0.2)]


@pytest.mark.parametrize("motors", [None, MOTORS], ids=["ideal", "motors"])
@pytest.mark.parametrize("solver", SOLVERS)
def test_acting_from_the_start_and_reading_at_the_end_is_no_timing_at_all(
    solver: str, motors: MotorsSpec | None
) -> None:
    plain, timed = (solved({"name": solver}, *apart(parcel()), motors=motors) for _ in range(2))
    draw = np.random.default_rng(3)
    for tick in range(1, 6):
        drives, now, until = draw.normal(size=(400, 2)), (tick - 1) * TICK_NS, tick * TICK_NS
        start = now if tick % 2 else -1
        sense, events = plain.advance(drives, until)
        same, other_events = timed.advance(drives, until, everyone(400, start, until))
        assert plain.state.tobytes() == timed.state.tobytes()
        assert plain.wheel_speed.tobytes() == timed.wheel_speed.tobytes()
        assert np.array_equal(sense.presence, same.presence)
        assert sense.presence.any()
        assert events == other_events
        if sense.encoder_m is not None and same.encoder_m is not None:
            assert sense.encoder_m.tobytes() == same.encoder_m.tobytes()


@pytest.mark.parametrize("motors", [None, MOTORS], ids=["ideal", "motors"])
def test_two_wheels_that_act_at_different_instants_move_a_parcel_as_scipy_says(
    motors: MotorsSpec | None,
) -> None:
    """Two cells under a beam on one line: their loads follow from the lever, their speeds from when they act."""
    start = np.array([0.01, 0.0])
    plant = Plant(
        spec(
            parcel(size_m=(0.3, 0.04), position_m=tuple(start), angle_rad=0.0),
            rows=1,
            columns=2,
            motors=motors,
        )
    )
    scale = 1.0 if motors is None else 10.0
    first, second = np.array([0.3, -0.2]), np.array([0.05, 0.4])
    acts, until = np.array([1_234_567, 3_000_001]), np.array([20_000_000, 40_000_000])

    def wheel(cell: int, t: float) -> float:
        """Speed of a wheel from the closed form of each of its motions, one after another."""
        speed, begin = 0.0, 0.0
        for at, to in ((0.0, first[cell]), (until[0] * 1e-9 + acts[cell] * 1e-9, second[cell])):
            if t < at:
                break
            target, speed, begin = (to, to, at) if motors is None else (to, speed, begin)
            if motors is not None:
                if at:
                    speed = first[cell] + (speed - first[cell]) * np.exp(-(at - begin) / TAU)
                begin = at
        return target if motors is None else target + (speed - target) * np.exp(-(t - begin) / TAU)

    def rates(t: float, y: Floats) -> list[float]:
        share = 0.5 + np.array([-1.0, 1.0]) * y[0] / 0.1
        return [y[1], MU * G * (share @ [wheel(0, t), wheel(1, t)] - y[1])]

    drives = np.zeros((2, 2))
    drives[:, 0] = scale * first
    plant.advance(drives, int(until[0]))
    drives[:, 0] = scale * second
    plant.advance(drives, int(until[1]), Timing(until[0] + acts, np.full(2, -1)))
    y, instants = start, [0, until[0], *(until[0] + acts), until[1]]
    for begin, end in pairwise(instants):
        inner = 1e-9 * np.array([begin, end])
        # the integrator must not look across a jump
        y = solve_ivp(rates, (inner[0], np.nextafter(inner[1], 0)), y, rtol=1e-12, atol=1e-14).y[:, -1]
    assert plant.state[0, [0, 3]] == pytest.approx(y, abs=1e-11)


@pytest.mark.parametrize("motors", [None, MOTORS, RUBBING], ids=["ideal", "motors", "rubbing"])
def test_random_instants_are_the_same_as_dividing_the_call_by_hand_at_every_one(
    motors: MotorsSpec | None,
) -> None:
    """Acted on and read by every cell in a time of its own, against a plant that is stopped at each such time."""
    body = parcel(velocity_m_s=(1.0, -0.5), angular_velocity_rad_s=2.0)
    timed, divided = (Plant(spec(body, motors=motors)) for _ in range(2))
    start = divided.sense()
    read, travel = start.presence, start.encoder_m
    n, draw, before = 400, np.random.default_rng(5), np.zeros((400, 2))
    for tick in range(3):
        now, until = tick * 10 * TICK_NS, (tick + 1) * 10 * TICK_NS
        timing, drives = drawn(draw, n, now, until), elliptic(timed) + draw.normal(size=(n, 2))
        timing.reads_ns[::7] = -1
        timing.reads_ns[1::7] = now
        sense, _ = timed.advance(drives, until, timing)
        for instant in np.unique(np.concatenate([timing.acts_ns, timing.reads_ns, [until]])).tolist():
            if instant < 0:
                continue
            acted = timing.acts_ns < instant
            seen, _ = divided.advance(np.where(acted[:, None], drives, before), instant)
            reads = timing.reads_ns == instant
            read = np.where(reads[:, None], seen.presence, read)
            if travel is not None:
                travel = np.where(reads[:, None], seen.encoder_m, travel)
        before = drives
        assert np.abs(timed.state - divided.state).max() < 1e-11
        assert np.array_equal(sense.presence, read)
        if travel is not None:
            assert sense.encoder_m == pytest.approx(travel, abs=1e-13)
            assert timed.wheel_speed == pytest.approx(divided.wheel_speed, abs=1e-13)
    assert timed.support_changes == divided.support_changes > 0


def test_who_reads_as_a_call_begins_sees_what_has_come_since_it_last_read() -> None:
    plant = Plant(spec(parcel(velocity_m_s=(1.0, -0.5)), motors=MOTORS))
    n, still = 400, elliptic(plant)
    first, _ = plant.advance(still, TICK_NS, everyone(n, -1, 0))
    held = first
    for tick in range(2, 40):
        held, _ = plant.advance(still, tick * TICK_NS, everyone(n, -1, -1))
    now = plant.sense()
    later, _ = plant.advance(still, 40 * TICK_NS, everyone(n, -1, 39 * TICK_NS))
    assert np.array_equal(held.presence, first.presence)
    assert np.array_equal(later.presence, now.presence)
    assert not np.array_equal(later.presence, held.presence)
    assert later.encoder_m is not None
    assert now.encoder_m is not None
    assert later.encoder_m.tobytes() == now.encoder_m.tobytes()


def test_levels_are_those_of_each_cell_s_own_instant() -> None:
    """Spots as wide as the pitch allows, so that cells beside the parcel read it too."""
    body = parcel(velocity_m_s=(1.0, -0.5), angular_velocity_rad_s=2.0)
    whole = spec(body)
    levels = AnalogueSensorsSpec(spot_radius_m=whole.array.pitch_m)
    effects = whole.effects.model_copy(update={"analogue_sensors": levels})
    timed, divided = (Plant(whole.model_copy(update={"effects": effects})) for _ in range(2))
    read, draw = divided.sense().level, np.random.default_rng(6)
    assert read is not None
    for tick in range(2):
        now, until = tick * 10 * TICK_NS, (tick + 1) * 10 * TICK_NS
        timing, drives = drawn(draw, 400, now, until), elliptic(timed)
        timing.acts_ns[:] = -1
        timing.reads_ns[::7] = -1
        timing.reads_ns[1::7] = now
        sense, _ = timed.advance(drives, until, timing)
        for instant in np.unique(np.append(timing.reads_ns, until)).tolist():
            if instant >= 0:
                seen, _ = divided.advance(drives, instant)
                assert seen.level is not None
                read = np.where((timing.reads_ns == instant)[:, None], seen.level, read)
        assert sense.level is not None
        assert np.abs(sense.level - read).max() < 1e-10
    assert ((read > 0.0) & (read < 1.0)).sum() > 10


def test_a_parcel_on_wheels_that_change_within_the_call_moves_as_in_the_plain_plant() -> None:
    """DOP853 with every support change located, restarted at every instant at which a wheel below changes."""
    plant = Plant(spec(parcel()))
    draw, first = np.random.default_rng(8), elliptic(plant)
    second, until = first + draw.normal(scale=0.5, size=first.shape), 40_000_000
    acts = np.full(400, -1)
    late = draw.choice(plant._solver.covered_cells(0), 4, replace=False)
    acts[late] = until + np.sort(draw.integers(1, until, 4))
    plant.advance(first, until)
    y = plant.state[0]
    plant.advance(second, 2 * until, Timing(acts, np.full(400, -1)))
    speeds = second.copy()
    speeds[late] = first[late]
    instants = [until, *acts[late].tolist(), 2 * until]
    for k, (begin, end) in enumerate(pairwise(instants)):
        if k:
            speeds[late[k - 1]] = second[late[k - 1]]
        y = bench(plant, speeds.copy()).run(y, (end - begin) * 1e-9)
    assert plant.state[0] == pytest.approx(y, abs=1e-10)


def test_a_cell_sees_the_parcel_at_its_own_instant_and_keeps_what_it_saw() -> None:
    """An edge that crosses a column in the middle of a call: who reads before sees nothing yet."""
    bodies = parcel(size_m=(0.54, 0.32), position_m=(-0.28, 0.0), angle_rad=0.0)
    drives = np.zeros((400, 2))
    drives[:, 0] = 1.0
    gained = [e for e in Plant(spec(bodies)).advance(drives, 10**9)[1] if e.kind == "support_gained"][-1]
    next_cell, crossing_ns = (
        Plant(spec(bodies)).array.lattice.index(gained.cells[0]),
        round(1e9 * gained.time_s),
    )
    now, until = crossing_ns - 2_000_000, crossing_ns + 2_000_000
    timing = everyone(400, -1, -1)
    for offset_ns, seen in ((-100, False), (100, True)):
        copy = Plant(spec(bodies))
        copy.advance(drives, now)
        timing.reads_ns[next_cell] = crossing_ns + offset_ns
        sense, _ = copy.advance(drives, until, timing)
        assert sense.presence[next_cell, 0] == seen
        later, _ = copy.advance(drives, until + 1, everyone(400, -1, -1))
        assert np.array_equal(later.presence, sense.presence)
        last, _ = copy.advance(drives, until + 2)
        assert last.presence[next_cell, 0]


@pytest.mark.parametrize("loaded", [False, True], ids=["touching", "loaded"])
def test_timing_goes_with_effects_that_act_on_all_parcels_at_once(loaded: bool) -> None:
    """Against dividing by hand: parcels that push each other, and wheels that they slow."""
    effects = {"motors": MOTORS.model_dump(exclude_defaults=True)}
    effects |= {"wheel_load": {"inertia_kg": 0.3}} if loaded else {"parcel_contact": {"step_s": 1e-4}}
    bodies = [
        parcel(position_m=(x, 0.01 * x), velocity_m_s=(-2.0 * x, 0.0), angle_rad=0.0) for x in (-0.29, 0.26)
    ]
    scene = PlantSpec.model_validate(
        dict(spec(*bodies))
        | {"effects": effects, "solver": {"name": "implicit", "tolerance": 1e-10}, "friction": VISCOUS}
    )
    timed, divided = Plant(scene), Plant(scene)
    n, until = len(timed.array), 30_000_000
    drives = -10.0 * timed.array.positions_m
    cells = np.arange(n)
    acts, reads = 8_000_000 * (cells % 2), np.where(cells % 3, 17_000_000, until)
    sense, events = timed.advance(drives, until, Timing(acts, reads))
    other_events = divided.advance(np.where(acts[:, None] > 0, 0.0, drives), 8_000_000)[1]
    middle, more = divided.advance(drives, 17_000_000)
    end, most = divided.advance(drives, until)
    assert timed.state == pytest.approx(divided.state, abs=1e-9)
    assert timed.wheel_speed == pytest.approx(divided.wheel_speed, abs=1e-9)
    expected = np.where((cells % 3 > 0)[:, None], middle.encoder_m, end.encoder_m)
    assert sense.encoder_m == pytest.approx(expected, abs=1e-10)
    # overlaps are looked for at the ends of calls only
    other_events, by_hand = (
        [(event.kind, event.parcel) for event in listed if event.kind != "overlap"]
        for listed in (events, other_events + more + most)
    )
    assert other_events == by_hand
    assert by_hand


@pytest.mark.parametrize(
    ("acts", "reads", "rule"),
    [
        (TICK_NS, -1, "must be -1 or in 0..4095999"),
        (-2, -1, "must be -1 or in 0..4095999"),
        (0, -2, "must be -1 or in 0..4096000"),
        (0, TICK_NS + 1, "must be -1 or in 0..4096000"),
    ],
)
def test_instants_outside_the_call_are_refused(acts: int, reads: int, rule: str) -> None:
    plant = Plant(spec(parcel()))
    with pytest.raises(PlantError, match=rule):
        plant.advance(np.zeros((400, 2)), TICK_NS, everyone(400, acts, reads))
    with pytest.raises(PlantError, match="the array has 400 cells"):
        plant.advance(np.zeros((400, 2)), TICK_NS, everyone(399, -1, -1))


def test_drives_that_stay_what_they_are_divide_nothing() -> None:
    plain, timed = (Plant(spec(parcel())) for _ in range(2))
    drives, draw = elliptic(plain), np.random.default_rng(2)
    for tick in range(1, 20):
        acts: NDArray[np.int64] = draw.integers((tick - 1) * TICK_NS, tick * TICK_NS, 400)
        plain.advance(drives, tick * TICK_NS)
        timed.advance(
            drives, tick * TICK_NS, Timing(acts if tick > 1 else np.full(400, -1), np.full(400, -1))
        )
    assert plain.state.tobytes() == timed.state.tobytes()
    assert plain.effort == timed.effort


def test_a_parcel_that_tips_within_the_call_is_read_where_it_tipped() -> None:
    """Carried off the right edge, reported once: who reads later, in this call or the next, sees it where it lies."""
    body = parcel(size_m=(0.54, 0.32), position_m=(0.9, 0.0), angle_rad=0.0, velocity_m_s=(1.0, 0.0))
    timed, divided = (Plant(spec(body)) for _ in range(2))
    n, until, draw = 400, 200_000_000, np.random.default_rng(1)
    drives, acts = draw.uniform(0.5, 1.0, size=(n, 2)), draw.integers(0, until, n)
    drives[:, 1] = 0.0
    sense, events = timed.advance(drives, until, Timing(acts, np.full(n, until - 1)))
    tips = []
    for instant in [*np.unique(acts[acts > 0]).tolist(), until]:
        seen, other_events = divided.advance(np.where((acts < instant)[:, None], drives, 0.0), instant)
        tips += [event for event in other_events if event.kind == "off_array"]
    (tip,) = (event for event in events if event.kind == "off_array")
    assert tip.time_s == pytest.approx(tips[0].time_s, abs=1e-11)
    assert 0.01 < tip.time_s < 0.19
    assert timed.state == pytest.approx(divided.state, abs=1e-11)
    late, _ = timed.advance(-drives, until + 1_000, Timing(np.full(n, until + 100), np.full(n, until + 500)))
    assert seen.presence.any()
    assert np.array_equal(sense.presence, seen.presence)
    assert np.array_equal(late.presence, seen.presence)


@pytest.mark.parametrize("solver", ["exact", "implicit"])
def test_cells_without_parcels_read_their_own_wheels_alone(solver: str) -> None:
    scene = PlantSpec.model_validate(
        dict(spec(rows=2, columns=2, motors=MOTORS)) | {"solver": {"name": solver}}
    )
    plant = Plant(scene)
    reads = TICK_NS * np.array([1, 2, 3, 4]) // 4
    drives = np.full((4, 2), 10.0)
    sense, events = plant.advance(drives, TICK_NS, Timing(np.full(4, 1_000_000), reads))
    turned = np.maximum(reads * 1e-9 - 1e-3, 0.0)
    expected = turned + TAU * np.expm1(-turned / TAU)
    assert sense.encoder_m == pytest.approx(np.repeat(expected[:, None], 2, axis=1), abs=1e-15)
    assert not sense.presence.any()
    assert events == []


def test_what_timing_needs_is_compiled_before_and_changes_nothing() -> None:
    from plant.kernels.exact import entry

    def end(ready: bool) -> bytes:
        plant = solved({"name": "exact"}, parcel())
        if ready:
            before = plant.state.tobytes()
            plant.warm_up()
            assert (plant.state.tobytes(), plant.time_ns, plant.support_changes) == (before, 0, 0)
            assert entry.advance_segmented.signatures
        drives = elliptic(plant)
        for tick in range(1, 60):
            plant.advance(
                drives * (1 + tick % 3),
                tick * TICK_NS,
                everyone(len(drives), (tick - 1) * TICK_NS + 7, tick * TICK_NS),
            )
        return plant.state.tobytes()

    assert end(ready=True) == end(ready=False)
