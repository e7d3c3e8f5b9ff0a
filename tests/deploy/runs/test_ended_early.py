"""Runs and simulations that end before their duration: signals within half a second, and all that was reached."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deploy.commands.outcome import EXIT_STATUS
from deploy.recordings.reader import load
from deploy.runs.field_simulation import simulate
from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene
from deploy.util.signals import Interruption
from deploy.workers.plan import RunOptions
from plant import stop

SOON_S = 0.5
STIFF = {"parcels.0.inertia_kg_m2": 1e-9, "duration_s": 100.0}


def _scene(**changes: object) -> Scene:
    values = {key.replace("__", "."): value for key, value in changes.items()}
    return load_scene(
        "elliptic", [Override(_path(key), value, "") for key, value in (STIFF | values).items()]
    )


def _path(key: str) -> tuple[Any, ...]:
    return tuple(int(part) if part.isdigit() else part for part in key.split("."))


@contextmanager
def signal_after(seconds: float, number: signal.Signals) -> Iterator[list[float]]:
    """Send this process a signal in a while; the list then has the processor time of it.

    What runs then is busy: on a machine with nothing else to do that is wall time.
    """
    sent: list[float] = []

    def send() -> None:
        sent.append(time.process_time())
        os.kill(os.getpid(), number)

    timer = threading.Timer(seconds, send)
    timer.start()
    try:
        yield sent
    finally:
        timer.join()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_simulation_in_the_middle_of_a_kernel(number: signal.Signals, tmp_path: Path) -> None:
    simulate(_scene(duration_s=0.001), output=tmp_path, picture=False, quiet=True)  # compiled
    scene = _scene(solver__max_steps_per_s=1e12)
    with signal_after(0.5, number) as sent:
        summary = simulate(scene, output=tmp_path, picture=False, quiet=True).summary
    assert time.process_time() - sent[0] < SOON_S
    assert summary.status == "interrupted"
    assert summary.reason == f"interrupted at {summary.simulated_s:g} s of simulated time"
    assert json.loads((tmp_path / "summary.json").read_text())["ticks"] == summary.ticks
    assert not stop.requested()


def test_a_signal_ends_a_run_in_the_middle_of_a_tick_that_takes_long(tmp_path: Path) -> None:
    # one tick takes seconds
    scene = _scene(solver__max_steps_per_s=1e12, parcels__0__inertia_kg_m2=1e-15)
    options = RunOptions(0, "memory", output=tmp_path, picture=False)
    with signal_after(1.5, signal.SIGINT) as sent:
        summary = run(scene, options, quiet=True).summary
    assert time.process_time() - sent[0] < SOON_S + 0.5  # and the cells are stopped
    assert (summary.status, summary.ticks) == ("interrupted", 0)
    recording = load(tmp_path)
    assert recording.status == "interrupted"
    assert recording.parcels[-1, 0, :3].tolist() == [0.55, 0.5, 0.9]
    assert summary.parcels[0].position_m == (0.55, 0.5)


def test_a_simulation_that_ends_unstable_keeps_and_draws_what_it_reached(tmp_path: Path) -> None:
    # by 0.02 s some thousand steps of a stiff motion are spent
    changes = {"solver__max_steps_per_s": 1e4, "parcels__0__inertia_kg_m2": 1e-7}
    summary = simulate(_scene(**changes), output=tmp_path, quiet=True).summary
    assert (summary.status, EXIT_STATUS[summary.status]) == ("unstable", 3)
    assert summary.ticks > 2
    assert summary.simulated_s == pytest.approx(summary.ticks * 0.004096, abs=1e-12)
    assert f"; the trajectory up to {summary.simulated_s:g} s is valid" in (summary.reason or "")
    assert " at t = 0 s" not in (summary.reason or "")
    same = _scene(**(changes | {"solver__max_steps_per_s": 1e7, "duration_s": summary.simulated_s}))
    whole = simulate(same, output=tmp_path / "whole", picture=False, quiet=True).summary
    assert summary.parcels[0].position_m == whole.parcels[0].position_m
    assert (tmp_path / "overview.png").stat().st_size > 10_000


def test_a_run_that_ends_unstable_keeps_every_tick_before(tmp_path: Path) -> None:
    scene = _scene(solver__max_steps_per_s=1e4, parcels__0__inertia_kg_m2=1e-7)
    summary = run(scene, RunOptions(0, "memory", output=tmp_path, picture=False), quiet=True).summary
    assert summary.status == "unstable"
    assert summary.ticks > 2
    assert f"(tick {summary.ticks})" in (summary.reason or "")
    recording = load(tmp_path)
    assert recording.time_ns[-1] == summary.ticks * 4_096_000
    assert len(recording.time_ns) == summary.ticks + 1
    assert recording.parcels[-1, 0, :2].tolist() == list(summary.parcels[0].position_m)
    assert np.isfinite(recording.parcels).all()


# --- how far a trajectory is valid ------------------------------------------------------------------


def test_a_law_out_of_its_range_is_said_with_the_time_since_when(tmp_path: Path) -> None:
    # stopped wheels: the parcel is faster than any of them from the start
    scene = load_scene(
        "elliptic",
        [
            Override(("friction",), {"law": "coulomb_sliding", "coefficient": 0.05}, ""),
            Override(("cells", "parameters", "field"), {"kind": "uniform", "velocity_m_s": [0.2, 0.1]}, ""),
            Override(("duration_s",), 1.0, ""),
        ],
    )
    by_field = simulate(scene, output=tmp_path / "simulate", picture=False, quiet=True).summary
    whole = run(scene, RunOptions(0, "memory", output=tmp_path / "run", picture=False), quiet=True).summary
    # mu g t = 0.1 m/s along y
    expected = 0.1 / (0.05 * 9.81)
    for summary in (by_field, whole):
        (row,) = summary.law_not_valid
        assert row["parcel"] == 0
        assert row["since_s"] == pytest.approx(expected, abs=1e-6)
        assert summary.captured is None


def test_captured_chatter_is_said_with_what_governs_then(tmp_path: Path) -> None:
    scene = load_scene("elliptic", [Override(("parcels", 0, "size_m"), [0.68, 0.42], "")])
    summary = simulate(scene, output=tmp_path, picture=False, quiet=True).summary
    assert summary.captured == {"capture_m": 1e-6, "parcels": [0]}
    assert summary.law_not_valid == []
    plain = simulate(_scene(duration_s=0.001), output=tmp_path, picture=False, quiet=True).summary
    assert plain.captured is None


def test_a_watch_for_signals_leaves_no_thread_and_no_request_behind() -> None:
    threads = threading.active_count()
    interruption = Interruption()
    with interruption.handling():
        os.kill(os.getpid(), signal.SIGTERM)
        deadline = time.monotonic() + 5.0
        while not stop.requested() and time.monotonic() < deadline:
            time.sleep(0.001)
        assert stop.requested()
    assert threading.active_count() == threads
    assert not stop.requested()
    assert signal.set_wakeup_fd(-1) == -1


def test_a_traceback_that_all_cells_have_is_kept_once(tmp_path: Path) -> None:
    (tmp_path / "fails.py").write_text("""
from mdms import CellFirmware

class Fails(CellFirmware):
    def init(self, cell):
        return cell.column

    def step(self, state, inputs):
        raise ValueError(state // 2)
""")
    array, cells = {"rows": 4, "columns": 4}, {"firmware": str(tmp_path / "fails.py")}
    scene = _scene(duration_s=0.1, cells=cells, array=array, parcels__0__position_m=[0.0, 0.0])
    options = RunOptions(output=tmp_path / "out", picture=False, processes=0, transport="memory")
    summary = run(scene, options, quiet=True).summary
    assert summary.status == "failed"
    assert [fault["cell"] for fault in summary.faults] == [
        [row, column] for row in range(4) for column in range(4)
    ]
    details = [fault["detail"].splitlines() for fault in summary.faults]
    whole = [number for number, lines in enumerate(details) if "Traceback (most recent call last):" in lines]
    assert whole == [0, 2]  # of a column each, the first of two with that number
    assert [lines[0] for lines in details] == 4 * [
        "ValueError: 0",
        "ValueError: 0",
        "ValueError: 1",
        "ValueError: 1",
    ]
    assert [lines[-1] for lines in details] == [lines[0] for lines in details]
