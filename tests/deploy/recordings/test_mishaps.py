"""Parcels that tip or fall, as a run reports them while it continues."""

from __future__ import annotations

from pathlib import Path

import pytest

from deploy.recordings.mishaps import Mishaps
from deploy.runs.field_simulation import simulate
from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.workers.plan import RunOptions
from plant.observations import Event

FALLS = (
    "duration_s=0.1",
    "array.rows=4",
    "array.columns=4",
    'cells.parameters.field={ kind = "uniform", velocity_m_s = [5.0, 0.0] }',
    "parcels=[{ size_m = [0.3, 0.3], mass_kg = 1.0, position_m = [0.14, 0.0], velocity_m_s = [1.0, 0.0] }]",
)
FELL = "mdms: parcel 0 fell off the array at 0.00"


def _reported(*events: Event) -> list[str]:
    lines: list[str] = []
    Mishaps(lines.append).take(events)
    return lines


def test_only_tipped_and_fallen_parcels_are_reported_with_time_and_place() -> None:
    assert _reported(
        Event(1.5, "tipped", 3, ((0, 1),), (0.25, -0.5), "about cell 0,1"),
        Event(2.0, "left", 1, (), (0.0, 0.0), "through exit north"),
        Event(2.5, "off_array", 4, (), (1.0, 2.0)),
    ) == [
        "parcel 3 tipped at 1.5 s, x = 0.25 m, y = -0.5 m: about cell 0,1",
        "parcel 4 fell off the array at 2.5 s, x = 1 m, y = 2 m",
    ]


def test_of_many_parcels_that_fall_ten_are_named() -> None:
    lines = _reported(*(Event(1.0, "off_array", i, (), (0.0, 0.0)) for i in range(30)))
    assert [line.split()[1] for line in lines[:10]] == [str(i) for i in range(10)]
    assert lines[10:] == [
        "more parcels tipped or fell: see the summary for their number, and the recording for each event"
    ]


def test_runs_and_simulations_report_a_parcel_that_falls_on_stderr_unless_quiet(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = load_scene("elliptic", [Override.parse(text) for text in FALLS])
    run(scene, RunOptions(0, "memory", output=tmp_path / "run", picture=False))
    assert FELL in capsys.readouterr().err
    simulate(scene, output=tmp_path / "simulation", picture=False)
    assert FELL in capsys.readouterr().err
    simulate(scene, output=tmp_path / "quiet", picture=False, quiet=True)
    assert not capsys.readouterr().err
