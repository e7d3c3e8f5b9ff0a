"""Parcels that are fed and leave: when, where, in which order, and that nobody notices them before and after."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.stats import kstest

from plant.effects.feeders.spec import FeedersSpec, FeedSpec
from plant.effects.registry import PlantEffects
from plant.errors import PlantError
from plant.friction.coulomb import Coulomb
from plant.observations import Event
from plant.parcel_spec import ParcelSpec
from plant.plant import Plant
from plant.solver_specs import ImplicitSpec
from plant.specs import PlantSpec
from tests.plant.scenes import SECOND, TICK_NS, Floats, spec, turned

ARRAY = {"rows": 8, "columns": 20}
EAST = {"name": "east", "size_m": (0.2, 0.8), "position_m": (0.85, 0.0)}
BOX = {"size_m": (0.25, 0.25), "mass_kg": 1.0}


def feed(**values: Any) -> dict[str, Any]:
    return {"name": "west", "position_m": (-0.7, 0.0), **BOX, **values}


def fed_plant(
    *feeds: dict[str, Any],
    exits: tuple[dict[str, Any], ...] = (EAST,),
    own: tuple[Any, ...] = (),
    seed: int = 1,
) -> PlantSpec:
    """A plant on a belt of 8 x 20 cells with the parcels ``own`` and these feeders."""
    effects = PlantEffects(feeders=FeedersSpec.model_validate({"feed": feeds, "exits": exits}))
    return PlantSpec.model_validate(dict(spec(*own, **ARRAY)) | {"effects": effects, "seed": seed})


def own(**values: Any) -> ParcelSpec:
    return ParcelSpec.model_validate({"position_m": (-0.7, 0.0), **BOX, **values})


def eastward(plant: Plant, speed_m_s: float = 0.3) -> Floats:
    return np.full((len(plant.array), 2), (speed_m_s, 0.0))


def ticks(plant: Plant, drives: Floats, count: int) -> list[Event]:
    """Advance tick by tick; the events of traffic."""
    found: list[Event] = []
    for _ in range(count):
        found += plant.advance(drives, plant.time_ns + TICK_NS)[1]
    return [event for event in found if event.kind in ("fed", "held_back", "left")]


def times_of(events: list[Event], kind: str) -> list[tuple[int, int]]:
    """Parcel and time, ns, of the events of a kind."""
    return [(event.parcel, round(event.time_s * 1e9)) for event in events if event.kind == kind]


# --- the schedule -----------------------------------------------------------------------------------


def test_a_parcel_is_fed_at_the_first_tick_that_does_not_begin_before_its_time() -> None:
    on_tick, past, at_start = 0.004096, 0.0040960001, 0.0
    places = [(-0.7, -0.2), (-0.7, 0.2), (0.0, 0.0)]
    plant = Plant(
        fed_plant(
            *(
                feed(name=f"f{i}", times_s=[time_s], position_m=place)
                for i, (time_s, place) in enumerate(zip((on_tick, past, at_start), places, strict=True))
            )
        )
    )
    events = ticks(plant, eastward(plant), 3)
    assert sorted(times_of(events, "fed")) == [(0, TICK_NS), (1, 2 * TICK_NS), (2, 0)]


def test_times_a_whole_number_of_ticks_apart_never_gain_or_lose_one() -> None:
    every = FeedSpec.model_validate(feed(every_s=0.012288, first_s=0.004096, count=10_000))
    assert every.due_ns(0) == [TICK_NS * (1 + 3 * number) for number in range(10_000)]


def test_a_schedule_is_the_written_decimals_rounded_up_to_nanoseconds() -> None:
    every = FeedSpec.model_validate(feed(every_s=0.1000000001, first_s=0.7, count=1000))
    exact = [Fraction(7, 10) + number * Fraction(1000000001, 10**10) for number in range(1000)]
    assert all(0 <= due - time_s * 10**9 < 1 for due, time_s in zip(every.due_ns(0), exact, strict=True))


def test_random_gaps_are_exponential_with_the_requested_mean() -> None:
    random = FeedSpec.model_validate(feed(mean_s=2.5, first_s=4.0, count=10_000))
    gaps = np.concatenate([np.diff([4 * SECOND, *random.due_ns(seed)]) for seed in range(5)]) * 1e-9
    assert gaps.min() >= 0.0
    assert kstest(gaps, "expon", args=(0.0, 2.5)).pvalue > 0.01


def test_spreads_are_uniform_and_fill_the_requested_range() -> None:
    spread = feed(every_s=1.0, count=4000, position_spread_m=(0.1, 0.3), angle_rad=0.2, angle_spread_rad=0.7)
    parcels = list(FeedSpec.model_validate(spread).parcels(7))
    off = np.array([(*parcel.position_m, parcel.angle_rad) for parcel in parcels]) - (-0.7, 0.0, 0.2)
    for column, reach in enumerate((0.1, 0.3, 0.7)):
        assert kstest(off[:, column], "uniform", args=(-reach, 2.0 * reach)).pvalue > 0.01


def test_the_seed_decides_and_nothing_else_does() -> None:
    random = feed(mean_s=1.0, count=50, angle_spread_rad=1.0)
    west = FeedSpec.model_validate(random)
    assert (west.due_ns(1), list(west.parcels(1))) == (west.due_ns(1), list(west.parcels(1)))
    assert west.due_ns(1) != west.due_ns(2)
    assert list(west.parcels(1)) != list(west.parcels(2))
    elsewhere = FeedSpec.model_validate(random | {"name": "north"})
    assert west.due_ns(1) != elsewhere.due_ns(1)
    assert list(west.parcels(1)) != list(elsewhere.parcels(1))
    narrower = FeedSpec.model_validate(random | {"angle_spread_rad": 0.0})
    assert narrower.due_ns(1) == west.due_ns(1)
    both = FeedersSpec(feed=(elsewhere, west))
    assert both.parcels(1)[50:] == tuple(west.parcels(1))


# --- before and after -------------------------------------------------------------------------------


@pytest.mark.parametrize("solver", [None, ImplicitSpec(name="implicit", step_s=0.002)])
def test_a_fed_parcel_moves_bit_for_bit_as_one_that_started_then(solver: ImplicitSpec | None) -> None:
    pose = {"angle_rad": 0.4, "velocity_m_s": (0.1, -0.05), "angular_velocity_rad_s": 0.3}
    later, now = fed_plant(feed(times_s=[0.1], **pose)), spec(own(**pose), **ARRAY)
    if solver is not None:
        swap = {"solver": solver, "friction": Coulomb(law="coulomb", coefficient=0.3)}
        later, now = (PlantSpec.model_validate(dict(one) | swap) for one in (later, now))
    fed, plain = Plant(later), Plant(now)
    drives = eastward(fed) * np.linspace(0.5, 1.0, len(fed.array))[:, None]
    ticks(fed, drives, 25)
    assert fed.state[0].tolist() == plain.state[0].tolist()
    for _ in range(200):
        ticks(fed, drives, 1)
        ticks(plain, drives, 1)
        assert fed.state[0].tolist() == plain.state[0].tolist()


def test_who_waits_stands_still_where_it_will_appear_and_is_noticed_by_nobody() -> None:
    waits = feed(times_s=[5.0], position_m=(0.0, 0.0), velocity_m_s=(0.5, 0.0))
    crossed, alone = Plant(fed_plant(waits, own=(own(),))), Plant(spec(own(), **ARRAY))
    for _ in range(1100):
        sense, events = crossed.advance(eastward(crossed), crossed.time_ns + TICK_NS)
        expected, others = alone.advance(eastward(alone), alone.time_ns + TICK_NS)
        assert events == others
        assert np.array_equal(sense.presence, expected.presence)
    assert crossed.state[0, 0] > 0.3
    assert crossed.state[0].tolist() == alone.state[0].tolist()
    assert crossed.state[1].tolist() == [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    assert (crossed.status[1].state, crossed.status[1].detail) == ("waiting", "for feeder west")


def test_a_parcel_leaves_at_the_first_tick_with_its_centre_in_an_exit() -> None:
    slanting = {"name": "gap", "vertices_m": [(0.3, -0.4), (0.9, -0.4), (0.9, 0.4), (0.6, 0.4)]}
    plant, free = (Plant(fed_plant(exits=exits, own=(own(angle_rad=0.3),))) for exits in ((slanting,), ()))
    path = free.trajectory(eastward(free), 6 * SECOND, TICK_NS)
    # the slanting side runs from (0.3, -0.4) to (0.6, 0.4): what is right of it is in
    right = 0.8 * (path.state[:, 0, 0] - 0.3) - 0.3 * (path.state[:, 0, 1] + 0.4) >= 0.0
    first = int(np.argmax(right))
    events = ticks(plant, eastward(plant), first - 1)
    assert events == []
    assert plant.sense().presence.any()
    (left,) = ticks(plant, eastward(plant), 1)
    assert (left.kind, left.time_s, left.parcel) == ("left", first * TICK_NS * 1e-9, 0)
    assert left.position_m == tuple(path.state[first, 0, :2])
    assert plant.status[0].state == "delivered"
    assert plant.status[0].detail == "through exit gap"
    assert not plant.sense().presence.any()
    assert ticks(plant, eastward(plant), 5) == []
    assert plant.state[0].tolist() == [*path.state[first, 0, :3], 0.0, 0.0, 0.0]


def test_an_exit_may_be_turned_and_its_boundary_is_in() -> None:
    on_end = {"name": "e", "size_m": (0.4, 0.1), "position_m": (0.5, 0.1), "angle_rad": np.pi / 2}
    straight = {"name": "e", "size_m": (0.5, 0.5), "position_m": (0.5, 0.0)}
    refused = r"parcels\[0\].position_m = .*: lies in exit e: the parcel would leave at once"
    for exit_, inside, outside in (
        (on_end, (0.46, 0.29), (0.6, 0.1)),
        (straight, (0.25, 0.0), (float(np.nextafter(0.25, 0.0)), 0.0)),
    ):
        with pytest.raises(PlantError, match=refused):
            Plant(fed_plant(exits=(exit_,), own=(own(position_m=inside),)))
        assert Plant(fed_plant(exits=(exit_,), own=(own(position_m=outside),))).status[0].state == "moving"


# --- the queue --------------------------------------------------------------------------------------


def _clear(plant: Plant, i: int, j: int) -> bool:
    """Whether two parcels lie apart, by the sides of either (an independent statement of `plant.geometry.overlap`)."""
    one, other = (turned(plant.footprints_m[k], plant.state[k, 2]) + plant.state[k, :2] for k in (i, j))
    for a, b in ((one, other), (other, one)):
        for corner, after in zip(a, np.roll(a, -1, axis=0), strict=True):
            side, to = after - corner, b - corner
            if np.all(side[0] * to[:, 1] - side[1] * to[:, 0] <= 0.0):
                return True
    return False


def test_who_finds_no_room_is_fed_in_order_at_the_first_tick_that_has_room() -> None:
    plant = Plant(fed_plant(feed(every_s=0.2, count=5, angle_spread_rad=0.6)))
    inside: list[int] = []
    events: list[Event] = []
    for tick in range(1500):
        new = ticks(plant, eastward(plant), 1)
        events += new
        fed = [parcel for parcel, _ in times_of(new, "fed")]
        due = [i for i in range(5) if round(i * 0.2 * 1e9) <= plant.time_ns]
        waiting = [i for i in due if i not in inside and i not in fed]
        inside += fed
        if waiting:  # whoever comes next is kept out by somebody
            assert not all(_clear(plant, waiting[0], other) for other in inside), tick
    assert inside == [0, 1, 2, 3, 4]
    times = dict(times_of(events, "fed"))
    assert [times[i] for i in sorted(times)] == sorted(times.values())
    held = dict(times_of(events, "held_back"))
    assert held == {i: -(-i * SECOND // 5 // TICK_NS) * TICK_NS for i in range(1, 5)}
    (count,) = plant.traffic().feed  # type: ignore[union-attr]
    assert (count.fed, count.waiting, count.held_back) == (5, 0, 4)
    assert count.longest_hold_s == pytest.approx(max(times[i] - held[i] for i in held) * 1e-9, abs=1e-12)


def test_who_needs_more_room_waits_until_every_other_s_centre_of_mass_is_so_far_away() -> None:
    plant = Plant(fed_plant(feed(every_s=0.2, count=3, clear_m=0.6)))
    for _ in range(1500):
        before = plant.state[:, :2].copy()
        for parcel, _ in times_of(ticks(plant, eastward(plant), 1), "fed"):
            gone = [i for i in range(parcel) if plant.status[i].rides]
            apart = [float(np.hypot(*(plant.state[i, :2] - (-0.7, 0.0)))) for i in gone]
            almost = [float(np.hypot(*(before[i] - (-0.7, 0.0)))) for i in gone]
            assert all(distance >= 0.6 for distance in apart)
            assert parcel == 0 or min(almost) < 0.6
    assert plant.traffic().feed[0].fed == 3  # type: ignore[union-attr]


def test_who_leaves_makes_room_at_the_same_tick() -> None:
    # the first parcel leaves while it still covers the place where the second is due
    near = {"name": "near", "size_m": (0.2, 0.8), "position_m": (-0.5, 0.0)}
    plant = Plant(fed_plant(feed(times_s=[0.0, 0.1]), exits=(near,)))
    events = ticks(plant, eastward(plant), 400)
    left, fed = dict(times_of(events, "left")), dict(times_of(events, "fed"))
    assert plant.state[0, 0] < -0.7 + 0.25
    assert fed[1] == left[0] > round(0.1 * SECOND)


def test_feeders_and_exits_that_share_a_place_take_turns_in_the_order_of_the_scene() -> None:
    everywhere = {"name": "all", "size_m": (2.0, 0.8), "position_m": (0.6, 0.0)}
    feeds = (feed(name="b", times_s=[0.5]), feed(name="a", times_s=[0.5]))
    plant = Plant(fed_plant(*feeds, exits=(everywhere, EAST)))
    events = ticks(plant, eastward(plant), 600)
    assert [parcel for parcel, _ in times_of(events, "fed")] == [0, 1]
    assert [parcel for parcel, _ in times_of(events, "held_back")] == [1]
    count = plant.traffic()
    assert count is not None
    assert [one.left for one in count.exits] == [1, 0]


def test_fed_parcels_that_meet_are_named_in_their_order_whoever_came_first() -> None:
    late, early = feed(name="l", times_s=[0.3]), feed(name="e", times_s=[0.1], position_m=(-0.44, 0.0))
    plant = Plant(fed_plant(late, early))
    drives = eastward(plant)
    drives[plant.array.positions_m[:, 0] > -0.6] = 0.0
    met = [event for _ in range(500) for event in plant.advance(drives, plant.time_ns + TICK_NS)[1]]
    (overlap,) = [event for event in met if event.kind == "overlap"]
    assert (overlap.parcel, overlap.detail[:13]) == (0, "with parcel 1")


def test_a_tipped_parcel_blocks_its_feeder() -> None:
    # the centre of mass runs over the east edge, where nothing lies beyond
    plant = Plant(fed_plant(feed(times_s=[0.5, 1.0], position_m=(0.8, 0.0)), exits=()))
    events = ticks(plant, eastward(plant), 2000)
    assert plant.status[0].state == "off_array"
    assert [event.kind for event in events] == ["fed", "held_back"]
    assert plant.status[1].state == "waiting"
    assert plant.traffic().feed[0].longest_hold_s == pytest.approx(2000 * 0.004096 - 1.003520, abs=1e-9)  # type: ignore[union-attr]


# --- counted, timed, and the same however one looks ---------------------------------------------------

BUSY = [
    feed(mean_s=0.8, count=8, position_spread_m=(0.0, 0.2), angle_spread_rad=0.5),
    feed(name="middle", every_s=1.1, count=4, position_m=(0.0, -0.2), velocity_m_s=(0.2, 0.1)),
]


def test_a_trajectory_in_slices_is_the_same_as_tick_by_tick_bit_for_bit() -> None:
    ticked, sliced = Plant(fed_plant(*BUSY)), Plant(fed_plant(*BUSY))
    drives = eastward(ticked)
    states, found = [ticked.state], []
    for _ in range(2000):
        found += ticked.advance(drives, ticked.time_ns + TICK_NS)[1]
        states.append(ticked.state)
    parts = [sliced.trajectory(drives, until * TICK_NS, TICK_NS) for until in (300, 301, 2000)]
    joined = np.concatenate([parts[0].state, *(part.state[1:] for part in parts[1:])])
    assert np.array_equal(joined, np.array(states))
    assert [event for part in parts for event in part.events] == sorted(found, key=lambda event: event.time_s)
    assert ticked.status == sliced.status
    assert ticked.traffic() == sliced.traffic()
    assert ticked.traffic().left > 3  # type: ignore[union-attr]


@settings(max_examples=15)
@given(
    seed=st.integers(0, 2**40),
    mean_s=st.floats(0.05, 2.0),
    speed=st.floats(0.1, 0.8),
    counts=st.lists(st.integers(1, 200), min_size=1, max_size=12),
)
def test_whoever_was_fed_is_there_or_has_left(
    seed: int, mean_s: float, speed: float, counts: list[int]
) -> None:
    plant = Plant(
        fed_plant(
            feed(mean_s=mean_s, count=10, angle_spread_rad=1.0), own=(own(position_m=(0.3, 0.1)),), seed=seed
        )
    )
    events: list[Event] = []
    for ticked in counts:
        events += ticks(plant, eastward(plant, speed), ticked)
        count = plant.traffic()
        assert count is not None
        states = [status.state for status in plant.status]
        fed, left = dict(times_of(events, "fed")), dict(times_of(events, "left"))
        assert count.feed[0].fed == len(fed)
        assert count.left == len(left) == sum(one.left for one in count.exits)
        assert 1 + len(fed) == count.there + count.left
        assert count.waiting == states.count("waiting") == 10 - len(fed)
        assert set(left) <= {0, *fed}
        spans = [(left[i] - fed.get(i, 0)) * 1e-9 for i in left]
        if spans:
            assert count.transit_s is not None
            assert count.transit_s.shortest == pytest.approx(min(spans), rel=1e-12)
            assert count.transit_s.mean == pytest.approx(np.mean(spans), rel=1e-12)
            assert count.transit_s.longest == pytest.approx(max(spans), rel=1e-12)
            assert count.left_per_s == pytest.approx(len(left) / (plant.time_ns * 1e-9))


def test_each_exit_counts_its_own() -> None:
    north = {"name": "north", "size_m": (2.0, 0.2), "position_m": (0.0, 0.35)}
    up, along = own(position_m=(-0.5, 0.2)), own(position_m=(0.5, -0.2))
    plant = Plant(fed_plant(exits=(north, EAST), own=(up, along)))
    drives = eastward(plant)
    drives[plant.array.positions_m[:, 1] > 0.0] = (0.0, 0.3)
    ticks(plant, drives, 1500)
    count = plant.traffic()
    assert count is not None
    assert [(one.name, one.left) for one in count.exits] == [("north", 1), ("east", 1)]
    assert [plant.status[i].detail for i in (0, 1)] == ["through exit north", "through exit east"]


def test_a_scene_without_feeders_has_no_traffic() -> None:
    assert Plant(spec(own(), **ARRAY)).traffic() is None


# --- bad input --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("values", "rule"),
    [
        ({}, "give times_s, every_s or mean_s, one of the three"),
        ({"every_s": 1.0, "mean_s": 1.0, "count": 2}, "give times_s, every_s or mean_s, one of the three"),
        ({"every_s": 1.0}, "every_s and mean_s need a count"),
        ({"times_s": [1.0], "count": 1}, "leave count and first_s out"),
        ({"times_s": [2.0, 1.0]}, "times_s must ascend"),
    ],
)
def test_a_schedule_that_says_too_little_or_too_much_is_refused(values: dict[str, Any], rule: str) -> None:
    with pytest.raises(ValidationError, match=rule):
        FeedSpec.model_validate(feed(**values))


def test_two_of_one_name_are_refused() -> None:
    with pytest.raises(ValidationError, match='feed has the name "west" twice'):
        FeedersSpec.model_validate({"feed": [feed(times_s=[1.0]), feed(times_s=[2.0])]})
    with pytest.raises(ValidationError, match='exits has the name "east" twice'):
        FeedersSpec.model_validate({"exits": [EAST, EAST]})


@pytest.mark.parametrize(
    ("place", "rule"),
    [
        ((-1.2, 0.0), r"position_m = \[-1.2, 0\]: the parcel stands on nothing"),
        ((-1.0, 0.0), r"position_m = \[-1, 0\]: the parcel would tip"),
        ((0.8, 0.0), r"position_m = \[0.8, 0\]: lies in exit east: the parcel would leave at once"),
    ],
)
def test_a_parcel_that_could_not_stand_or_stay_where_it_is_fed_is_refused_at_the_start(
    place: tuple[float, float], rule: str
) -> None:
    good, bad = feed(times_s=[1.0, 2.0]), feed(name="bad", position_m=place, times_s=[3.0])
    with pytest.raises(PlantError, match=r"effects\.feeders\.feed\[1\]\." + rule):
        Plant(fed_plant(good, bad, own=(own(position_m=(0.3, 0.0)),)))
