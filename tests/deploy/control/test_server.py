"""Requests to a run while it continues: what is done, sent, recorded and answered; and what is refused."""

from __future__ import annotations

import json
from collections import deque
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any, cast

import pytest

from bus.fault import FaultInstance, FaultSpec
from bus.wire.frames import Control
from cell_firmware.faults.kinds.reboot import RebootFault
from deploy.control.server import ControlServer
from deploy.errors import RequestError
from deploy.faults.crash import CrashFault
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override

TICK_S = 0.004096
SCENE = load_scene("motors")
HANG: dict[str, Any] = {"kind": "hang", "cell": [0, 1]}
STUCK: dict[str, Any] = {"kind": "wheel_stuck", "cell": [1, 0]}


class Live:
    """A control server, and stand-ins that record its calls."""

    def __init__(
        self, *scheduled: FaultInstance[FaultSpec], script: Any = (), scene: Any = SCENE, **options: Any
    ):
        self.sent: list[Control] = []
        self.payloads: deque[bytes | None] = deque()
        self.answers: list[dict[str, Any]] = []
        self.records: list[Any] = []
        self.said: list[str] = []
        self.log: list[Any] = []
        self.process = SimpleNamespace(
            inject=lambda one: self.log.append(("process", one.number)),
            replan=lambda: self.log.append("process plans"),
            place_parcel=lambda parcel, pose: self.log.append(("placed", parcel, pose.tolist())),
            report=lambda: None,
            idle=nullcontext,
            pace=None,
            tick=0,
            time_ns=0,
        )
        self.server = ControlServer(
            scene,
            "one",
            scheduled,
            self.sent.append,
            cast("Any", self),
            cast("Any", self.process),
            cast("Any", self),
            script,
            **options,
        )

    def inject(self, one: FaultInstance[FaultSpec]) -> None:
        """Of the run log."""
        self.log.append(("run log", one.number))

    def replan(self) -> None:
        """Of the run log."""
        self.log.append("run log plans")

    def warn(self, line: str) -> None:
        """Of the run log."""
        self.said.append(line)

    def control(self, record: Any) -> None:
        """Of the run log."""
        self.records.append(record)

    def drain(self) -> Any:
        """Of the questions."""
        if not self.payloads:
            return None
        return SimpleNamespace(
            payload=self.payloads.popleft(), answer=lambda text: self.answers.append(json.loads(text))
        )

    def ask(self, tick: int, **request: Any) -> dict[str, Any]:
        self.send(request)
        self.begin(tick)
        return self.answers[-1]

    def send(self, request: Any) -> None:
        self.payloads.append(json.dumps(request).encode())

    def begin(self, tick: int) -> None:
        """Begin a tick, as the plant's process does."""
        self.process.tick, self.process.time_ns = tick, round(tick * TICK_S * 1e9)
        if self.process.pace is not None:
            self.process.pace(self.process.time_ns)
        self.server.before_tick(tick)

    def details(self) -> list[Any]:
        return [(control.tick, control.cells, json.loads(control.detail)) for control in self.sent]


def test_a_fault_of_cells_is_sent_to_all_recorded_and_answered_with_the_affected_cells() -> None:
    live = Live()
    answer = live.ask(10, op="inject", fault=HANG)
    assert answer == {
        "run": "one", "ok": True, "tick": 10, "time_s": pytest.approx(10 * TICK_S), "number": 0,
        "cells": [[0, 1]], "affected": 1,
    }  # fmt: skip
    detail = {"number": 0, "fault": HANG, "first": 10, "end": None}
    assert live.details() == [(10, (), detail)]
    (record,) = live.records
    assert (record["kind"], record["tick"], record["detail"]) == ("fault", 10, detail)
    assert record["time_s"] == pytest.approx(10 * TICK_S)
    assert live.log == [("run log", 0)]


def test_a_fault_of_the_plant_is_none_of_the_cells_and_a_crash_is_both_s() -> None:
    live = Live()
    live.ask(10, op="inject", fault=STUCK)
    assert (live.log, live.sent) == ([("process", 0), ("run log", 0)], [])
    live.ask(11, op="inject", fault={"kind": "crash", "cell": [0, 0]})
    assert live.log[2:] == [("process", 1), ("run log", 1)]
    assert len(live.sent) == 1


