"""What a recording's parts must be before anybody uses them."""

from __future__ import annotations

from typing import Any

import pytest

from deploy.recordings.checks import check_end, check_faults, check_header, check_records, check_traffic

HEADER: dict[str, Any] = {
    "run": "one",
    "title": "",
    "scene_name": "heat",
    "scene": {"effects": {"parcel_contact": {"rails": [[[0.0, 1.0], [2.0, 3.0]]]}}},
    "period_ns": 1,
    "pitch_m": 0.1,
    "cells": [[0, 0], [0, 1]],
    "positions_m": [[0.0, 0.0], [0.1, 0.0]],
    "sensors_m": [[0.0, 0.0]],
    "footprints_m": [[[0.0, 0.0]]],
    "exits": [{"name": "out", "corners_m": [[0.0, 0.0]]}],
}


def test_a_header_is_taken_as_it_is() -> None:
    assert check_header(HEADER) is HEADER


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"period_ns": 1.0}, "the header: period_ns: "),
        ({"cells": [[0, 0], [0]]}, r"the header: cells\.1: "),
        ({"positions_m": [[0.0, 0.0, 0.0]] * 2}, r"the header: positions_m\.0: "),
        ({"cells": [[0, 0]]}, "must have a position for each cell"),
        ({"own_parcels": -1}, "the header: own_parcels: "),
        ({"exits": [{"name": "out"}]}, r"the header: exits\.0\.corners_m: "),
        ({"scene": {"effects": {"parcel_contact": {"rails": [[0.0]]}}}}, "the header: scene.effects"),
    ],
)
def test_a_header_that_is_not_what_it_must_be_is_refused_by_field(
    change: dict[str, Any], problem: str
) -> None:
    with pytest.raises(ValueError, match=problem):
        check_header({**HEADER, **change})
    with pytest.raises(ValueError, match=r"^the header: Input"):
        check_header([])


@pytest.mark.parametrize("record", [{"kind": "fed"}, {"time_s": "1", "kind": "fed"}, {"time_s": 1.0}, [], 3])
def test_an_event_has_a_time_and_a_kind(record: object) -> None:
    assert check_records([{"time_s": 1.0, "kind": "fed"}]) == [{"time_s": 1.0, "kind": "fed"}]
    with pytest.raises(ValueError, match=r"^a record: "):
        check_records([{"time_s": 1.0, "kind": "fed"}, record])


@pytest.mark.parametrize(
    "fault",
    [
        {"phase": "begins"},
        {"phase": "melts", "cells": []},
        {"phase": "ends", "cells": [[1]]},
        {"cell": [1, 2, 3]},
        {"cell": "1,2"},
    ],
)
def test_a_fault_names_its_affected_cells(fault: dict[str, Any]) -> None:
    head = {"time_s": 1.0, "kind": "crash"}
    for good in ({"phase": "begins", "cells": [[1, 2]]}, {"cell": [1, 2]}, {"cell": None}, {}):
        assert check_faults([{**head, **good}]) == [{**head, **good}]
    with pytest.raises(ValueError, match=r"^a fault: "):
        check_faults([{**head, **fault}])
    for nothing in ("phase", 3):
        with pytest.raises(ValueError, match=r"^a fault: Input"):
            check_faults([nothing])


@pytest.mark.parametrize("parcel", [None, -1, 2, True, 1.0, "0"])
def test_whatever_comes_or_leaves_is_one_of_the_parcels(parcel: object) -> None:
    check_traffic([{"kind": "fed", "parcel": 0}, {"kind": "left", "parcel": 1}, {"kind": "tipped"}], 2)
    for kind in ("fed", "left"):
        with pytest.raises(ValueError, match=f"an event {kind} must name one of 2 parcels"):
            check_traffic([{"kind": kind, "parcel": parcel}], 2)


def test_an_end_has_a_status_and_perhaps_a_digest() -> None:
    end = check_end({"status": "ok", "digest": None})
    assert (end.status, end.digest, end.motion_digest) == ("ok", None, None)
    for end in ({"status": "ok"}, {"status": 1, "digest": "a"}, {"status": "ok", "digest": 1}):
        with pytest.raises(ValueError, match=r"^the end: "):
            check_end(end)
