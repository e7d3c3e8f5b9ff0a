"""Values on the page beside those of the recording: messages, forces, quantities over time, absent parcels."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from deploy.recordings.reader import load
from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.view.colouring import Colouring
from deploy.view.commands import handle
from deploy.view.forces import WheelForces
from deploy.view.geometry import CellGrid
from deploy.view.inspector import _register_sections, parcel_facts
from deploy.view.layers import Scenery, sending_sides
from deploy.view.outcomes import Outcomes
from deploy.view.palette import LIGHT
from deploy.view.quantity_series import QuantitySeries
from deploy.view.replay import ReplaySource
from deploy.view.source import RunSource
from deploy.workers.plan import RunOptions
from tests.deploy.view.test_view_parts import CELLS, PLACES, instant


def test_messages_are_shown_of_a_recording_without_registers(tmp_path: Path) -> None:
    scene = load_scene("heat", [Override(("duration_s",), 0.05, "")])
    run(scene, RunOptions(0, "memory", output=tmp_path, picture=False, messages=1), quiet=True)
    shown = ReplaySource(load(tmp_path))
    assert shown.registers(0) == (0.0, {})
    time_s, found = shown.registers(7)
    assert time_s == pytest.approx(shown.times_s[7])
    assert set(found) == {"message.sent", "message.vx_m_s", "message.vy_m_s"}
    assert shown.register_names() == []
    assert "Inbox" in {one["name"] for one in _register_sections(found, 0, time_s, {"north": 20, "east": 1})}


def test_messages_are_marked_on_the_sides_of_the_last_tick_where_they_are_known() -> None:
    sent = np.zeros((4, 4))
    sent[0, 1] = 1.0  # to the east alone
    sent[3] = np.nan  # is dead
    counts = {0: np.array([1, 1, 5, 0]), 1: np.array([2, 2, 5, 0])}
    known: dict[int, dict[str, Any]] = {index: {"messages.sent": counts[index]} for index in counts}
    fake: Any = SimpleNamespace(
        registers=lambda index: (float(index), known[index]), times_s=np.array([0.0, 1.0])
    )
    scene = Scenery(fake, CellGrid(CELLS, PLACES, 0.1), (), 1, instant(1), np.arange(4), 1.0, fake)
    assert sending_sides(scene).any(axis=1).tolist() == [True, True, False, False]
    known[1]["message.sent"] = sent
    assert sending_sides(scene)[0].tolist() == [False, True, False, False]
    assert sending_sides(scene)[1:].tolist() == [[True] * 4, [False] * 4, [False] * 4]


# --- quantities over time --------------------------------------------------------------------------


def test_every_quantity_of_a_cell_is_plotted_coarse_first_as_the_recording_has_it(tmp_path: Path) -> None:
    fault = Override.parse("faults=[{kind='wheel_stuck',at_s=0.3,cell=[14,15]}]")
    scene = load_scene("elliptic", [Override(("duration_s",), 0.8, ""), fault])
    run(scene, RunOptions(0, "memory", output=tmp_path, picture=False), quiet=True)
    recording = load(tmp_path)
    cell = recording.header["cells"].index([14, 15])
    found = QuantitySeries(ReplaySource(recording))
    found.advance("load", 0.0)
    assert found.series("load", cell).time_s.tolist() == [0.0]
    found.advance("load", 0.0)
    assert found.series("load", cell).time_s.tolist() == [0.0, recording.time_s[128]]
    found.advance("load", 60.0)
    series = found.series("load", cell)
    rows = list(range(0, len(recording.tick), 2))
    assert series.time_s.tolist() == recording.time_s[rows].tolist()
    assert series.values[:, 0].tolist() == [recording.tractions(row).load_n[cell] for row in rows]
    assert np.ptp(series.values) > 0.5, "the parcel leaves the cell"
    assert (series.title, series.unit, series.names) == ("load of cell 14,15", "N", ("load",))
    found.advance("fault", 60.0)
    series = found.series("fault", cell)
    assert series.title == "fault of cell 14,15 (0 none, 1 active)"
    assert series.values[:, 0].tolist() == (series.time_s >= 0.3).astype(float).tolist()
    for name, label in (
        ("speed", "wheel speed"),
        ("slip", "slip"),
        ("sensor", "sensor"),
        ("health", "health"),
    ):
        found.advance(name, 60.0)
        assert found.series(name, 0).names == (label,)
        assert len(found.series(name, 0).values) == len(rows)


def test_forces_are_those_of_the_instant_once_the_viewer_stays_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = load_scene("elliptic", [Override(("duration_s",), 0.4, "")])
    run(scene, RunOptions(0, "memory", output=tmp_path, picture=False), quiet=True)
    recording = load(tmp_path)
    shown = ReplaySource(recording)
    forces, clock = WheelForces(shown, rest=1e9), [0.0]
    monkeypatch.setattr("deploy.view.forces.time", SimpleNamespace(perf_counter=lambda: clock[0]))
    loads = [recording.tractions(row).load_n for row in (0, 90)]
    assert not np.array_equal(*loads)
    clock[0] = 1.0
    assert np.array_equal(forces.loads_n(shown.at(0)), loads[0])
    forces._next_s = 1e9  # it took long
    assert np.array_equal(forces.loads_n(shown.at(90)), loads[0]), "the values before, while instants pass by"
    clock[0] = 1.3
    assert np.array_equal(forces.loads_n(shown.at(90)), loads[1])
    before = forces._last
    forces.loads_n(shown.at(90))
    assert forces._last is before, "computed once"
    colouring = Colouring(shown, forces.quantities, WheelForces(shown, rest=0.0).quantities)
    colouring.choose("load")
    sampled = np.unique(np.linspace(0, len(recording.tick) - 1, 24).astype(np.int64)).tolist()
    assert colouring.legend(LIGHT)["high"] == max(recording.tractions(row).load_n.max() for row in sampled)


def test_a_parcel_that_is_not_there_is_named_so_and_keys_say_that_there_is_none() -> None:
    square = [[-1.0, -1], [1, -1], [1, 1], [-1, 1]]
    run_of: Any = SimpleNamespace(header={"footprints_m": [square, square], "cells": CELLS})
    shown = replace(instant(1), parcels=np.array([[np.nan] * 6, [0.0, 0, 0, 0, 0, 0]]))
    titles = [
        parcel_facts(run_of, CellGrid(CELLS, PLACES, 0.1), shown, number, [0.0] * 4)["title"]
        for number in (0, 1)
    ]
    assert titles == ["Parcel 0, not on the array", "Parcel 1"]
    events = [
        {"kind": "support_lost", "parcel": 1, "time_s": 0.1},
        {"kind": "off_array", "parcel": 1, "time_s": 0.2},
    ]
    outcomes = Outcomes(cast("RunSource", SimpleNamespace(events=events, revision=0)))
    assert [outcomes.at(time_s, 1) for time_s in (0.1, 0.2, 9.0)] == [None, "off the array", "off the array"]
    events.append({"kind": "left", "parcel": 0, "time_s": 0.3})
    assert (outcomes.at(0.3, 0), outcomes.at(0.2, 0)) == ("delivered", None)
    facts = parcel_facts(run_of, CellGrid(CELLS, PLACES, 0.1), shown, 1, [0.0] * 4, "off the array")
    assert facts["title"] == "Parcel 1, off the array"
    assert facts["sections"][2] == {"name": "Supports (0)", "rows": []}
    said: list[str] = []
    session: Any = SimpleNamespace(instant=lambda: None, notify=said.append)
    handle(session, {"op": "next_parcel"})
    assert said == ["there is no parcel on the array at this instant"]
