"""What a success is, what the error, what the time."""

from __future__ import annotations

from dataclasses import replace

import pytest

from deploy.studies.campaign.criterion import Criterion
from deploy.studies.campaign.result import CaseRecord, ParcelEnd, evaluate

CORNERS = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0))
REST = ParcelEnd("at_rest", 2.0, (0.5, 0.4), CORNERS)
MOVES = replace(REST, state="moving", time_s=0.0)
GONE = ParcelEnd("delivered", 5.0, (0.5, 0.4), CORNERS)
ANY = Criterion()
WAITS = replace(REST, state="waiting", time_s=0.0)


def ending(*parcels: ParcelEnd, **more: object) -> CaseRecord:
    return replace(CaseRecord(status="ok", parcels=parcels, digest="d"), **more)


@pytest.mark.parametrize(
    ("here", "there", "why"),
    [
        (REST, REST, ""),
        (GONE, REST, ""),
        (MOVES, MOVES, ""),
        (REST, MOVES, ""),
        (WAITS, MOVES, ""),
        (MOVES, REST, "parcel 0 is moving"),
        (WAITS, REST, "parcel 0 is waiting"),
        (REST, GONE, "parcel 0 has not left"),
        (MOVES, GONE, "parcel 0 has not left"),
        (replace(REST, state="tipped"), MOVES, "parcel 0 tipped"),
        (replace(REST, state="off_array"), REST, "parcel 0 fell off the array"),
    ],
)
def test_a_run_succeeds_whose_parcels_stand_and_come_to_what_they_come_to_undisturbed(
    here: ParcelEnd, there: ParcelEnd, why: str
) -> None:
    outcome = evaluate(ending(here), ending(there), ANY)
    assert (outcome.succeeded, outcome.reason, outcome.status) == (not why, why, "ok")


def test_a_misrouted_parcel_is_no_success() -> None:
    outcome = evaluate(ending(GONE, misrouted=1), ending(GONE), ANY)
    assert (outcome.succeeded, outcome.reason) == (False, "1 misrouted")


def test_without_an_undisturbed_run_only_falls_and_wrong_exits_count_and_there_is_no_error() -> None:
    outcome = evaluate(ending(MOVES), None, Criterion(within_m=0.1, compared=False))
    assert outcome.succeeded
    assert outcome.error_m is None
    assert not evaluate(ending(replace(REST, state="tipped")), None, ANY).succeeded


def test_the_error_is_the_farthest_corner_of_parcels_that_are_there_in_both() -> None:
    moved = replace(REST, corners_m=((0.0, 0.0), (1.0, 0.0), (1.3, 1.4)))
    assert evaluate(ending(REST, moved), ending(REST, REST), ANY).error_m == pytest.approx(0.5)
    assert evaluate(ending(GONE), ending(REST), ANY).error_m is None
    assert evaluate(ending(replace(moved, state="tipped")), ending(REST), ANY).error_m == pytest.approx(0.5)


def test_within_makes_a_success_of_no_run_that_ends_farther_off() -> None:
    moved = replace(REST, corners_m=((0.0, 0.0), (1.0, 0.0), (1.3, 1.4)))
    assert evaluate(ending(moved), ending(REST), Criterion(within_m=0.6)).succeeded
    outcome = evaluate(ending(moved), ending(REST), Criterion(within_m=0.4))
    assert (outcome.succeeded, outcome.reason) == (False, "0.5 m from where the baseline run ends")


def test_without_an_undisturbed_run_the_error_is_the_distance_from_the_goals_place() -> None:
    near = Criterion(within_m=0.6, place_m=(0.1, 0.1), compared=False)
    far = replace(REST, place_m=(0.1, -0.6))
    outcome = evaluate(ending(REST, far, GONE, WAITS), None, near)
    assert (outcome.succeeded, outcome.error_m) == (False, pytest.approx(0.7))
    assert outcome.reason == "0.7 m from (0.1, 0.1) m"
    assert evaluate(ending(REST, GONE), None, near).succeeded
    assert evaluate(ending(REST, far), ending(REST, REST), near).error_m == 0.0


def test_a_goal_may_demand_rest_and_delivery() -> None:
    rest, delivery = Criterion(at_rest=True), Criterion(delivered=True)
    assert evaluate(ending(REST, GONE), ending(MOVES, MOVES), rest).succeeded
    assert evaluate(ending(MOVES), ending(MOVES), rest).reason == "parcel 0 is moving"
    assert evaluate(ending(GONE, WAITS), ending(MOVES, MOVES), delivery).succeeded
    assert evaluate(ending(GONE, REST), None, delivery).reason == "parcel 1 is at_rest, not delivered"


def test_the_time_is_that_of_the_last_to_rest_or_leave_and_there_is_none_until_all_have() -> None:
    assert evaluate(ending(REST, GONE), None, ANY).time_s == 5.0
    assert evaluate(ending(REST, MOVES), None, ANY).time_s is None
    assert evaluate(ending(replace(REST, state="tipped")), None, ANY).time_s is None
    assert evaluate(ending(), None, ANY).time_s is None


def test_a_run_that_ended_early_is_stored_with_its_reason_and_nothing_measured() -> None:
    outcome = evaluate(CaseRecord(status="unstable", reason="why", wall_s=2.0), ending(REST), ANY)
    assert (outcome.status, outcome.reason, outcome.wall_s) == ("unstable", "why", 2.0)
    assert (outcome.succeeded, outcome.error_m, outcome.time_s, outcome.digest) == (False, None, None, None)


def test_a_run_without_its_undisturbed_one_fails_and_says_why_that_did() -> None:
    outcome = evaluate(ending(REST), CaseRecord(status="failed", reason="why"), ANY)
    assert (outcome.status, outcome.reason) == ("failed", "the baseline run: failed: why")
