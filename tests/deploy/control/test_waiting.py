"""Requests to a run that waits for its cells: what acts before the first tick, what ends the wait, what is refused."""

from __future__ import annotations

import json
from collections import deque
from types import SimpleNamespace
from typing import Any, cast

import pytest

from deploy.control.waiting import WaitingControl
from tests.deploy.control.test_server import Live


class Queue:
    """A queue of requests, and the answers to them."""

    def __init__(self) -> None:
        self.payloads: deque[bytes] = deque()
        self.answers: list[dict[str, Any]] = []

    def drain(self) -> Any:
        if not self.payloads:
            return None
        return SimpleNamespace(
            payload=self.payloads.popleft(), answer=lambda text: self.answers.append(json.loads(text))
        )


def control(*, paused: bool = False) -> tuple[WaitingControl, Queue]:
    queue = Queue()
    return WaitingControl(
        "one", cast("Any", queue), lambda: "1 of 2 shards: 1", speed=None, paused=paused
    ), queue


def ask(waiting: WaitingControl, queue: Queue, **request: Any) -> dict[str, Any]:
    queue.payloads.append(json.dumps(request).encode())
    waiting.serve()
    return queue.answers[-1]


def test_a_status_says_what_is_waited_for_and_a_stop_ends_the_wait() -> None:
    waiting, queue = control()
    answer = ask(waiting, queue, op="status")
    assert (answer["run"], answer["state"], answer["waits_for"]) == ("one", "waiting", "1 of 2 shards: 1")
    assert (waiting.ended, waiting.accepted) == (None, [])
    assert ask(waiting, queue, op="stop")["ok"] is True
    assert waiting.ended is not None
    assert not waiting.ended.reset


def test_pauses_and_the_pace_act_before_the_first_tick_and_are_recorded_there() -> None:
    waiting, queue = control()
    assert ask(waiting, queue, op="resume")["problems"] == ["resume: the run is not paused"]
    assert ask(waiting, queue, op="pause")["paused"] is True
    assert ask(waiting, queue, op="speed", factor=0.5)["speed"] == 0.5
    assert ask(waiting, queue, op="resume")["paused"] is False
    ask(waiting, queue, op="pause")
    live = Live()
    for request in waiting.accepted:
        live.server.flow.handle(request, 0)
    assert live.server.flow.paused
    assert live.server.flow.state()["speed"] == 0.5
    kinds = [(record["kind"], record["tick"]) for record in live.records]
    assert kinds == [("pause", 0), ("speed", 0), ("resume", 0), ("pause", 0)]


@pytest.mark.parametrize(
    "request_",
    [
        {"op": "step", "ticks": 1},
        {"op": "reset"},
        {"op": "list"},
        {"op": "show"},
        {"op": "repair", "number": 0},
        {"op": "inject", "fault": {"kind": "crash", "cell": [0, 0]}},
    ],
    ids=lambda request: request["op"],
)
def test_what_a_run_must_have_begun_for_is_refused_with_what_it_waits_for(request_: dict[str, Any]) -> None:
    waiting, queue = control(paused=True)
    answer = ask(waiting, queue, **request_)
    assert answer["ok"] is False
    (problem,) = answer["problems"]
    assert problem.startswith(f"{request_['op']}: the run has not begun")
    assert problem.endswith("waits for 1 of 2 shards: 1")
    assert waiting.accepted == []


def test_what_is_no_request_is_refused() -> None:
    waiting, queue = control()
    queue.payloads.append(b"{")
    waiting.serve()
    assert queue.answers[-1]["ok"] is False
