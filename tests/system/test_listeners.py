"""Whoever only listens to a run holds nobody up and loses nobody, whatever they do."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.workers.plan import RunOptions
from tests.system.running import ROOT, Mdms, summary_of
from tests.system.small import small_scene

pytestmark = pytest.mark.slow

DURATION_S = 3.0
"""733 ticks: 16 kB a tick of drives alone, three times what the links of a listener that never reads hold."""

SPEED = 0.24
"""Of the wall clock's: the run lasts 12.5 s, longer than the lease of a stopped listener, 10 s in a plain client."""

ONE_THREAD = (
    "(rx: (worker_threads: 1), tx: (handover: rx), acc: (handover: rx), net: (handover: rx), "
    "app: (handover: rx))"
)
"""Zenoh's threads in the plant's process at their fewest: whatever blocks one of them blocks all sessions."""

Listening = Callable[[str, str], "subprocess.Popen[str]"]


@pytest.fixture
def listening() -> Iterator[Listening]:
    """Starts a listener at an endpoint, which does as it is told."""
    started: list[subprocess.Popen[str]] = []

    def start(connect: str, how: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-m", "tests.system.listener", connect, how],
            cwd=ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


def address(running: Mdms) -> str:
    """Where a run can be listened to."""
    note = running.output / "live.json"
    running.wait_for(note.exists, "it was said where the run can be listened to", 60.0)
    return str(json.loads(note.read_text())["connect"])


def thousand(folder: Path) -> Path:
    """A scene of 1,002 cells that talk."""
    path = folder / "thousand.toml"
    path.write_text(small_scene(columns=334, duration_s=DURATION_S))
    return path


def test_a_listener_that_never_reads_and_one_that_is_stopped_cost_a_packed_run_of_1000_cells_nothing(
    mdms: Callable[..., Mdms], listening: Listening, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ZENOH_RUNTIME", ONE_THREAD)
    scene = thousand(tmp_path)
    running = mdms(
        "run", scene, "--processes", 2, "--wire", "packed", "--no-picture", "--json", "--realtime", SPEED
    )
    connect = address(running)
    listeners = [listening(connect, how) for how in ("never", "stops", "reads")]
    reader = listeners[-1]
    assert all(one.stdout is not None and one.stdout.readline() for one in listeners), "one heard nothing"
    status, stdout, stderr = running.end(90.0)
    assert status == 0, stderr
    summary = summary_of(stdout)
    assert (summary["cells_lost"], summary["messages"]["lost"], summary["messages"]["late"]) == ([], 0, 0)
    alone = run(
        load_scene(str(scene)), RunOptions(0, "memory", output=tmp_path / "alone", picture=False), quiet=True
    ).summary
    assert summary["digest"] == alone.digest
    heard = json.loads(reader.communicate("", timeout=20.0)[0].splitlines()[-1])
    leaves = {key.partition("/")[2].partition("/")[2]: row for key, row in heard.items()}
    assert set(leaves) >= {
        "plant/control",
        *(f"shard/{shard}/{leaf}" for shard in (0, 1) for leaf in ("sense", "drive")),
        "shard/0/to/1",
        "shard/1/to/0",
    }
    number, first, last = leaves["shard/0/drive"]
    assert (last, number) == (summary["ticks"] - 1, last - first + 1)
