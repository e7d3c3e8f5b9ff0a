"""What cannot be run: one clear line, exit status 2, nothing started and nothing left."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.system.running import Mdms

Start = Callable[..., Mdms]

REFUSED = [
    (("--processes", "19"), "--processes 19: must be each or 0..18, the number of cells"),
    (("--processes", "many"), "--processes many: must be each, or a number of processes from 0"),
    (
        ("--transport", "memory", "--processes", "2"),
        "--transport memory --processes 2: memory is not shared between processes; it needs --processes 0",
    ),
    (
        ("--transport", "memory", "--listen", "tcp/127.0.0.1:7447"),
        "--listen: the memory transport has no endpoint; leave --listen or --transport memory out",
    ),
    (
        ("--listen", "tcp/0.0.0.0:7447"),
        "--listen tcp/0.0.0.0:7447: leaves this host, and anybody who reaches it",
    ),
    (
        ("--keys", "nowhere"),
        "--keys nowhere: is no folder of keys, there is no keys.json: mdms keys DIR SCENE makes one",
    ),
    (("--listen", "nonsense"), "--listen nonsense: must be PROTOCOL/ADDRESS, such as tcp/127.0.0.1:7447"),
    (("--realtime", "0"), "--realtime 0: must be greater than 0"),
    (
        ("--set", "parcels.0.position_m=[9.0,9.0]"),
        "scene motors: parcels[0].position_m = [9, 9]: the parcel stands on nothing",
    ),
    (("--listen", "tcp/127.0.0.1:77777"), "listen on tcp/127.0.0.1:77777: "),
]


@pytest.mark.parametrize(("options", "line"), REFUSED, ids=[" ".join(options) for options, _ in REFUSED])
def test_bad_input_is_one_line_and_status_2_and_leaves_no_folder(
    options: tuple[str, ...], line: str, mdms: Start
) -> None:
    running = mdms("run", "motors", *options)
    status, stdout, stderr = running.end()
    assert (status, stdout) == (2, "")
    assert stderr.startswith(line), stderr
    assert stderr.count("\n") == 1, stderr
    assert not running.output.exists()


def test_a_port_in_use_is_named(mdms: Start) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        running = mdms("run", "motors", "--listen", endpoint)
        status, _, stderr = running.end()
    assert (status, stderr) == (2, f"listen on {endpoint}: the port is in use\n")
    assert not running.output.exists()


@pytest.mark.slow
def test_an_output_that_is_no_folder_is_named(mdms: Start, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    status, _, stderr = mdms("run", "motors", output=tmp_path / "file" / "out").end()
    assert status == 2
    assert stderr == f"output {tmp_path / 'file' / 'out'}: can't be made: Not a directory\n"


def test_simulate_refuses_firmware_without_a_field(mdms: Start) -> None:
    status, _, stderr = mdms("simulate", "heat").end()
    assert status == 2
    assert "heat_diffusion" in stderr
    assert "must be velocity_field" in stderr
    assert stderr.count("\n") == 1


def test_a_plan_says_what_would_be_started_and_starts_nothing(mdms: Start) -> None:
    running = mdms("run", "motors", "--processes", "each", "--plan", "--json")
    status, stdout, stderr = running.end()
    plan = json.loads(stdout)
    assert (status, stderr, running.seen) == (0, "", set())
    assert plan["wire"] == "relayed"
    assert [process["role"] for process in plan["start"]] == ["plant"] + ["cells"] * 18
    assert plan["start"][1]["name"] == "cell 0,0"
    assert plan["start"][1]["cells"] == ["0,0"]
    assert not running.output.exists()
