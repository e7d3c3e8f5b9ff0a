"""What the tables say, by rows made by hand."""

from __future__ import annotations

from dataclasses import replace

import pytest

from deploy.commands.options import load_scene
from deploy.studies.effects.ladder import Rung, RungResult
from deploy.studies.effects.report import print_ladder, print_rows
from deploy.studies.effects.sensitivity import Sensitivity
from deploy.studies.effects.study import AblationRow


def influence(metres: float, settled_s: tuple[float | None, float | None] = (None, None)) -> Sensitivity:
    return Sensitivity(
        displacement_m=metres,
        turn_rad=3e-3,
        parcels=0,
        settled_s=settled_s,
        events=7,
        moved_s=0.25,
        only=(0, 0),
    )


def rows(capsys: pytest.CaptureFixture[str], row: AblationRow) -> tuple[list[str], str]:
    print_rows(load_scene("elliptic"), [row])
    out = capsys.readouterr().out
    (line,) = (line.split() for line in out.splitlines() if line.startswith(f"{row.name} "))
    return line, " ".join(out.split())


@pytest.mark.parametrize(
    ("settled_s", "rests"),
    [
        ((3.0, 2.5), "+0.5"),
        ((2.5, 2.5), "0"),
        ((None, None), "–"),
        ((None, 1.0), "never"),
        ((1.0, None), "only"),
    ],
)
def test_a_row_is_in_millimetres_and_milliradians(
    capsys: pytest.CaptureFixture[str], settled_s: tuple[float | None, float | None], rests: str
) -> None:
    row = AblationRow(
        name="motors",
        on=True,
        solver="exact",
        wall_s=(3.0, 1.5),
        influence=influence(2e-3, settled_s),
        error=influence(5e-9),
    )
    line, _ = rows(capsys, row)
    assert line[:6] == ["motors", "yes", "2.00", "2", "3", rests]
    assert line[-2:] == ["0.25", "5e-06"]


def test_notes_say_under_what_an_effect_was_tried(capsys: pytest.CaptureFixture[str]) -> None:
    row = AblationRow(
        name="wheel_load",
        on=False,
        settings={"inertia_kg": 0.1 * 0.1},
        solver="implicit",
        beside=("motors",),
        wall_s=(1.0, 1.0),
        influence=influence(0.0),
    )
    line, out = rows(capsys, row)
    assert line[-1] == "–"
    assert "wheel_load: tried with inertia_kg = 0.01 " in out
    _, out_of_defaults = rows(capsys, replace(row, settings={"values": [], "other": None}))
    assert "wheel_load: tried with default settings" in out_of_defaults
    assert "wheel_load: both under implicit, since exact doesn't support the effect" in out
    assert "wheel_load: both with motors, which the effect needs" in out


def test_a_rung_that_was_not_run_says_why(capsys: pytest.CaptureFixture[str]) -> None:
    scene = load_scene("ladder")
    run = RungResult(Rung("viscous", "inertia", scene), 0.5, influence(4e-3))
    print_ladder(scene, [run, RungResult(Rung("fog", "fog", None), reason="it is dry")])
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["viscous", "inertia", "0.5", "4", "3"] in lines
    assert ["fog", "left", "out:", "it", "is", "dry", "–", "–", "–"] in lines
