"""``mdms diff``: the first tick, cell and quantity in which two recordings differ, and what was compared."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deploy.cli import main
from deploy.recordings.writer import Recorder

Make = Callable[..., Any]


@pytest.fixture
def made(made_up_run: Make) -> Make:
    """Makes a run whose numbers change in every tick."""
    return lambda **settings: made_up_run(wheels_change=True, **settings)


def differ(folder: Path, one: Any, other: Any, *options: str) -> int:
    for name, run in (("a", one), ("b", other)):
        if run is not None:
            (folder / name).mkdir()
            run.record(folder / name)
    return main(["diff", str(folder / "a"), str(folder / "b"), *options])


def test_equal_recordings_have_no_difference_and_status_0(
    made: Make, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert differ(tmp_path, made(), made()) == 0
    assert capsys.readouterr().out.splitlines() == [
        "no difference in 13 instants",
        "compared: parcels, wheel speeds, presence, drives, events, faults, commands; 13 instants",
    ]


@pytest.mark.parametrize(
    ("quantity", "where", "said"),
    [
        ("drives", (5, 7, 1), "tick 5 (0.02048 s), cell 1,3, drives, y"),
        ("wheel_speeds", (12, 0, 0), "tick 12 (0.049152 s), cell 0,0, wheel speeds, x"),
        ("presence", (0, 11, 1), "tick 0 (0 s), cell 2,3, presence, sensor 1"),
        ("states", (3, 0, 2), "tick 3 (0.012288 s), parcel 0, parcels, angle_rad"),
    ],
)
def test_the_last_bit_of_one_number_is_found_with_both_values(
    quantity: str,
    where: tuple[int, ...],
    said: str,
    made: Make,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    one, other = made(), made()
    numbers = getattr(other, quantity)
    numbers[where] = ~numbers[where] if quantity == "presence" else np.nextafter(numbers[where], 9.0)
    assert differ(tmp_path, one, other) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"first difference: {said}"
    values = [getattr(run, quantity)[where].item() for run in (one, other)]
    assert lines[1:3] == [f"  A: {values[0]!r}", f"  B: {values[1]!r}"]
    assert lines[3].startswith("compared:")


def test_the_first_of_several_is_the_earliest_and_in_a_tick_the_cause(
    made: Make, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one, other = made(), made()
    other.drives[4:, 2] += 1.0
    other.presence[4, 9, 0] ^= True
    other.states[6:, 0] += 1.0
    assert differ(tmp_path, one, other, "--json") == 1
    found = json.loads(capsys.readouterr().out)
    order = [(each["quantity"], each["tick"], each["cell"], each["parcel"]) for each in found["differences"]]
    assert order == [
        ("presence", 4, [2, 1], None),
        ("drives", 4, [0, 2], None),
        ("parcels", 6, None, 0),
    ]
    assert found["first"] == found["differences"][0]
    assert found["differences"][1]["places"] == 2
    assert not found["same"]


def test_minus_zero_is_zero_as_in_the_digest(made: Make, tmp_path: Path) -> None:
    one, other = made(), made()
    one.drives[2, 2], other.drives[2, 2] = 0.0, -0.0
    assert differ(tmp_path, one, other) == 0


def test_registers_and_messages_are_compared_where_both_have_them(
    made: Make, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, level in (("a", 5.0), ("b", 6.0), ("c", None)):
        run = made(ticks=4)
        (tmp_path / name).mkdir()
        recorder = Recorder(tmp_path / name, run.header)
        run.feed(recorder)
        if level is not None:
            values = np.zeros((12, 2))
            values[:, 1] = np.nan
            for tick in range(3):
                values[3, 0] = level if tick else 0.0
                recorder.registers(tick, tick * 4_096_000, {"level": values})
        recorder.close("ok")
    assert main(["diff", str(tmp_path / "a"), str(tmp_path / "b")]) == 1
    said = capsys.readouterr().out
    assert said.startswith(
        "first difference: tick 1 (0.004096 s), cell 0,3, register level, 0\n  A: 5.0\n  B: 6.0\n"
    )
    assert main(["diff", str(tmp_path / "a"), str(tmp_path / "c")]) == 0
    assert "not compared: registers: recorded in the first only" in capsys.readouterr().out


def test_a_shorter_recording_differs_though_all_common_ticks_agree(
    made: Make, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short = made()
    short.ticks = 7
    assert differ(tmp_path, made(), short) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[:2] == ["no difference in 8 instants", "A ends with tick 12, B with tick 7"]


def test_scenes_that_differ_are_named_and_do_not_count(
    made: Make, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = made(
        extra={"scene": {"duration_s": 1.0, "cells": {"firmware": "b.py", "label": None}, "faults": []}}
    )
    assert differ(tmp_path, made(), other) == 0
    assert "the scenes differ in 1 value:\n  cells.firmware: absent and 'b.py'\n" in capsys.readouterr().out


def test_events_and_faults_are_compared(
    made: Make, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fault = {"time_s": 0.0, "kind": "crash", "cell": [0, 0]}
    assert differ(tmp_path, made(faults=[fault]), made(faults=[{**fault, "cell": [0, 1]}])) == 1
    assert capsys.readouterr().out.splitlines()[:3] == [
        "first difference: tick 0 (0 s), faults, number 0",
        f"  A: {fault!r}",
        f"  B: { ({**fault, 'cell': [0, 1]})!r}",
    ]


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"columns": 5}, "not compared: all of the cells: there are 12 and 15, or others"),
        ({"parcels": 2}, "not compared: parcels: there are 1 and 2"),
        ({"sensors": 1}, "not compared: presence: the cells have other sensors"),
        ({"extra": {"period_ns": 8_192_000}}, "not compared: all ticks: they last 0.004096 s and 0.008192 s"),
    ],
)
def test_what_can_not_be_compared_is_a_difference_and_is_said(
    settings: dict[str, Any], said: str, made: Make, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert differ(tmp_path, made(), made(**settings)) == 1
    assert said in capsys.readouterr().out.splitlines()


def test_a_recording_that_is_not_there_is_bad_input(tmp_path: Path, made: Make) -> None:
    assert differ(tmp_path, made(), None) == 2
