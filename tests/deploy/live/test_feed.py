"""Frames of a run: which events and faults they bring, and the health of cells."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from deploy.live import feed as feeds
from deploy.live.feed import Feed
from deploy.live.frame import FAULTY, LOST, RunFrame, decode
from plant.observations import Event

HEADER = {"run": "one"}


class Looked:
    """A feed of four cells and two parcels, with stand-ins of a run."""

    def __init__(self) -> None:
        self.asked: list[Any] = []
        self.answers: list[bytes] = []
        self.faults: list[Any] = []
        self.log: list[Any] = []
        sense = SimpleNamespace(presence=np.zeros((4, 1), dtype=np.bool_))
        self.process = SimpleNamespace(
            tick=7, time_ns=28_000_000, sense=sense, lost=np.zeros(4, dtype=np.bool_), report=lambda: None
        )
        plant = SimpleNamespace(
            state=np.zeros((2, 6)),
            on_surface=np.array([1]),
            status=[SimpleNamespace(state="waiting"), SimpleNamespace(state="moving")],
            wheel_speed=np.zeros((4, 2)),
        )
        flow = {"state": "running", "speed": None, "real_time_factor": 1.0, "lag_s": 0.0}
        control = SimpleNamespace(
            flow=SimpleNamespace(state=lambda: flow), faults=SimpleNamespace(active=lambda tick: self.faults)
        )
        log = SimpleNamespace(faults=self.log)
        parts: Any = (self, self.process, plant, control, log, HEADER)
        self.feed = Feed(*parts)

    def drain(self) -> Any:
        """Of the queue."""
        if not self.asked:
            return None
        return SimpleNamespace(payload=self.asked.pop(0), answer=self.answers.append)

    def frame(self, **request: Any) -> tuple[RunFrame, Any]:
        self.asked.append(json.dumps(request).encode())
        self.feed.serve()
        return decode(self.answers[-1])

    def happen(self, *kinds: str) -> None:
        events = [Event(0.1, kind, 0, (), (0.0, 0.0), "") for kind in kinds]
        self.feed.after_tick(cast("Any", SimpleNamespace(events=events)))


def test_a_cell_is_lost_by_crash_or_by_what_was_found_and_faulty_by_any_other_fault() -> None:
    looked = Looked()
    looked.process.lost[0] = True
    for kind, cells in (("hang", [1]), ("crash", [2])):
        looked.faults.append(SimpleNamespace(fault=SimpleNamespace(kind_name=kind), cells=np.array(cells)))
    frame, header = looked.frame()
    assert frame.health.tolist() == [LOST, FAULTY, LOST, 0]
    assert frame.in_play.tolist() == [False, True]
    assert header is None
    assert looked.frame(header=True)[1] == HEADER


def test_events_and_faults_come_from_where_a_viewer_has_got_to_and_old_ones_are_dropped(
    monkeypatch: Any,
) -> None:
    monkeypatch.setattr(feeds, "_EVENTS", 3)
    looked = Looked()
    looked.feed._events = type(looked.feed._events)(maxlen=3)  # pyright: ignore[reportPrivateUsage]
    looked.happen("a", "b")
    looked.log += [{"kind": "one"}, {"kind": "two"}]
    frame, _ = looked.frame(events=1, faults=1)
    assert (frame.first_event, [event["kind"] for event in frame.events]) == (1, ["b"])
    assert [fault["kind"] for fault in frame.faults] == ["two"]
    looked.happen("c", "d", "e")
    frame, _ = looked.frame(events=2, faults=2)
    assert (frame.first_event, [event["kind"] for event in frame.events]) == (2, ["c", "d", "e"])
    assert frame.faults == ()
    looked.happen("f", "g", "h", "i")
    assert looked.frame(events=3)[0].first_event == 6


def test_any_payload_is_answered_with_a_frame() -> None:
    looked = Looked()
    looked.happen("a")
    for payload in (
        None,
        b"",
        b"[]",
        b"{",
        b'{"events": null}',
        b'{"events": "x"}',
        b'{"events": -5}',
        b"\xff",
    ):
        looked.asked.append(payload)
        looked.feed.serve()
        frame, header = decode(looked.answers[-1])
        assert (frame.tick, header) == (7, None)
