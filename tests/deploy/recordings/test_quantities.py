"""Cells and parcels in and out of action at the times of a recording, and the tractions of a recorded run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deploy.recordings.quantities import Conditions, plant_spec
from deploy.recordings.reader import load
from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.workers.plan import RunOptions

CELLS = [[0, 0], [0, 1], [0, 2], [1, 0]]


def _conditions(
    faults: list[dict[str, Any]] | None = None,
    events: list[dict[str, Any]] | None = None,
    policy: str = "coast",
    scene_faults: tuple[dict[str, Any], ...] = (),
    own: int = 2,
) -> Conditions:
    header: Any = {
        "cells": CELLS,
        "period_ns": 4_096_000,
        "footprints_m": [[], [], []],
        "own_parcels": own,
        "scene": {"stall": {"policy": policy}, "faults": scene_faults},
    }
    return Conditions(header, events or [], faults or [])


def _lasting(kind: str, phase: str, time_s: float, cells: list[list[int]], **more: object) -> dict[str, Any]:
    return {
        "time_s": time_s,
        "kind": kind,
        "phase": phase,
        "cells": cells,
        "number": 0,
        "fault": {"kind": kind, "at_s": 0.0, **more},
    }


def test_wheels_of_lost_cells_turn_freely_until_they_rejoin() -> None:
    found = _conditions(
        [
            {"time_s": 1.0, "kind": "timed_out", "cell": [0, 1]},
            {"time_s": 2.0, "kind": "respawn", "phase": "happens", "cells": [[0, 1]]},
        ]
    )
    assert found.cells(0.9)[0].tolist() == [False] * 4
    assert found.cells(1.0)[0].tolist() == [False, True, False, False]
    assert found.cells(2.0)[0].tolist() == [False] * 4


@pytest.mark.parametrize("policy", ["brake", "hold"])
def test_wheels_that_brake_or_hold_are_driven(policy: str) -> None:
    lost = {"time_s": 1.0, "kind": "timed_out", "cell": [0, 1]}
    assert not _conditions([lost], policy=policy).cells(5.0)[0].any()
    crash = {"kind": "crash", "at_s": 1.0, "cell": [0, 1], "wheels": policy}
    dead = {"time_s": 245 * 4_096_000 * 1e-9, "kind": "crash", "cell": [0, 1]}
    assert not _conditions([dead], scene_faults=(crash,)).cells(5.0)[0].any()
    assert _conditions([dead]).cells(5.0)[0].any()


def test_crashes_and_removals_that_end_are_over_at_their_end() -> None:
    crash = [
        _lasting("crash", phase, at, [[0, 2]], cell=[0, 2]) for phase, at in (("begins", 1.0), ("ends", 2.0))
    ]
    assert _conditions(crash).cells(1.0)[0].tolist() == [False, False, True, False]
    assert not _conditions(crash).cells(2.0)[0].any()
    pulled = [
        _lasting("remove", phase, at, [[1, 0]], cell=[1, 0]) for phase, at in (("begins", 1.0), ("ends", 2.0))
    ]
    _, absent = _conditions(pulled).cells(1.5)
    assert absent.tolist() == [False, False, False, True]
    assert not _conditions(pulled).cells(2.0)[1].any()
    weak = _lasting("wheel_weak", "begins", 1.0, [[1, 0]], cell=[1, 0], strength=0.5)
    assert not np.any(_conditions([weak]).cells(1.5))


def test_wheels_carry_parcels_from_feed_to_exit_or_fall() -> None:
    events = [
        {"time_s": 1.0, "kind": "fed", "parcel": 2},
        {"time_s": 2.0, "kind": "tipped", "parcel": 0},
        {"time_s": 3.0, "kind": "left", "parcel": 2},
        {"time_s": 4.0, "kind": "off_array", "parcel": 1},
    ]
    found = _conditions(events=events)
    assert [found.carried(at) for at in (0.0, 1.0, 2.0, 3.0, 4.0)] == [[0, 1], [0, 1, 2], [1, 2], [1], []]


def test_a_recorded_instant_has_the_loads_and_tractions_of_its_scene(tmp_path: Path) -> None:
    sets = ("duration_s=0.05", "faults=[{ kind = 'crash', at_s = 0.02, cell = [10, 10] }]")
    scene = load_scene("elliptic", [Override.parse(text) for text in sets])
    run(scene, RunOptions(0, "memory", output=tmp_path, picture=False))
    recording = load(tmp_path)
    assert plant_spec(recording.header) == scene.plant_spec()
    before, after = recording.tractions(3), recording.tractions(-1)
    weight = scene.parcels[0].mass_kg * scene.gravity_m_s2
    assert before.load_n.sum() == pytest.approx(weight)
    (one,) = after.parcels
    slip = recording.wheel_speeds[-1][one.cells] - after.slip_m_s[one.cells]
    lever = np.array(recording.header["positions_m"])[one.cells] - recording.parcels[-1, 0, :2]
    x, y = recording.parcels[-1, 0, 3:5]
    omega = recording.parcels[-1, 0, 5]
    assert slip == pytest.approx(np.stack([x - omega * lever[:, 1], y + omega * lever[:, 0]], axis=1))
    coefficient = scene.friction.model_dump()["coefficient_s_per_m"]
    dead = recording.header["cells"].index([10, 10])
    pulling = one.cells != dead
    assert after.traction_n[one.cells[pulling]] == pytest.approx(
        coefficient * one.load_n[pulling, None] * one.slip_m_s[pulling]
    )
    assert np.all(after.traction_n[dead] == 0.0)