@pytest.mark.parametrize("ticks", [1, 5, 123, 131])
def test_a_fault_lasts_as_many_ticks_as_it_is_given(ticks: int) -> None:
    live = Live()
    live.ask(10, op="inject", fault=HANG, for_s=round(ticks * TICK_S, 6))
    live.ask(10, op="inject", fault={**HANG, "until_s": round((10 + ticks) * TICK_S, 6)})
    live.ask(10, op="inject", fault={"kind": "reboot", "cell": [0, 0], "delay_s": round(ticks * TICK_S, 6)})
    assert [detail["end"] for _, _, detail in live.details()] == [10 + ticks] * 3


def test_numbers_go_on_from_those_of_the_scene() -> None:
    scheduled = FaultInstance(4, CrashFault(cell=(0, 0)), SCENE.lattice().rows[:1], 50)
    live = Live(cast("Any", scheduled))
    assert live.ask(10, op="inject", fault=HANG)["number"] == 5
    live.ask(12, op="inject", fault=STUCK, for_s=TICK_S)
    live.ask(13, op="repair", number=5)
    listed = live.ask(20, op="list")
    assert (listed["tick"], listed["ok"]) == (20, True)
    assert [tuple(fault.values()) for fault in listed["faults"]] == [
        (4, "crash", 1, 50, None, "scheduled"),
        (5, "hang", 1, 10, 13, "ended"),
        (6, "wheel_stuck", 1, 12, 13, "ended"),
    ]
    assert live.ask(50, op="list")["faults"][0]["state"] == "active"


def test_a_repair_ends_a_fault_for_all_and_is_recorded() -> None:
    live = Live()
    live.ask(10, op="inject", fault=HANG)
    live.log.clear()
    answer = live.ask(14, op="repair", number=0)
    assert answer == {"run": "one", "ok": True, "tick": 14, "time_s": pytest.approx(14 * TICK_S), "number": 0}
    assert live.details()[1] == (14, (), {"number": 0, "end": 14})
    assert live.log == ["process plans", "run log plans"]
    assert live.records[1] == {
        "time_s": pytest.approx(14 * TICK_S), "kind": "repair", "tick": 14, "detail": {"number": 0, "end": 14},
    }  # fmt: skip


def test_what_can_not_be_repaired_is_said() -> None:
    scheduled = [
        FaultInstance(0, CrashFault(cell=(0, 0)), SCENE.lattice().rows[:1], 5),
        FaultInstance(1, RebootFault(cell=(0, 0)), SCENE.lattice().rows[:1], 5, 50),
        FaultInstance(2, CrashFault(cell=(0, 1), at_s=9.0, until_s=10.0), SCENE.lattice().rows[:1], 40, 50),
    ]
    live = Live(*cast("Any", scheduled))
    for number, start in [
        (0, "the cells of fault 0 have left the run and can't be repaired"),
        (1, "fault 1 is not active"),
        (2, "fault 2 is not active"),
        (3, "there is no fault 3; there are: 0, 1, 2"),
    ]:
        assert live.ask(10, op="repair", number=number)["problems"] == [f"number: {start}"]
    assert (live.sent, live.records, live.log) == ([], [], [])
    assert live.ask(40, op="repair", number=2)["ok"]


@pytest.mark.parametrize(
    ("request_", "start"),
    [
        ({"fault": {**HANG, "at_s": 1.0}}, "fault.at_s: a live fault begins at the next tick"),
        ({"fault": {"kind": "reboot", "cell": [0, 0]}, "for_s": 1.0}, "for_s: reboot happens once"),
        (
            {"fault": {**HANG, "until_s": 9.0}, "for_s": 1.0},
            "for_s: fault.until_s sets the repair already: leave one of the two out",
        ),
        ({"fault": {**HANG, "until_s": 10 * TICK_S}}, "fault.until_s: is in the past"),
        ({"fault": {**HANG, "cell": [99, 0]}}, "fault.cell: the array has rows"),
        (
            {"fault": {"kind": "wheel_runaway", "cell": [0, 0], "speed_m_s": 1.0}},
            "fault.speed_m_s: is for ideal wheels",
        ),
    ],
)
def test_a_fault_that_can_not_begin_now_is_refused_and_changes_nothing(
    request_: dict[str, Any], start: str
) -> None:
    live = Live()
    answer = live.ask(10, op="inject", **request_)
    assert not answer["ok"]
    assert answer["run"] == "one"
    assert [problem[: len(start)] for problem in answer["problems"]] == [start]
    assert (live.sent, live.records, live.log) == ([], [], [])


