"""What a run will start, decided and printable before anything is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from bus.wire.keys import WireFormat
from deploy.errors import InputError
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene
from deploy.security.generate import generate_keys
from deploy.security.roles import roles_of
from deploy.workers.listening import free_port, joined_at
from deploy.workers.plan import Plan, RunOptions, plan


@pytest.fixture(scope="module")
def motors() -> Scene:
    return load_scene("motors")


def _plan(scene: Scene, **options: Any) -> Plan:
    return plan(scene, RunOptions(**options), "r")


def test_few_cells_get_one_worker_and_many_get_two(motors: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 8)
    large = load_scene("elliptic", [Override(("array", "rows"), 51, "")])
    assert _plan(motors).workers == 1
    assert _plan(large).workers == 2


def test_one_processor_core_gets_one_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 1)
    assert _plan(load_scene("elliptic", [Override(("array", "rows"), 51, "")])).workers == 1


def test_messages_are_relayed_between_processes_unless_others_are_given_an_address(motors: Scene) -> None:
    assert _plan(motors, processes="each").wire == "relayed"
    assert _plan(motors, processes=2).wire == "relayed"
    assert _plan(motors, processes=1).wire == "packed"
    assert _plan(motors, processes="each", wire="packed").wire == "packed"
    endpoint = "tcp/127.0.0.1:7447"
    assert _plan(motors, processes="each", listen=endpoint).wire == "per_cell"
    assert _plan(motors, processes="each", join="unixsock-stream/some/where").wire == "per_cell"
    assert _plan(motors, processes="each", listen=endpoint, wire="relayed").wire == "relayed"
    assert _plan(motors, processes=2, listen=endpoint).wire == "packed"


@pytest.mark.parametrize("wire", ["packed", "per_cell", "relayed"])
def test_a_run_with_keys_has_the_wire_form_of_the_keys(
    motors: Scene, wire: WireFormat, tmp_path: Path
) -> None:
    made = _plan(motors, processes="each", wire=wire)
    folder = tmp_path / "keys"
    generate_keys(folder, "motors", made.cut, "password", hosts=(), days=1, force=False)
    listening = _plan(motors, processes="each", keys=folder, listen="tcp/127.0.0.1:7447")
    assert listening.wire == wire
    assert roles_of(listening.cut) == roles_of(made.cut)


def test_every_cell_is_in_exactly_one_process(motors: Scene) -> None:
    for processes in (0, 1, 5, "each"):
        made = _plan(motors, processes=processes)
        cells = [cell for process in made.processes for cell in process.cells]
        assert sorted(cells) == list(motors.lattice().cells)
        assert made.processes[0].role == "plant"


def test_processes_are_named_after_their_cell_or_numbered(motors: Scene) -> None:
    assert [p.name for p in _plan(motors, processes=2).processes] == ["plant", "cells 0", "cells 1"]
    assert [p.name for p in _plan(motors, processes="each").processes][:3] == [
        "plant",
        "cell 0,0",
        "cell 0,1",
    ]


def test_the_cells_join_where_nobody_else_is_told_to_connect(motors: Scene) -> None:
    plant, cells = _plan(motors, processes=1, listen="tcp/127.0.0.1:7447").processes
    assert (plant.listen, plant.join, plant.connect) == ("tcp/127.0.0.1:7447", joined_at(None), None)
    assert (cells.listen, cells.join, cells.connect) == (None, None, joined_at(None))
    plant, cells = _plan(motors, processes=1, join="unixsock-stream//tmp/x").processes
    assert (plant.listen, plant.join, cells.connect) == (free_port(None), *["unixsock-stream//tmp/x"] * 2)


def test_memory_runs_everything_in_this_process_without_endpoints(motors: Scene) -> None:
    made = _plan(motors, transport="memory")
    assert made.workers == 0
    assert {(p.listen, p.join, p.connect) for p in made.processes} == {(None, None, None)}
    assert [p.where for p in made.processes] == ["this process", "a thread of this process"]


@pytest.mark.parametrize(
    "options",
    [
        {"processes": 19},
        {"processes": 1, "transport": "memory"},
        {"processes": "each", "transport": "memory"},
        {"transport": "memory", "listen": "tcp/127.0.0.1:1"},
        {"transport": "memory", "join": "unixsock-stream//tmp/x"},
        {"join": "tcp/127.0.0.1:1"},
        {"realtime": 0.0},
        {"realtime": -1.0},
        {"realtime": float("nan")},
        {"realtime": float("inf")},
    ],
)
def test_options_that_do_not_go_together_are_bad_input(motors: Scene, options: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="--"):
        _plan(motors, **options)


def test_the_plan_as_json_names_cells_as_the_keys_do(motors: Scene) -> None:
    made = _plan(motors, processes="each").as_json()
    assert made["start"][1]["cells"] == ["0,0"]
    assert made["start"][0]["ready"] == "all 18 cells alive and ready within 30 s"
