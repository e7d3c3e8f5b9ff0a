"""A run is spoken to while it goes on; what was done to it can be repeated to the same digest."""

from __future__ import annotations

import json
import threading
from pathlib import Path
from typing import Any

import pytest

from bus.errors import TransportError
from bus.transports.zenoh import open_client
from bus.transports.zenoh.requests import REQUEST_LIMIT, send_request
from bus.wire.keys import plant_key
from deploy.control.client import Address, ask_run, discover
from deploy.control.server import read_request
from deploy.errors import DeployError, InputError, RequestError
from deploy.runs.run import run
from deploy.runs.summary import Outcome
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene
from deploy.workers.plan import Processes, RunOptions

TICKS = 150


def scene(**changes: Any) -> Scene:
    overrides = [
        Override(("duration_s",), TICKS * 0.004096, ""),
        Override(("array", "rows"), 4, ""),
        Override(("array", "columns"), 5, ""),
        Override(("cells", "parameters", "held"), [{"columns": [0, 0], "speed_m_s": [0.3, 0.0]}], ""),
        Override(("parcels", 0, "position_m"), [0.0, 0.03], ""),
    ]
    return load_scene("heat", overrides + [Override((key,), value, "") for key, value in changes.items()])


class Running:
    """A run in a thread, slow enough to be spoken to."""

    def __init__(self, folder: Path, processes: Processes) -> None:
        self.folder = folder
        self.outcome: Outcome | None = None
        options = RunOptions(processes=processes, output=folder, picture=False, realtime=0.2)
        self.thread = threading.Thread(target=self._run, args=(options,))
        self.thread.start()

    def _run(self, options: RunOptions) -> None:
        self.outcome = run(scene(), options, quiet=True)

    def ask(self, **request: Any) -> dict[str, Any]:
        """As soon as it can answer."""
        while True:
            try:
                return ask_run(discover(self.folder).connect, request, 10.0)
            except (InputError, DeployError) as error:
                if isinstance(error, RequestError) or not self.thread.is_alive():
                    raise

    def end(self) -> Outcome:
        self.thread.join(60)
        assert self.outcome is not None
        return self.outcome


@pytest.mark.slow
@pytest.mark.timeout(120)
@pytest.mark.parametrize("processes", ["each", pytest.param(2, marks=pytest.mark.slow)])
def test_a_live_fault_acts_is_repaired_and_is_repeated_to_the_same_digest(
    tmp_path: Path, processes: Processes
) -> None:
    running = Running(tmp_path / "live", processes)
    first = running.ask(op="inject", fault={"kind": "crash", "cells": [[0, 0], [1, 2]]})
    assert first["ok"]
    assert first["cells"] == [[0, 0], [1, 2]]
    share = running.ask(op="inject", fault={"kind": "crash", "share": 0.2}, for_s=0.05)
    repaired = running.ask(op="repair", number=first["number"])
    listed = running.ask(op="list")["faults"]
    live = running.end()

    assert live.summary.status == "ok"
    assert [(one["number"], one["from_tick"], one["until_tick"]) for one in listed] == [
        (0, first["tick"], repaired["tick"]),
        (1, share["tick"], share["tick"] + 13),
    ]
    assert [(fault["phase"], fault["tick"]) for fault in live.summary.faults if len(fault["cells"]) == 2] == [
        ("begins", first["tick"]),
        ("ends", repaired["tick"]),
    ]
    assert live.summary.digest != run(scene(), _memory(tmp_path / "undisturbed")).summary.digest
    again = run(scene(), _memory(tmp_path / "again", replay=tmp_path / "live"), quiet=True)
    assert again.summary.status == "ok"
    assert again.summary.digest == live.summary.digest


def test_a_recording_of_another_scene_is_not_repeated(tmp_path: Path) -> None:
    run(scene(), _memory(tmp_path / "one"), quiet=True)
    with pytest.raises(InputError, match="another scene than heat: seed"):
        run(scene(seed=5), _memory(tmp_path / "two", replay=tmp_path / "one"), quiet=True)


def test_bad_requests_are_refused_in_words_and_change_nothing(tmp_path: Path) -> None:
    running = Running(tmp_path / "live", 0)
    for request, words in [
        ({"op": "inject", "fault": {"kind": "crash", "cell": [9, 9]}}, "fault.cell: the array has rows 0..3"),
        ({"op": "inject", "fault": {"kind": "melt", "cell": [0, 0]}}, 'fault.kind = "melt"'),
        (
            {"op": "inject", "fault": {"cell": [0, 0], "at_s": 1.0}},
            "fault.at_s: a live fault begins at the next tick",
        ),
        ({"op": "inject", "fault": {"cell": [0, 0], "until_s": 0.0}}, "until_s must be after at_s"),
        ({"op": "inject", "fault": {"cell": [0, 0]}, "for_s": 0}, "for_s = 0: must be > 0"),
        ({"op": "repair", "number": 4}, "there is no fault 4; there are: none"),
        ({"op": "dance"}, 'op = "dance"'),
    ]:
        with pytest.raises(RequestError) as refused:
            running.ask(**request)
        assert words in str(refused.value)
    endpoint = open_client(discover(running.folder).connect)
    try:
        for payload in (b"", b"\xff", b"[" * 10_000, b"{}", b"1", b"x" * (REQUEST_LIMIT + 1)):
            answer = json.loads(send_request(endpoint, plant_key("*", "operator"), payload, 10.0))
            assert not answer["ok"]
            assert answer["problems"]
        with pytest.raises(TransportError, match="no run answers"):
            send_request(endpoint, plant_key("another-run", "operator"), b"{}", 10.0)
    finally:
        endpoint.close()
    live = running.end()
    assert live.summary.digest == run(scene(), _memory(tmp_path / "undisturbed")).summary.digest
    with pytest.raises(InputError, match="no run in progress writes there"):
        discover(running.folder)


def test_requests_are_read_or_refused_whatever_they_are() -> None:
    assert read_request(b'{"op": "list"}').op == "list"
    for payload in (None, b"{" * 100_000, b'{"op": ["list"]}', b'{"op": "inject"}', b"\x00"):
        with pytest.raises(RequestError):
            read_request(payload)


def test_a_note_of_a_run_that_is_over_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "runs" / "one"
    folder.mkdir(parents=True)
    Address("one", "tcp/127.0.0.1:1", 2**22 + 1).write(folder)
    with pytest.raises(InputError, match="no run is in progress below runs/"):
        discover(None)


def _memory(folder: Path, replay: Path | None = None) -> RunOptions:
    return RunOptions(processes=0, transport="memory", output=folder, picture=False, replay=replay)
