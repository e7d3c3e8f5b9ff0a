"""``mdms campaign`` and ``mdms run`` with ``--cluster``: results as on one machine, whatever happens to a worker."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from deploy.cli import main
from tests.system.dask_processes import Dask, credentials, dask_cluster
from tests.system.running import Mdms, is_alive, summary_of
from tests.system.small import small_scene

pytest.importorskip("distributed")
pytestmark = [pytest.mark.slow, pytest.mark.timeout(120)]

PROGRAM = '''
from pathlib import Path
from cell_firmware.cell import CellFirmware, CellOutputs

class Program(CellFirmware):
    """Counts runs: a line of a file for each that was begun."""

    def init(self, cell):
        if (cell.row, cell.column) == (0, 0):
            with Path(__file__).with_name("begun").open("a") as file:
                file.write("x\\n")
        return 0

    def step(self, state, inputs):
        return state + 1, CellOutputs(speed_m_s=(0.1, 0.0))
'''
SEEDS = 12
ASKED = ("--seeds", str(SEEDS), "--duration", "0.3", "--within", "9", "--no-picture")
VARIED = ("--vary", "parcels.0.mass_kg=1.0,2.0", "--against", "parcels.0.mass_kg=1.0")
LEFT = ("campaign.csv", "campaign.json")


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene whose program counts the runs that were begun."""
    folder = tmp_path_factory.mktemp("scene")
    (folder / "program.py").write_text(PROGRAM)
    path = folder / "scene.toml"
    path.write_text(
        f"""
duration_s = 1.0
[array]
rows = 4
columns = 6
[cells]
firmware = "{folder / "program.py"}:Program"
[[parcels]]
size_m = [0.25, 0.15]
mass_kg = 1.0
position_m = [0.0, 0.0]
[friction]
law = "viscous"
coefficient_s_per_m = 0.2
"""
    )
    return path


@pytest.fixture(scope="module")
def dask(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Dask]:
    """A cluster over TLS, whose credentials the environment names."""
    folder = tmp_path_factory.mktemp("dask")
    with credentials(folder) as options, dask_cluster(folder, 2, options) as cluster:
        yield cluster


@pytest.fixture(scope="module")
def whole(scene: Path) -> Path:
    """Folder of the campaign in one process of this machine."""
    folder = scene.parent / "whole"
    arguments = (str(scene), *ASKED, *VARIED, "--jobs", "1", "--output", str(folder), "--quiet")
    assert main(["campaign", *arguments]) == 0
    return folder


def begun(scene: Path) -> int:
    """How many runs were begun so far."""
    return (scene.parent / "begun").read_text().count("x")


def digests(folder: Path) -> dict[str, str]:
    """Digest of every run and baseline run."""
    lines = [json.loads(line) for line in (folder / "runs.jsonl").read_text().splitlines()]
    return {
        line.get("baseline") or f"{line['case']}-{line['seed']}": line.get("ending", line)["digest"]
        for line in lines
    }


def test_a_killed_worker_costs_its_runs_in_flight_and_nothing_is_done_twice(
    scene: Path, whole: Path, dask: Dask, tmp_path: Path, mdms: Callable[..., Mdms]
) -> None:
    assert len(digests(whole)) == 3 * SEEDS
    folder, before = tmp_path / "cut", begun(scene)
    running = mdms("campaign", scene, *ASKED, *VARIED, "--cluster", dask.file, "--output", folder)
    journal = folder / "runs.jsonl"
    running.wait_for(
        lambda: journal.exists() and journal.read_bytes().count(b"\n") > SEEDS, "a third was over", 60.0
    )
    victim = dask.workers.pop()
    victim.kill()
    victim.wait()
    status, _, stderr = running.end(60.0)
    assert status == 0, stderr
    assert f"Dask scheduler {dask.address}, 2 workers, dashboard http://127.0.0.1:" in stderr
    # the victim's run, and one whose end nobody had heard of
    assert begun(scene) - before - 3 * SEEDS <= 2
    assert digests(folder) == digests(whole)
    for name in LEFT:
        assert (folder / name).read_bytes() == (whole / name).read_bytes()

    dask.add_worker()
    dask.wait()
    before, done = begun(scene), journal.read_bytes()
    assert main(["campaign", "--resume", str(folder), "--cluster", dask.address, "--quiet"]) == 0
    assert begun(scene) == before
    assert journal.read_bytes() == done


def test_without_credentials_nobody_uses_the_cluster(
    scene: Path, dask: Dask, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mdms: Callable[..., Mdms]
) -> None:
    assert dask.address.startswith("tls://127.0.0.1:")
    for name in [name for name in os.environ if name.startswith("DASK_")]:
        monkeypatch.delenv(name)
    running = mdms("campaign", scene, *ASKED, *VARIED, "--cluster", dask.address, "--output", tmp_path / "no")
    status, _, stderr = running.end()
    assert status == 2
    assert "set Dask's credentials (docs/clusters.md)" in stderr


