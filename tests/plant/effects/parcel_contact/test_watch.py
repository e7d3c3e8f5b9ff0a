"""Contacts reported only: none stepped over, reported to the nanosecond, and the motion what it is without them."""

from __future__ import annotations

import numpy as np
import pytest

from plant.errors import PlantError
from plant.plant import Plant
from plant.specs import PlantSpec
from tests.plant.effects.parcel_contact.benches import BOX, box, plant, run, still
from tests.plant.scenes import MU, SECOND, TICK_NS, elliptic, spec


def _contacts(plant: Plant, until_s: float, sample_ns: int) -> list[tuple[str, float, str]]:
    """Kind, time and partner, of one long call."""
    trajectory = plant.trajectory(still(plant), round(until_s * SECOND), sample_ns)
    return [
        (event.kind, event.time_s, event.detail.split(",")[0])
        for event in trajectory.events
        if event.kind in ("contact", "apart", "overlap")
    ]


@pytest.mark.parametrize("depth", [1e-2, 1e-5, 1e-7])
def test_a_corner_that_clips_another_for_a_moment_is_found_in_one_long_call(depth: float) -> None:
    # two diamonds pass, their corners reaching depth into each other for 2 depth / speed
    half, speed = BOX * np.sqrt(0.5), 0.5
    moving = box(-0.5, 2.0 * half - depth, np.pi / 4, velocity_m_s=(speed, 0.0))
    bench = plant(moving, box(0.0, 0.0, np.pi / 4), mode="report_only")
    contacts = _contacts(bench, 2.0, 2 * SECOND)
    assert [(kind, who) for kind, _, who in contacts] == [
        ("contact", "with parcel 1"),
        ("apart", "with parcel 1"),
    ]
    assert contacts[0][1] == pytest.approx((0.5 - depth) / speed, abs=3e-9)
    assert contacts[1][1] == pytest.approx((0.5 + depth) / speed, abs=2e-8)


def test_corners_that_miss_by_a_hair_do_not_touch() -> None:
    half = BOX * np.sqrt(0.5)
    moving = box(-0.5, 2.0 * half + 1e-8, np.pi / 4, velocity_m_s=(0.5, 0.0))
    assert _contacts(plant(moving, box(0.0, 0.0, np.pi / 4), mode="report_only"), 2.0, 2 * SECOND) == []


def test_a_contact_has_pair_place_normal_and_speed() -> None:
    bench = plant(
        box(-0.4, 0.0, velocity_m_s=(0.5, 0.0)),
        box(0.2, 0.02),
        mode="report_only",
        rails=(((0.5, -1.0), (0.5, 1.0)),),
    )
    events = run(bench, still(bench), 1.0)
    assert [event.kind for event in events] == ["contact"]
    first = events[0]
    assert first.time_s == pytest.approx(0.7, abs=3e-9)
    assert first.position_m == pytest.approx((0.075, 0.01), abs=1e-8)
    assert first.parcel == 0
    assert first.detail == "with parcel 1, normal [1, 0], closing at 0.5 m/s"


def test_a_rail_is_met_too_and_by_its_number() -> None:
    rails = (((-1.0, -0.9), (-0.9, -0.9), (-0.9, -0.8)), ((-0.5, 0.3), (1.0, 0.3)))
    bench = plant(box(-0.2, 0.0, velocity_m_s=(0.0, 0.25)), mode="report_only", rails=rails)
    events = run(bench, still(bench), 1.0)
    assert [event.detail.split(",")[0] for event in events] == ["with rail 1"]
    assert events[0].time_s == pytest.approx(0.7, abs=5e-9)


def test_ticks_and_one_long_call_report_the_same_contacts() -> None:
    parcels = (box(-0.4, 0.1), box(0.45, 0.0), box(0.1, -0.5))
    ticked = plant(*parcels, mode="report_only", mu=MU)
    whole = plant(*parcels, mode="report_only", mu=MU)
    drives = elliptic(ticked, -0.6, -0.9)
    one = run(ticked, drives, 900 * TICK_NS / SECOND)
    other = [
        event
        for event in whole.trajectory(drives, 900 * TICK_NS, TICK_NS).events
        if event.kind in ("contact", "apart")
    ]
    assert len(one) >= 2
    assert [event.kind for event in one] == [event.kind for event in other]
    assert [event.time_s for event in one] == pytest.approx([event.time_s for event in other], abs=5e-9)


@pytest.mark.parametrize("implicit", [None, 2e-3])
def test_the_motion_is_that_without_the_effect_bit_for_bit(implicit: float | None) -> None:
    parcels = (box(-0.4, 0.1), box(0.45, 0.0), box(0.1, -0.5))
    watched = plant(
        *parcels, mode="report_only", mu=MU, implicit=implicit, rails=(((-0.3, -0.3), (0.3, -0.3)),)
    )
    values = dict(spec(*parcels, mu=MU))
    if implicit is not None:
        values["solver"] = {"name": "implicit", "step_s": implicit}
    alone = Plant(PlantSpec.model_validate(values))
    drives = elliptic(alone, -0.6, -0.9)
    events = run(watched, drives, 300 * TICK_NS / SECOND)
    for _ in range(300):
        alone.advance(drives, alone.time_ns + TICK_NS)
    assert len(events) >= 1
    assert watched.state.tobytes() == alone.state.tobytes()
    assert watched.support_changes == alone.support_changes
    samples = [
        one.trajectory(drives, one.time_ns + 100 * TICK_NS, TICK_NS).state.tobytes()
        for one in (watched, alone)
    ]
    assert samples[0] == samples[1]


def test_a_parcel_that_starts_across_a_rail_is_refused_by_name_and_depth() -> None:
    with pytest.raises(
        PlantError,
        match=r"parcels\[0\] and effects\.parcel_contact\.rails\[1\] overlap at the start by 0\.02",
    ):
        plant(box(0.0, 0.0), rails=(((-1.0, 0.9), (1.0, 0.9)), ((-1.0, 0.105), (1.0, 0.105))))


def test_parcels_that_start_side_by_side_touch_from_the_start() -> None:
    bench = plant(box(0.0, 0.0), box(BOX, 0.0), mode="report_only")
    events = run(bench, still(bench), 0.1)
    assert [(event.kind, event.time_s) for event in events] == [("contact", 0.0)]
