"""Cells can be looked into: while the system runs, and later."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from bus.transports.zenoh.endpoint import free_port  # pyright: ignore[reportPrivateUsage]
from deploy.cli import main
from deploy.control.client import discover
from deploy.control.registers import read_registers
from deploy.recordings.reader import load
from tests.system.running import Mdms


@pytest.mark.slow
def test_registers_are_recorded_after_the_ticks_asked_for_whoever_computes_them(
    mdms: Callable[..., Mdms], tmp_path: Path
) -> None:
    recorded: list[list[bytes]] = []
    digests: set[str | None] = set()
    for processes in ("0", "2"):
        running = mdms(
            "run", "motors", "--duration", "0.1", "--no-picture", "--processes", processes, "--registers", "10",
            output=tmp_path / processes,
        )  # fmt: skip
        assert running.end()[0] == 0
        run = load(running.output)
        assert run.register_tick.tolist() == [0, 10, 20]
        recorded.append([array.tobytes() for array in run.registers.values()])
        digests.add(run.digest)
    assert recorded[0] == recorded[1]
    unseen = mdms("run", "motors", "--duration", "0.1", "--no-picture", "--json").end()[1]
    assert digests == {json.loads(unseen)["digest"]}


@pytest.mark.slow
def test_the_recorded_integral_is_the_one_that_made_the_drives(mdms: Callable[..., Mdms]) -> None:
    running = mdms("run", "motors", "--duration", "0.1", "--no-picture", "--processes", "2", "--registers")
    assert running.end()[0] == 0
    run = load(running.output)
    assert run.register_tick.tolist() == list(range(25))
    integral, speed = run.registers["speed_loop.integral_v"], run.registers["firmware.speed_m_s"]
    assert integral.shape == speed.shape == (25, 18, 2)
    error = np.diff(integral, axis=0) / (
        200.0 * 0.004096
    )  # what the integral grew by, over ki and the period
    np.testing.assert_allclose(run.drives[1:25], 12.0 * error + integral[1:], atol=1e-12)


@pytest.mark.slow
def test_a_running_system_shows_its_cells(mdms: Callable[..., Mdms], tmp_path: Path) -> None:
    listen = f"tcp/127.0.0.1:{free_port()}"
    running = mdms(
        "run",
        "motors",
        "--duration",
        "600",
        "--realtime",
        "--no-picture",
        "--processes",
        "2",
        "--listen",
        listen,
    )
    running.wait_until_recorded()
    status, stdout, stderr = mdms("registers", "2,5", "0,0", "--json", "--connect", listen).end()
    assert (status, stderr) == (0, "")
    seen = json.loads(stdout)
    assert list(seen["cells"]) == ["0,0", "2,5"]
    assert len(seen["cells"]["2,5"]["speed_loop.integral_v"]) == 2
    folder = next(path for path in tmp_path.rglob("recording.mcap")).parent
    status, stdout, _ = mdms("registers", "--run", folder).end()
    assert status == 0
    assert "18 cells" in stdout
    assert "speed_loop.integral_v" in stdout
    status, _, stderr = mdms("registers", "9,9", "--timeout", "1", "--connect", listen).end()
    assert (status, stderr.startswith("cell 9,9: not in run motors-")) == (2, True)
    running.process.send_signal(signal.SIGINT)
    assert running.end()[0] == 130


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("9x", "--connect", "tcp/127.0.0.1:1"), "9x: must be a cell's row and column, such as 1,2"),
        (("--connect", "tcp/127.0.0.1:1", "--timeout", "0.3"), "no answer"),
        (("--run", "none"), "--run none: no run in progress writes there"),
        (("--run", "a/b", "--connect", "tcp/127.0.0.1:1"), "--run: with --connect it is the name of a run"),
        (("--connect", "tcp/127.0.0.1:1", "--timeout", "-1"), "--timeout -1: must be greater than 0"),
    ],
)
def test_what_cannot_be_looked_at_is_said_in_a_line(
    arguments: tuple[str, ...], words: str, mdms: Callable[..., Mdms]
) -> None:
    status, stdout, stderr = mdms("registers", *arguments).end()
    assert (status, stdout) == (2, "")
    assert words in stderr
    assert stderr.count("\n") == 1


@pytest.mark.slow
def test_a_paused_run_shows_its_cells_too(mdms: Callable[..., Mdms], tmp_path: Path) -> None:
    running = mdms("run", "motors", "--paused", "--no-picture", "--processes", "2", output=tmp_path / "run")
    running.wait_for((tmp_path / "run" / "live.json").exists, "its address was there")
    assert main(["control", "step", "30", "--run", str(tmp_path / "run"), "--timeout", "30"]) == 0
    seen = read_registers(discover(tmp_path / "run").connect, [(0, 0)], 10.0)
    assert seen.tick == 29
    assert (0, 0) in seen.cells
    running.process.send_signal(signal.SIGINT)
    assert running.end()[0] == 130
