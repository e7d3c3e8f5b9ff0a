"""Discovery of running runs, and requests to one."""

from __future__ import annotations

import json
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from bus.errors import TransportError
from deploy.control.client import FILE_NAME, Address, ask_run, ask_status, discover
from deploy.errors import DeployError, InputError, RequestError

HERE = Address("one", "tcp/127.0.0.1:7447", os.getpid())
NOBODY = 2**22 + 1
"""No process has this number."""


def test_a_run_is_found_in_its_folder_as_long_as_its_note_is_there(tmp_path: Path) -> None:
    HERE.write(tmp_path)
    assert discover(tmp_path) == HERE
    Address.remove(tmp_path)
    Address.remove(tmp_path)
    with pytest.raises(InputError, match="no run in progress writes there"):
        discover(tmp_path)


@pytest.mark.parametrize(
    "note",
    [
        {"run": "one", "connect": "tcp/x:1", "pid": NOBODY},
        {"run": "one", "pid": 1},
        {"run": "one", "connect": "tcp/x:1", "pid": "many"},
        [],
        None,
    ],
    ids=repr,
)
def test_a_note_that_nobody_answers_for_is_none(note: object, tmp_path: Path) -> None:
    (tmp_path / FILE_NAME).write_text("{" if note is None else json.dumps(note))
    with pytest.raises(InputError, match="no run in progress writes there"):
        discover(tmp_path)


def test_without_a_folder_it_is_the_last_run_below_runs_that_still_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="no run is in progress below runs/"):
        discover(None)
    for began, (name, pid) in enumerate([("b", os.getpid()), ("c", os.getpid()), ("a", NOBODY)]):
        folder = tmp_path / "runs" / name
        folder.mkdir(parents=True)
        Address(name, "tcp/x:1", pid).write(folder)
        os.utime(folder / FILE_NAME, (began, began))
    assert discover(None).run == "c"


class Plant:
    """What answers, and whether whoever asked left."""

    def __init__(self, answer: bytes | Exception, monkeypatch: pytest.MonkeyPatch) -> None:
        self.answer, self.left, self.sent = answer, False, list[Any]()
        self.tokens = {"mdms/one/plant/alive"}
        monkeypatch.setattr("deploy.control.client.operator_session", self._session)
        monkeypatch.setattr("bus.transports.zenoh.requests.send_request", self._ask)
        monkeypatch.setattr("bus.transports.zenoh.requests.tokens_at", lambda *_: self.tokens)

    def _session(self, *_: object) -> Any:
        return SimpleNamespace(close=lambda: setattr(self, "left", True))

    def _ask(self, _endpoint: object, key: str, payload: bytes, timeout_s: float) -> bytes:
        self.sent.append((key, json.loads(payload), timeout_s))
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer


def test_an_answer_is_handed_on(monkeypatch: pytest.MonkeyPatch) -> None:
    plant = Plant(b'{"ok": true, "run": "one"}', monkeypatch)
    assert ask_run("tcp/x:1", {"op": "list"}, 3.0) == {"ok": True, "run": "one"}
    ((_, request, timeout_s),) = plant.sent
    assert (request, timeout_s, plant.left) == ({"op": "list"}, 3.0, True)


def test_a_refusal_is_reported_with_all_its_problems(monkeypatch: pytest.MonkeyPatch) -> None:
    plant = Plant(b'{"ok": false, "problems": ["a", "b"]}', monkeypatch)
    with pytest.raises(RequestError) as refused:
        ask_run("tcp/x:1", {"op": "list"}, 3.0)
    assert refused.value.problems == ("a", "b")
    assert plant.left


@pytest.mark.parametrize(
    ("answer", "problem"),
    [
        (TransportError("no run answers"), "tcp/x:1: no run answers"),
        (b"{", "the answer is not from a run"),
        (b"\xff", "the answer is not from a run"),
        (b"[" * 100_000, "the answer is not from a run"),
        (b"[]", "the answer is not from a run"),
        (b'{"ok": 1}', "the answer is not from a run"),
        (b'{"ok": false}', "the answer is not from a run"),
        (b'{"ok": 0, "problems": []}', "the answer is not from a run"),
        (b'{"problems": []}', "the answer is not from a run"),
    ],
    ids=lambda value: repr(value)[:30],
)
def test_what_is_no_answer_of_a_run_is_said_and_left(
    answer: bytes | Exception, problem: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant = Plant(answer, monkeypatch)
    with pytest.raises(DeployError, match=problem) as failed:
        ask_run("tcp/x:1", {"op": "list"}, 3.0)
    assert not isinstance(failed.value, RequestError)
    assert plant.left


def test_a_request_goes_to_the_only_run_there_or_to_the_one_that_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plant = Plant(b'{"ok": true, "run": "one"}', monkeypatch)
    ask_run("tcp/x:1", {"op": "list"}, 3.0)
    plant.tokens = {"mdms/one/plant/alive", "mdms/two/plant/alive"}
    with pytest.raises(InputError, match="several runs, name one of them \\(--run\\): one, two"):
        ask_run("tcp/x:1", {"op": "stop"}, 3.0)
    ask_run("tcp/x:1", {"op": "stop"}, 3.0, run="two")
    ask_status("tcp/x:1", "one", 3.0)
    assert [key for key, _, _ in plant.sent] == [
        "mdms/one/plant/operator",
        "mdms/two/plant/operator",
        "mdms/one/plant/status",
    ]


def test_what_is_no_endpoint_is_refused_in_plain_words() -> None:
    with pytest.raises(
        InputError, match=r"^--connect here: must be PROTOCOL/ADDRESS, such as tcp/127\.0\.0\.1:7447$"
    ):
        ask_run("here", {"op": "list"}, 3.0)
