"""The outcome of a run, for programs and for people."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from deploy.errors import DeployError
from deploy.runs.summary import Messages, ParcelOutcome, ProtocolMessages, Summary
from deploy.runs.summary_table import print_summary
from plant.observations import ExitCount, FeedCount, TrafficCount, Transit

PROMISED = {
    "status", "scene", "seed", "duration_s", "cells", "processes", "transport", "solver", "ticks", "wall_s",
    "startup_s", "ticks_per_s", "realtime_factor", "parcels", "support_changes", "messages", "faults",
    "cells_lost", "digest", "output",
}  # fmt: skip


def summary(**changes: Any) -> Summary:
    values: dict[str, Any] = {
        "status": "ok",
        "scene": "elliptic",
        "seed": 1,
        "duration_s": 10.0,
        "simulated_s": 10.0,
        "cells": 400,
        "processes": 2,
        "transport": "zenoh",
        "solver": {"name": "exact", "tolerance": 1e-9},
        "ticks": 2442,
        "wall_s": 2.0,
        "startup_s": 0.5,
        "parcels": [ParcelOutcome.of(np.arange(6.0), "at_rest", 7.5)],
        "support_changes": 172,
    }
    return Summary(**(values | changes))


def printed(outcome: Summary, width: int = 100) -> str:
    console = Console(file=io.StringIO(), width=width)
    print_summary(outcome, console)
    return console.file.getvalue()  # type: ignore[attr-defined]


def test_the_json_object_has_every_promised_key() -> None:
    assert set(json.loads(summary().to_json())) >= PROMISED


def test_a_parcel_s_six_numbers_go_where_their_names_say() -> None:
    (parcel,) = json.loads(summary().to_json())["parcels"]
    assert parcel["position_m"] == [0.0, 1.0]
    assert parcel["angle_rad"] == 2.0
    assert parcel["velocity_m_s"] == [3.0, 4.0]
    assert parcel["angular_velocity_rad_s"] == 5.0
    assert (parcel["state"], parcel["time_s"]) == ("at_rest", 7.5)


def test_numbers_keep_all_their_digits() -> None:
    state = np.full(6, 0.1 + 0.2)
    (parcel,) = json.loads(summary(parcels=[ParcelOutcome.of(state, "moving", 0.0)]).to_json())["parcels"]
    assert parcel["angle_rad"] == 0.1 + 0.2


def test_speed_is_counted_without_start_up() -> None:
    outcome = summary().to_dict()
    assert outcome["ticks_per_s"] == 1221.0
    assert outcome["realtime_factor"] == 5.0


def test_an_interrupted_run_is_as_fast_as_what_it_simulated() -> None:
    assert summary(status="interrupted", simulated_s=1.0).realtime_factor == 0.5


def test_a_run_that_took_no_time_has_no_speed() -> None:
    outcome = summary(wall_s=0.0).to_dict()
    assert outcome["ticks_per_s"] is None
    assert outcome["realtime_factor"] is None


def test_a_number_that_is_not_finite_is_null() -> None:
    state = np.array([np.inf, np.nan, 0.0, 0.0, 0.0, 0.0])
    outcome = summary(status="unstable", parcels=[ParcelOutcome.of(state, "moving", 0.0)])
    assert json.loads(outcome.to_json())["parcels"][0]["position_m"] == [None, None]


def test_numpy_values_in_faults_and_cells_become_json() -> None:
    fault = {"kind": "crash", "time_s": np.float64(2.0), "cell": np.array([3, 4])}
    outcome = json.loads(summary(faults=[fault], cells_lost=[(np.int64(3), np.int64(4))]).to_json())
    assert outcome["faults"] == [{"kind": "crash", "time_s": 2.0, "cell": [3, 4]}]
    assert outcome["cells_lost"] == [[3, 4]]


def test_the_file_holds_the_same_object_and_nothing_is_left_beside_it(tmp_path: Path) -> None:
    path = summary().write(tmp_path)
    assert json.loads(path.read_text()) == summary().to_dict()
    assert [entry.name for entry in tmp_path.iterdir()] == ["summary.json"]


def test_a_summary_that_can_t_be_written_is_named_with_the_cause(tmp_path: Path) -> None:
    with pytest.raises(DeployError, match=r"can't write .*summary\.json: No such file"):
        summary().write(tmp_path / "absent")


def test_the_table_says_what_the_cells_ran() -> None:
    heat = {"name": "heat_diffusion", "form": "on arrays", "message_bytes": 16}
    assert "heat_diffusion, on arrays; messages of 16 bytes" in printed(summary(firmware=heat))
    assert "messages of 1 byte " in printed(summary(firmware=heat | {"message_bytes": 1}))
    quiet = {"name": "turn.py", "form": "cell by cell", "message_bytes": 0}
    assert "turn.py, cell by cell; no messages" in printed(summary(firmware=quiet))
    assert "firmware" not in printed(summary())


def test_a_narrow_terminal_gets_a_parcel_s_numbers_in_full() -> None:
    parcels = [ParcelOutcome.of(np.array([0.5, -0.25, 1.0, 0, 0, 0]), "at_rest", 7.5)]
    text = printed(summary(parcels=parcels), width=40)
    assert max(map(len, text.splitlines())) <= 40
    expected = "parcel 0 x 0.500000 m, y -0.250000 m, angle 1.000000 rad; at rest since 7.5000 s"
    assert expected in " ".join(text.split())


def test_the_table_names_lost_cells_faults_and_lost_messages() -> None:
    text = printed(
        summary(
            faults=[{"kind": "crash", "time_s": 2.0, "cell": [3, 4]}],
            cells_lost=[(3, 4)],
            messages=Messages(sent=10, delivered=9, lost=1),
            digest="ab" * 32,
            output="runs/1",
        )
    )
    for words in (
        "3,4 crashed at 2 s",
        "10 sent on the bus, 9 delivered, 1 lost",
        "ab" * 32,
        "runs/1",
        "at rest since",
    ):
        assert words in text


def test_the_table_distinguishes_messages_of_cells_from_frames_of_the_bus() -> None:
    text = printed(
        summary(
            messages=Messages(sent=10, delivered=9, protocol=ProtocolMessages(sent=1_234, received=1_200))
        )
    )
    assert "messages   1,234 sent by cells to neighbours, 1,200 received" in text
    assert "frames     10 sent on the bus, 9 delivered" in text
    assert "messages" not in printed(summary(messages=Messages(sent=10, delivered=9)))


def test_the_table_says_how_many_more_faults_there_are_than_it_names() -> None:
    faults = [{"kind": "failed", "time_s": 2.0 + column, "cell": [3, column]} for column in range(9)]
    assert "3,3 failed at 5 s; and 5 more" in printed(summary(faults=faults))


def test_the_table_says_why_a_run_did_not_end_well() -> None:
    text = printed(summary(status="stalled", reason="cell 3,4 gave no drive for tick 17"))
    assert "stalled" in text
    assert "cell 3,4 gave no drive for tick 17" in text


def test_the_status_is_not_repeated_by_the_reason() -> None:
    text = printed(summary(status="interrupted", reason="interrupted at 2 s of simulated time"))
    assert "interrupted  at 2 s of simulated time" in text


def test_many_parcels_are_counted_by_state() -> None:
    parcels = [ParcelOutcome.of(np.zeros(6), "at_rest" if i % 5 else "tipped", 0.0) for i in range(50)]
    assert "40 at rest, 10 tipped" in printed(summary(parcels=parcels))


TRAFFIC = TrafficCount(
    feed=[FeedCount("west", 14, 2, 8, 1.4786), FeedCount("east", 3, 0, 0, 0.0)],
    exits=[ExitCount("north", 6, 2, Transit(5.36, 5.32, 5.41)), ExitCount("south", 0, 0, None)],
    waiting=2,
    there=11,
    left=6,
    misrouted=2,
    transit_s=Transit(5.36, 5.32, 5.41),
    left_per_s=0.25,
)


def test_what_came_and_went_is_in_the_json_object() -> None:
    found = json.loads(summary(feeders=TRAFFIC).to_json())["feeders"]
    assert found["feed"][0] == {
        "name": "west", "fed": 14, "waiting": 2, "held_back": 8, "longest_hold_s": 1.4786
    }  # fmt: skip
    assert found["exits"][0] == {
        "name": "north", "left": 6, "misrouted": 2,
        "transit_s": {"mean": 5.36, "shortest": 5.32, "longest": 5.41},
    }  # fmt: skip
    assert found["exits"][1]["transit_s"] is None
    assert found["misrouted"] == 2
    assert (found["waiting"], found["there"], found["left"], found["left_per_s"]) == (2, 11, 6, 0.25)
    assert json.loads(summary().to_json())["feeders"] is None


def test_the_table_has_a_line_for_every_feeder_and_exit() -> None:
    lines = [" ".join(line.split()) for line in printed(summary(feeders=TRAFFIC)).splitlines()]
    assert "feeder west 14 fed, 2 waiting; 8 held back, up to 1.48 s" in lines
    assert "feeder east 3 fed, 0 waiting" in lines
    assert "exit north 6 left after 5.36 s (5.32 to 5.41), 2 of them misrouted" in lines
    assert "exit south 0 left" in lines
    assert "throughput 0.25 parcels/s" in lines


def test_the_table_has_a_line_for_what_each_effect_of_the_cells_did() -> None:
    did = {"link_loss.lost": 1234, "sensor.false_negatives": 0, "sensor.false_positives": 7}
    outcome = summary(effects=did)
    lines = [line.strip().split(maxsplit=1) for line in printed(outcome).splitlines()]
    assert ["link_loss", "1,234 lost"] in lines
    assert ["sensor", "0 false negatives, 7 false positives"] in lines
    assert json.loads(outcome.to_json())["effects"] == did


def test_the_table_fits_eighty_columns_without_cutting_or_wrapping_anything() -> None:
    state = np.array([-12.345678, -12.345678, -0.000012, -7.02e-05, 0.0, -6.9e-07])
    moving = ParcelOutcome.of(state, "moving", 0.0)
    outcome = summary(
        digest="ab" * 32, parcels=[moving], wall_s=0.0202, startup_s=12.54, simulated_s=10.0, ticks=1_852_438
    )
    lines = printed(outcome, width=80).splitlines()
    assert all(len(line.rstrip()) <= 80 for line in lines)
    assert "…" not in "".join(lines)
    names = [line.split()[0] for line in lines if line.strip()]
    assert names == ["elliptic", "simulated", "wall", "cells", "solver", "supports", "digest", "parcel", "0"]


def test_what_faults_did_has_a_line_of_its_own_apart_from_which_there_were() -> None:
    text = printed(
        summary(
            effects={"clock.missed": 2, "faults.link_loss.lost": 60_518, "faults.restarts": 1},
            faults=[{"kind": "crash", "time_s": 2.0, "cell": [3, 4]}],
        )
    )
    assert "clock      2 missed" in text
    assert "by faults  link loss lost 60,518, restarts 1" in text
    assert text.count("\nfaults") == 1


def test_each_limit_of_a_trajectory_s_validity_is_a_line() -> None:
    outrun = [{"parcel": 3, "since_s": 0.20387}, {"parcel": 0, "since_s": 0.7}]
    found = summary(law_not_valid=outrun, captured={"capture_m": 1e-6, "parcels": [0, 2]})
    lines = [" ".join(line.split()) for line in printed(found, width=120).splitlines()]
    assert "law not valid since 0.2039 s: parcel 3 outruns a wheel, and 1 parcel later" in lines
    assert (
        "chatter captured: positions of parcels 0, 2 are accurate to 1e-06 m (solver.capture_m), not to the tolerance"
        in lines
    )
    lost = printed(summary(events_left_out=1204), width=120)
    assert "events 1,204 left out: too many of one parcel in one solver call" in " ".join(lost.split())
    limits = {"law", "chatter", "events"}
    assert not limits & {line.partition(" ")[0] for line in printed(summary()).splitlines()}