def test_lines_that_carry_whole_messages_take_no_faults_of_cells() -> None:
    scene = load_scene("prototype")
    for lines, refused in ((False, ["fault.kind: this run's serial lines"]), (True, [])):
        live = Live(scene=scene, lines=lines)
        problems = live.ask(10, op="inject", fault=HANG).get("problems", [])
        assert [problem[:35] for problem in problems] == refused
        assert live.ask(10, op="inject", fault=STUCK)["ok"]
    assert Live(lines=False).ask(10, op="inject", fault=HANG)["ok"]


def test_cells_are_named_up_to_sixty_four_and_too_many_to_send_are_refused() -> None:
    scene = load_scene("motors", [Override(("array",), {"rows": 100, "columns": 100}, "")])
    live = Live(scene=scene)
    answer = live.ask(10, op="inject", fault={"kind": "hang", "rectangle": [[0, 0], [99, 0]]})
    assert (answer["affected"], len(answer["cells"])) == (100, 64)
    cells = [[row, column] for row in range(100) for column in range(40)]
    one = FaultInstance(1, CrashFault.model_validate({"cells": cells}), scene.lattice().rows, 10)
    assert len(json.dumps(one.record())) > 30_000
    assert live.ask(10, op="inject", fault={"kind": "hang", "cells": cells})["problems"] == [
        "fault.cells: are too many for one request: use rectangle or share"
    ]


def test_eight_questions_are_answered_a_tick_and_the_others_wait() -> None:
    live = Live()
    live.payloads.extend([b'{"op": "list"}'] * 9 + [None])
    live.server.before_tick(10)
    assert (len(live.answers), len(live.payloads)) == (8, 2)
    live.server.before_tick(11)
    assert (len(live.answers), len(live.payloads)) == (10, 0)
    assert [answer["ok"] for answer in live.answers] == [True] * 9 + [False]


def test_rejoined_cells_receive_their_own_faults_and_no_others() -> None:
    scheduled = FaultInstance(0, CrashFault(cell=(0, 0), until_s=9.0), SCENE.lattice().rows[:1], 0, 90)
    live = Live(cast("Any", scheduled))
    live.ask(10, op="inject", fault=HANG)
    live.ask(10, op="inject", fault=STUCK)
    live.ask(12, op="repair", number=0)
    live.sent.clear()
    live.server.faults.resend_faults([0, 2], 20)
    names = (SCENE.lattice().cells[0], SCENE.lattice().cells[2])
    assert live.details() == [
        (20, names, {"number": 1, "fault": HANG, "first": 10, "end": None}),
        (20, names, {"number": 0, "end": 12}),
    ]


def test_what_was_done_to_a_recorded_run_is_done_again_at_its_ticks() -> None:
    fault = {"number": 7, "fault": HANG, "first": 5, "end": None}
    script = [
        {"kind": "repair", "tick": 9, "detail": {"number": 7, "end": 9}},
        {"kind": "fault", "tick": 5, "detail": fault},
    ]
    live = Live(script=script)
    for tick in range(12):
        live.server.before_tick(tick)
    assert live.details() == [(5, (), fault), (9, (), {"number": 7, "end": 9})]
    assert [record["tick"] for record in live.records] == [5, 9]
    with pytest.raises(RequestError, match="there is no fault 7; there are: none"):
        Live(script=script[:1]).server.before_tick(9)


def test_where_nobody_can_ask_what_was_recorded_is_done_all_the_same() -> None:
    sent: list[Control] = []
    record = {"kind": "fault", "tick": 3, "detail": {"number": 7, "fault": HANG, "first": 3, "end": None}}
    books = SimpleNamespace(inject=lambda _: None, control=lambda _: None, time_ns=0, pace=None, tick=0)
    server = ControlServer(
        SCENE, "one", (), sent.append, cast("Any", books), cast("Any", books), script=[record]
    )
    for tick in range(5):
        server.before_tick(tick)
    assert [control.tick for control in sent] == [3]
