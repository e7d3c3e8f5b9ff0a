"""A run whose plant, cells and router are commands of their own, as people and orchestrators start them."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgpack
import pytest
import zenoh

from bus.transports.base import Received
from bus.transports.zenoh import ZenohEndpoint, open_client
from deploy.cli import main
from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.security.keyring import identity_of
from deploy.workers.plan import RunOptions
from tests.system.running import Mdms, summary_of
from tests.system.test_keys import free_port, keys_for

Start = Callable[..., Mdms]
Small = Callable[..., Path]
OPEN = ("tcp/0.0.0.0:7447", "tcp/[::]:7447", "tcp/127.0.0.1:7447#iface=eth0", "udp/0.0.0.0:7447")


@pytest.mark.parametrize("endpoint", OPEN)
@pytest.mark.parametrize("command", [("plant", "heat", "--shards", "2"), ("router",)])
def test_nothing_listens_beyond_this_host_without_keys(
    command: tuple[str, ...], endpoint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*command, "--listen", endpoint]) == 2
    assert "leaves this host" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (("cells", "heat"), "name the cells by --shard I/N"),
        (("cells", "heat", "--shard", "0/2", "--cell", "1,1"), "name the cells by --shard I/N"),
        (("cells", "heat", "--shard", "2/2"), "I from 0 to N - 1"),
        (("cells", "heat", "--cell", "77,0"), "must be row and column of a cell of the scene"),
        (("cells", "heat", "--shard", "0/201"), "the scene has 200 cells"),
        (("cells", "heat", "--shard", "0/2", "--run", "a/b"), "--run: run name 'a/b'"),
        (("cells", "heat", "--shard", "0/2", "--connect", "here"), "must be PROTOCOL/ADDRESS"),
        (("cells", "heat", "--shard", "0/2", "--connect", "tls/h:1"), "tls/ goes with certificates"),
        (("cells", "heat", "--shard", "0/2", "--keys", "none"), "there is no such file"),
        (("plant", "heat", "--shards", "0"), "--shards 0: must be each, or a number of processes from 1"),
        (("plant", "heat", "--shards", "201"), "--shards 201: must be each or 1..200"),
        (("plant", "heat", "--listen", "tcp/a:1", "--connect", "tcp/b:1"), "give one of the two"),
        (("plant",), "mdms plant: name a SCENE"),
        (("router", "--listen", "here"), "must be PROTOCOL/ADDRESS"),
    ],
)
def test_bad_input_is_named_before_anything_starts(
    arguments: tuple[str, ...],
    problem: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    assert problem in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_probe_of_nobody_fails(capsys: pytest.CaptureFixture[str]) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    assert main(["status", "--connect", endpoint, "--timeout", "0.2"]) == 1
    assert "no answer" in capsys.readouterr().err


@pytest.mark.slow
def test_cells_join_in_any_order_and_whoever_differs_is_named_until_an_operator_stops_it_all(
    mdms: Start, small: Small, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, endpoint = small(), f"tcp/127.0.0.1:{free_port()}"
    at = ("--connect", endpoint)
    first = mdms("cells", scene, "--shard", "0/2", *at)
    other = mdms("cells", scene, "--shard", "1/2", *at, "--seed", 5)
    options = ("--shards", 2, "--listen", endpoint, "--realtime", 0.02, "--no-picture", "--json")
    plant = mdms("plant", scene, *options, "--output", tmp_path / "out")
    status, _, stderr = other.end()
    assert status == 2
    assert stderr.splitlines()[-1].endswith("differs from the plant: seed 5, not 0")
    asked = ["status", *at, "--json"]
    waiting: dict[str, Any] = {}

    def here() -> bool:
        assert main(asked) == 1
        waiting.update(json.loads(capsys.readouterr().out or "{}"))  # nothing: no answer in time
        return waiting.get("here") == 1

    plant.wait_for(here, "the first shard is there")
    assert waiting["state"] == "waiting"
    assert [one["shard"] for one in waiting["missing_shards"]] == [1]
    page = mdms("view", "--no-browser", *at)
    assert page.process.stderr is not None
    assert "waits for 1 of 2 shards; the page begins with the run" in page.process.stderr.readline()
    assert mdms("control", "pause", *at).end()[0] == 0
    second = mdms("cells", scene, "--shard", "1/2", *at)
    begun = ["status", "--run", str(tmp_path / "out"), "--json"]
    running: dict[str, Any] = {}

    def paused() -> bool:
        status = main(begun)
        running.update(json.loads(capsys.readouterr().out or "{}"))
        return status == 0 and running["state"] == "paused"

    plant.wait_for(paused, "the plant and all cells are there")
    assert (running["missing"], running["here"]) == (0, 2)
    assert page.process.stdout is not None
    assert page.process.stdout.readline().startswith("http://127.0.0.1:")
    page.process.send_signal(signal.SIGINT)
    assert page.end()[0] == 0
    assert mdms("control", "stop", *at).end()[0] == 0
    status, stdout, stderr = plant.end()
    assert (status, summary_of(stdout)["status"]) == (130, "interrupted")
    assert "differs from the plant: seed 5, not 0" in stderr
    for cells in (first, second):
        status, _, stderr = cells.end()
        assert (status, stderr.splitlines()[-1].partition("ended after ")[0]) == (
            0,
            f"mdms: shard {0 if cells is first else 1} of 2: ",
        )


def rude(endpoint: str, keys: Path) -> ZenohEndpoint:
    """Connect with the keys of shard 0, and put garbage and what is too large on its own key once the run goes on."""
    session = open_client(endpoint, timeout_s=20.0, identity=identity_of(keys / "cells-0", "cells-0"))
    session.subscribe("mdms/*/shard/0/sense")
    sense = session.receive(20.0)
    assert isinstance(sense, Received), "the run has not begun"
    own = f"mdms/{sense.key.split('/')[1]}/shard/0/drive"
    for payload in (b"\xc1", msgpack.packb([1]), bytes(100_000)):
        session.session.put(own, payload, congestion_control=zenoh.CongestionControl.BLOCK)
    return session


def until_denied(router: Mdms) -> str:
    """The first denial that a router tells of, waited for."""
    assert router.process.stderr is not None
    return next(line for line in router.process.stderr if "denied" in line).rstrip("\n")


@pytest.mark.slow
def test_keys_admit_each_role_at_a_plant_and_at_a_router_and_ctrl_c_ends_a_process_at_any_time(
    mdms: Start, small: Small, tmp_path: Path
) -> None:
    scene = small()
    keys = keys_for(scene, tmp_path / "keys")
    expected = run(
        load_scene(str(scene)), RunOptions(0, "memory", output=tmp_path / "near", picture=False), quiet=True
    ).summary
    for name in ("plant", "router"):
        endpoint = f"tls/127.0.0.1:{free_port()}"
        router = None if name == "plant" else mdms("router", "--listen", endpoint, "--keys", keys)
        way = ("--listen" if router is None else "--connect", endpoint)
        options = ("--shards", 2, "--keys", keys, "--no-picture", "--json", "--output", tmp_path / name)
        plant = mdms("plant", scene, *options, *way)
        impatient = mdms(
            "cells", scene, "--shard", "1/2", "--connect", endpoint, "--keys", keys, "--run", "no"
        )
        cells = [
            mdms("cells", scene, "--shard", f"{i}/2", "--connect", endpoint, "--keys", keys / f"cells-{i}")
            for i in (0, 1)
        ]
        insider = rude(endpoint, keys)
        status, stdout, stderr = plant.end(40.0)
        assert status == 0, stderr
        summary = summary_of(stdout)
        assert summary["digest"] == expected.digest
        assert {("shard 0", "drive: encoding"), ("shard 0", "drive: type")} <= {
            (row["whose"], row["what"]) for row in summary["refused"]
        }
        assert [one.end()[0] for one in cells] == [0, 0]
        denied = [] if router is None else [until_denied(router)]
        insider.close()
        for process in (impatient, *([] if router is None else [router])):
            process.process.send_signal(signal.SIGINT)
        assert impatient.end()[0] == 130
        if router is not None:
            status, _, stderr = router.end()
            denied += [line for line in stderr.splitlines() if "denied" in line]
            assert (status, denied) == (0, ["mdms: denied: cells-0: message"])


@pytest.mark.slow
def test_a_run_at_a_router_is_chosen_by_its_name_and_ends_on_request_although_it_waits_for_cells(
    mdms: Start,
    small: Small,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    scene, endpoint = small(), f"tcp/127.0.0.1:{free_port()}"
    at = ("--connect", endpoint)
    router = mdms("router", "--listen", endpoint)
    options = ("--shards", 2, *at, "--no-picture", "--set", "stall.lease_s=0.5")
    plants = {
        name: mdms("plant", scene, *options, "--run", name, "--output", tmp_path / name) for name in "ab"
    }

    def asked(*words: str) -> tuple[int, str]:
        status = main([*words, *at, "--timeout", "0.4"])
        return status, capsys.readouterr().err

    for name, plant in plants.items():
        plant.wait_for(lambda name=name: asked("status", "--run", name)[1] == "", "it waits for its cells")
    several = "there are several runs, name one of them (--run): a, b"
    for words, status in (
        (("status",), 1),
        (("control", "stop"), 2),
        (("registers", "0,0"), 2),
        (("fault", "crash", "0,0"), 2),
    ):
        found, stderr = asked(*words)
        assert (found, several in stderr) == (status, True)
        assert "no run c is here; there are: a, b (--run)" in asked(*words, "--run", "c")[1]
    assert main(["view", "--no-browser", *at]) == 2
    assert several in capsys.readouterr().err
    for words in (("fault", "crash", "0,0"), ("registers", "0,0"), ("control", "step")):
        assert "the run has not begun" in asked(*words, "--run", "a")[1]
    status, _, stderr = mdms("plant", scene, *options, "--run", "a", "--output", tmp_path / "c").end()
    assert (status, "a run a is there already: --run NAME" in stderr) == (2, True)
    for name, plant in plants.items():
        assert asked("control", "stop", "--run", name)[0] == 0
        status, stdout, stderr = plant.end()
        assert status == 130
        assert "stopped by an operator" in stdout
    router.process.send_signal(signal.SIGINT)
    assert router.end()[0] == 0