def test_a_worker_that_would_have_other_bits_is_refused_by_name(
    scene: Path, dask: Dask, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = dask.add_worker({"NUMBA_CPU_NAME": "generic"})
    dask.wait()
    output = ("--output", str(tmp_path / "out"), "--cluster", dask.address)
    assert main(["campaign", str(scene), *ASKED, *VARIED, *output]) == 2
    said = capsys.readouterr().err
    assert "differs, and so would its digests: " in said
    assert "processor level generic, not " in said
    other.kill()
    other.wait()
    dask.workers.remove(other)
    assert not (tmp_path / "out" / "runs.jsonl").exists() or not (tmp_path / "out" / "runs.jsonl").read_text()


def test_an_interrupted_campaign_on_a_cluster_of_its_own_leaves_nothing_and_listens_on_loopback_alone(
    scene: Path, whole: Path, tmp_path: Path, mdms: Callable[..., Mdms]
) -> None:
    folder = tmp_path / "own"
    arguments = (*ASKED, *VARIED, "--cluster", "local", "--jobs", "2", "--output", folder)
    running = mdms("campaign", scene, *arguments)
    journal = folder / "runs.jsonl"
    running.wait_for(
        lambda: journal.exists() and journal.read_bytes().count(b"\n") > 5, "five runs were over", 60.0
    )
    assert listening(running.children() | {running.process.pid}) == {"127.0.0.1"}
    os.killpg(running.process.pid, signal.SIGINT)  # as Ctrl-C in a terminal does
    status, _, stderr = running.end()
    assert status == 130, stderr
    assert "Traceback" not in stderr
    assert "dashboard http://127.0.0.1:" in stderr
    before, done = begun(scene), journal.read_bytes()
    assert main(["campaign", "--resume", str(folder), "--quiet"]) == 0
    assert begun(scene) - before == 3 * SEEDS - done.count(b"\n")
    assert journal.read_bytes().startswith(done)
    assert digests(folder) == digests(whole)


@pytest.mark.nightly
def test_a_killed_campaign_goes_on_with_the_same_workers(
    scene: Path, whole: Path, dask: Dask, tmp_path: Path, mdms: Callable[..., Mdms]
) -> None:
    folder = tmp_path / "killed"
    running = mdms("campaign", scene, *ASKED, *VARIED, "--cluster", dask.address, "--output", folder)
    journal = folder / "runs.jsonl"
    running.wait_for(
        lambda: journal.exists() and journal.read_bytes().count(b"\n") > 3, "three runs were over", 60.0
    )
    running.process.kill()
    running.end()
    assert main(["campaign", "--resume", str(folder), "--cluster", dask.address, "--quiet"]) == 0
    assert digests(folder) == digests(whole)
    assert all(is_alive(worker.pid) for worker in dask.workers)


# --- one run, its shards on the cluster -----------------------------------------------------------


@pytest.fixture(scope="module")
def coupled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Scene of cells that talk, which ends where a process of cells is lost."""
    path = tmp_path_factory.mktemp("coupled") / "coupled.toml"
    path.write_text(small_scene(duration_s=3.0) + '\n[stall]\npolicy = "abort"\n')
    return path


def ran(arguments: list[object], capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    """Summary of a run that is to end well."""
    assert main(["run", *map(str, arguments), "--no-picture", "--json", "--quiet"]) == 0
    return summary_of(capsys.readouterr().out)


def test_a_run_whose_dask_worker_is_killed_resumes_to_the_digest_of_one_process(
    coupled: Path, dask: Dask, tmp_path: Path, mdms: Callable[..., Mdms], capsys: pytest.CaptureFixture[str]
) -> None:
    whole = ran([coupled, "--processes", "0", "--output", tmp_path / "whole"], capsys)
    placed = ("--processes", "2", "--cluster", dask.address)
    there = ran([coupled, *placed, "--output", tmp_path / "there"], capsys)
    assert there["digest"] == whole["digest"]

    folder = tmp_path / "cut"
    more = ("--realtime", "--checkpoint", "0.2", "--no-picture", "--json")
    running = mdms("run", coupled, *placed, *more, output=folder)
    running.wait_for((folder / "checkpoint.msgpack").exists, "a checkpoint was written", 60.0)
    victim = dask.workers.pop()
    victim.kill()
    victim.wait()
    status, stdout, stderr = running.end()
    assert status == 1, stderr
    assert 0 < summary_of(stdout)["ticks"] < whole["ticks"]

    dask.add_worker()
    dask.wait()
    resumed = ran(["--resume", folder, "--cluster", dask.address], capsys)
    assert resumed["resumed"]
    assert (resumed["digest"], resumed["ticks"]) == (whole["digest"], whole["ticks"])


def test_a_cluster_with_fewer_workers_than_shards_is_refused(
    coupled: Path, dask: Dask, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = ("--output", str(tmp_path / "out"), "--cluster", dask.address)
    assert main(["run", str(coupled), *output, "--processes", "3"]) == 2
    assert "has 2 workers for 3 shards, and each shard needs a worker of its own" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert main(["run", str(coupled), *output]) == 2
    assert "needs --processes N, the number of shards" in capsys.readouterr().err
    assert main(["run", str(coupled), *output, "--processes", "2", "--respawn", "1"]) == 2
    assert "--respawn: doesn't go with --cluster" in capsys.readouterr().err


def listening(pids: set[int]) -> set[str]:
    """Addresses on which processes listen over IP."""
    import psutil

    processes = [psutil.Process(pid) for pid in pids if is_alive(pid)]
    sockets = [socket for process in processes for socket in process.net_connections("inet")]
    return {socket.laddr.ip for socket in sockets if socket.status == psutil.CONN_LISTEN}
