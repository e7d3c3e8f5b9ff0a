"""Flow of a run: pause, steps, pace and end on request; what is answered, recorded and refused."""

from __future__ import annotations

import time
from typing import Any

import pytest

from deploy.control.flow import EndedByOperator
from tests.deploy.control.test_server import TICK_S, Live


def kinds(live: Live) -> list[str]:
    return [record["kind"] for record in live.records]


def requests(live: Live, *later: Any) -> None:
    """Have requests come one after another, with a look into the empty queue after each."""
    waiting = [entry for request in later for entry in (request, None)]

    def drain() -> Any:
        if waiting and (request := waiting.pop(0)) is not None:
            live.send(request)
        return Live.drain(live)

    live.server._requests = type("Queue", (), {"drain": staticmethod(drain)})()  # pyright: ignore[reportPrivateUsage]


def test_a_paused_run_waits_until_it_is_resumed() -> None:
    live = Live()
    requests(live, {"op": "pause"}, {"op": "status"}, {"op": "resume"})
    live.begin(7)
    assert [(answer["tick"], answer["state"]) for answer in live.answers] == [
        (7, "paused"),
        (7, "paused"),
        (7, "running"),
    ]
    assert kinds(live) == ["pause", "resume"]
    assert [record["tick"] for record in live.records] == [7, 7]
    assert live.records[0]["time_s"] == pytest.approx(7 * TICK_S)
    assert ["paused before tick 7" in line for line in live.said] == [True, False]


def test_steps_are_answered_when_the_run_has_paused_again() -> None:
    live = Live(paused=True)
    requests(live, {"op": "step", "ticks": 3})
    for tick in (0, 1, 2):
        live.begin(tick)
        assert not live.answers
    requests(live, {"op": "resume"})
    live.begin(3)
    assert [(answer["tick"], answer["state"]) for answer in live.answers] == [(3, "paused"), (3, "running")]


def test_a_run_that_ends_before_its_steps_answers_that() -> None:
    live = Live(paused=True)
    requests(live, {"op": "step", "ticks": 3})
    live.begin(0)
    live.server.close()
    assert live.answers == [{"run": "one", "ok": False, "problems": ["the run has ended"]}]


@pytest.mark.parametrize("op", ["step", "resume"])
def test_a_run_that_is_not_paused_neither_steps_nor_resumes(op: str) -> None:
    answer = Live().ask(3, op=op)
    assert not answer["ok"]
    assert "the run is not paused" in answer["problems"][0]


def test_a_parcel_is_moved_in_a_paused_run_only() -> None:
    move = {"op": "move", "parcel": 0, "x_m": 0.2, "y_m": 0.1, "angle_rad": 1.0}
    live = Live()
    assert "the run is not paused" in live.ask(2, **move)["problems"][0]
    requests(live, {"op": "pause"}, move, {"op": "resume"})
    live.begin(3)
    assert live.log == [("placed", 0, [0.2, 0.1, 1.0])]
    assert live.records[1]["detail"] == {"parcel": 0, "pose": [0.2, 0.1, 1.0]}
    again = Live(script=[live.records[1]])
    again.begin(3)
    assert again.log == live.log


@pytest.mark.parametrize(("op", "reset"), [("stop", False), ("reset", True)])
def test_an_end_is_answered_and_raised(op: str, reset: bool) -> None:
    live = Live()
    with pytest.raises(EndedByOperator) as ended:
        live.ask(5, op=op)
    assert ended.value.reset is reset
    assert live.answers[0]["ok"]
    assert kinds(live) == [op]


def test_the_pace_is_kept_changed_and_given_up() -> None:
    live = Live(factor=4.0)
    begun = time.monotonic()
    for tick in range(50):
        live.begin(tick)
    took = time.monotonic() - begun
    assert took >= 49 * TICK_S / 4.0 - 1e-6
    assert live.ask(50, op="speed", factor=1000.0)["speed"] == 1000.0
    assert live.ask(51, op="speed", factor=None)["speed"] is None
    assert live.process.pace is None
    assert [record["detail"] for record in live.records] == [{"factor": 1000.0}, {"factor": None}]


def test_a_request_ends_the_wait_for_a_slow_pace() -> None:
    live = Live(factor=1e-4)
    live.begin(0)
    requests(live, {"op": "pause"}, {"op": "speed", "factor": None}, {"op": "resume"})
    begun = time.monotonic()
    live.begin(1)  # due in 41 s
    assert time.monotonic() - begun < 20.0
    assert kinds(live) == ["pause", "speed", "resume"]


@pytest.mark.parametrize("wrong", [{"factor": 0.0}, {"factor": -1.0}, {"factor": "fast"}, {}])
def test_a_speed_must_be_positive(wrong: dict[str, Any]) -> None:
    answer = Live().ask(1, op="speed", **wrong)
    assert not answer["ok"]
    assert "factor" in answer["problems"][0]
