"""A run over three hosts: the router on one, the plant on another, cells on two; cut, healed, the router restarted."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from deploy.control.client import discover
from deploy.errors import InputError
from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.workers.plan import RunOptions
from tests.system.hosts import Hosts
from tests.system.joining import command
from tests.system.running import summary_of

Small = Callable[..., Path]
PATIENT = "[stall]\nlease_s = 10.0\ndeadline_s = 20.0\n"
MDMS = [sys.executable, "-m", "deploy.cli"]
SHARDS = {"a": 0, "c": 1}
"""The host of each shard. The router is on host a, the plant on host b."""


@pytest.fixture
def hosts() -> Iterator[Hosts]:
    with Hosts("abc") as made:
        yield made


class Apart:
    """A run of two shards over three hosts."""

    def __init__(self, hosts: Hosts, scene: Path, folder: Path, *options: object) -> None:
        self.hosts, self.scene, self.folder = hosts, scene, folder
        self.router = f"tcp/{hosts.address['a']}:7447"
        self.routers = [self.start_router()]
        self.plant = hosts.start(
            "b",
            [
                *(*MDMS, "plant", scene, "--shards", 2, "--connect", self.router, "--run", "apart"),
                *("--output", folder, "--no-picture", "--json", *options),
            ],
        )
        self.cells = {host: self.start_cells(host) for host in SHARDS}

    def start_router(self) -> subprocess.Popen[str]:
        return self.hosts.start("a", [*MDMS, "router", "--listen", self.router, "--insecure"])

    def start_cells(self, host: str) -> subprocess.Popen[str]:
        return self.hosts.start(host, command(self.scene, self.router, 2, "apart", [SHARDS[host]]))

    def wait_for(self, condition: Callable[[], bool], what: str, timeout_s: float = 30.0) -> None:
        deadline = time.monotonic() + timeout_s
        while not condition():
            assert self.plant.poll() is None, (what, self.plant.communicate())
            assert time.monotonic() < deadline, f"still not after {timeout_s} s: {what}"
            time.sleep(0.02)

    def wait_until_recorded(self, size: int) -> None:
        path = self.folder / "recording.mcap"
        self.wait_for(lambda: path.exists() and path.stat().st_size > size, "the recording grew")

    def asked(self, *command: object) -> subprocess.CompletedProcess[str]:
        """An operator's command on a host."""
        process = self.hosts.start("c", [*MDMS, *command, "--connect", self.router, "--json"])
        stdout, stderr = process.communicate(timeout=20.0)
        return subprocess.CompletedProcess([], process.returncode, stdout, stderr)

    def advertised(self) -> bool:
        try:
            return discover(self.folder).connect == self.router
        except InputError:
            return False


@pytest.mark.slow
def test_a_run_over_three_hosts_has_the_digest_of_one_process_although_a_host_is_cut_and_healed(
    hosts: Hosts, small: Small, tmp_path: Path
) -> None:
    scene = small(PATIENT)
    near = RunOptions(0, "memory", output=tmp_path / "near", picture=False)
    text = load_scene(str(scene)).model_copy(update={"duration_s": 3.0})
    expected = run(text.named(str(scene)), near, quiet=True).summary
    longer = tmp_path / "longer.toml"
    longer.write_text(scene.read_text().replace("duration_s = 0.2", "duration_s = 3.0"))
    apart = Apart(hosts, longer, tmp_path / "out", "--realtime")
    apart.wait_for(apart.advertised, "the plant has found the router")
    apart.wait_until_recorded(12_000)
    hosts.cut("c")
    time.sleep(0.7)
    hosts.heal("c")
    stdout, stderr = apart.plant.communicate(timeout=40.0)
    assert apart.plant.returncode == 0, stderr
    summary = summary_of(stdout)
    assert (summary["status"], summary["cells_lost"], summary["faults"]) == ("ok", [], [])
    assert (summary["messages"]["lost"], summary["messages"]["late"]) == (0, 0)
    assert summary["digest"] == expected.digest
    for cells in apart.cells.values():
        assert cells.communicate(timeout=10.0)[1] == ""
        assert cells.returncode == 0


@pytest.mark.slow
def test_a_router_that_is_restarted_loses_all_cells_by_name_and_they_rejoin_when_started_again(
    hosts: Hosts, small: Small, tmp_path: Path
) -> None:
    scene = small(PATIENT)
    scene.write_text(scene.read_text().replace("duration_s = 0.2", "duration_s = 30.0"))
    apart = Apart(hosts, scene, tmp_path / "out", "--realtime", "--respawn", 4)
    apart.wait_until_recorded(12_000)
    apart.routers[0].kill()
    for cells in apart.cells.values():
        assert "the plant left" in cells.communicate(timeout=10.0)[1]
        assert cells.returncode == 1
    apart.start_router()
    again = [apart.start_cells(host) for host in SHARDS]
    apart.wait_for(lambda: apart.asked("status").returncode == 0, "all cells are back")
    assert apart.asked("control", "speed", "max").returncode == 0
    stdout, stderr = apart.plant.communicate(timeout=30.0)
    assert apart.plant.returncode == 0, stderr
    summary = summary_of(stdout)
    assert (summary["status"], summary["cells_lost"]) == ("ok", []), stderr
    told = [(fault["kind"], fault["cell"]) for fault in summary["faults"] if fault["kind"] != "respawn"]
    assert told == [("disconnected", [row, column]) for row in range(3) for column in range(4)]
    assert sum(len(fault["cells"]) for fault in summary["faults"] if fault["kind"] == "respawn") == 12
    for cells in again:
        assert cells.communicate(timeout=10.0)[1] == ""
