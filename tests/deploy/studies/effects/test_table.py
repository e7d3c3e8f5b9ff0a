"""What the tables say, by rows made by hand."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from deploy.commands.options import load_scene
from deploy.studies.effects.advice import Advice, Together
from deploy.studies.effects.ladder import Rung, RungResult
from deploy.studies.effects.report import print_advice, print_ladder, print_rows
from deploy.studies.effects.sensitivity import EventShift, Sensitivity
from deploy.studies.effects.study import AblationRow, Cost


def influence(metres: float, settled_s: tuple[float | None, float | None] = (None, None)) -> Sensitivity:
    return Sensitivity(
        displacement_m=metres,
        at_s=1.5,
        parcel=0,
        turn_rad=3e-3,
        end_m=1e-3,
        end_rad=1e-3,
        parcels=0,
        settled_s=settled_s,
        events=7,
        moved=EventShift("support_gained", 0, ((3, 4),), (1.25, 1.0)),
        only=(0, 0),
    )


def shown(capsys: pytest.CaptureFixture[str], *rows: AblationRow) -> tuple[dict[str, dict[str, str]], str]:
    """Cells of the table, by effect and heading, and all that is printed with single blanks."""
    print_rows(load_scene("elliptic"), rows, 3)
    out = capsys.readouterr().out
    lines = out.splitlines()
    start = next(number for number, line in enumerate(lines) if line.startswith("effect "))
    headings = re.split(r"\s{2,}", lines[start].strip())
    table = [re.split(r"\s{2,}", line.strip()) for line in lines[start + 1 : start + 1 + len(rows)]]
    return {cells[0]: dict(zip(headings, cells, strict=True)) for cells in table}, " ".join(out.split())


@pytest.mark.parametrize(
    ("settled_s", "rests"),
    [
        ((3.0, 2.5), "+0.5"),
        ((2.5, 2.5), "0"),
        ((None, None), "–"),
        ((None, 1.0), "never"),
        ((1.0, None), "only now"),
    ],
)
def test_a_row_has_the_largest_displacement_its_time_the_end_and_the_cost_with_its_noise(
    capsys: pytest.CaptureFixture[str], settled_s: tuple[float | None, float | None], rests: str
) -> None:
    row = AblationRow(
        name="motors",
        on=True,
        solver="exact",
        cost=Cost([3.0, 3.2, 3.1], [1.5, 1.6, 1.55]),
        influence=influence(2e-3, settled_s),
        error=influence(5e-9),
    )
    table, out = shown(capsys, row)
    assert table["motors"] == {
        "effect": "motors", "on": "yes", "mm": "2", "at, s": "1.5", "end, mm": "1", "mrad": "3",
        "event, s": "0.25", "rests, s": rests, "cost, s": "+1.6", "±": "0.05", "×": "2.00", "error, mm": "5e-06",
    }  # fmt: skip
    assert (
        "of the scene's effects, motors matters most: 2 mm at 1.5 s, support_gained of (3, 4) moves by 0.25 s, "
        "costs 1.6 s (1.5 to 1.6 s), 3.1 instead of 1.6 s a run" in out
    )


def test_rows_come_in_the_order_of_influence_the_scene_s_own_first(
    capsys: pytest.CaptureFixture[str],
) -> None:
    rows = [
        AblationRow(name="motors", on=False, influence=influence(9e-3)),
        AblationRow(name="clock", on=True, reason="it blew up"),
        AblationRow(name="adc", on=True, influence=influence(1e-3)),
        AblationRow(name="sensor", on=True, influence=influence(2e-3)),
    ]
    table, _ = shown(capsys, *rows)
    assert list(table) == ["sensor", "adc", "clock", "motors"]


def test_an_influence_near_the_solver_s_error_is_marked(capsys: pytest.CaptureFixture[str]) -> None:
    near = AblationRow(name="adc", on=True, influence=influence(9e-6), error=influence(1e-6))
    far = replace(near, name="sensor", influence=influence(11e-6))
    table, _ = shown(capsys, near, far)
    assert (table["adc"]["mm"], table["sensor"]["mm"]) == ("~0.009", "0.011")


def test_a_cost_within_the_noise_is_called_that(capsys: pytest.CaptureFixture[str]) -> None:
    row = AblationRow(name="adc", on=True, influence=influence(1e-3), cost=Cost([1.0, 1.2], [1.1, 1.1]))
    _, out = shown(capsys, row)
    assert "costs nothing beyond the noise (-0.1 to 0.1 s), 1.1 instead of 1.1 s a run" in out
    _, out = shown(capsys, replace(row, cost=Cost([1.2], [1.1])))
    assert "costs 0.1 s, 1.2 instead of 1.1 s a run (one round: noise unknown)" in out


def test_advice_says_how_much_time_leaving_an_effect_out_saves(capsys: pytest.CaptureFixture[str]) -> None:
    rows = [
        AblationRow(name=name, on=True, influence=influence(1e-4), cost=Cost([2.0, 2.1], [1.5, 1.5]))
        for name in ("adc", "sensor")
    ]
    together = Together(influence=influence(3e-4), cost=Cost([2.0, 2.2], [1.0, 1.0]))
    advice = Advice(tolerance_m=1e-3, can_go=tuple(rows), together=together, missing=(), unclear=("cop",))
    print_advice(advice, rows)
    out = " ".join(capsys.readouterr().out.split())
    assert out.startswith(
        "can be left out, within 1 mm at any time: "
        "adc: 0.1 mm, saves 0.55 s (0.5 to 0.6 s), 1.5 instead of 2 s a run "
        "sensor: 0.1 mm, saves 0.55 s (0.5 to 0.6 s), 1.5 instead of 2 s a run "
        "all of them together: 0.3 mm, saves 1.1 s (1 to 1.2 s), 1 instead of 2.1 s a run "
    )
    assert "unclear: cop: " in out


def test_a_narrow_terminal_gets_fewer_columns_and_their_names(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    row = AblationRow(name="adc", on=True, influence=influence(1e-3), cost=Cost([1.0, 1.2], [1.1, 1.1]))
    for width, left_out in (
        ("60", "end, mm; mrad; rests, s; ×"),
        ("10", "at, s; end, mm; mrad; event, s; rests, s; ±"),
    ):
        monkeypatch.setenv("COLUMNS", width)
        table, out = shown(capsys, row)
        assert {"effect", "on", "mm", "cost, s"} <= table["adc"].keys()
        assert f"left out, too wide for this terminal: {left_out}" in out


def test_notes_say_under_what_an_effect_was_tried(capsys: pytest.CaptureFixture[str]) -> None:
    row = AblationRow(
        name="wheel_load",
        on=False,
        settings={"inertia_kg": 0.1 * 0.1},
        solver="implicit",
        beside=("motors",),
        influence=influence(0.0),
    )
    table, out = shown(capsys, row)
    assert table["wheel_load"]["error, mm"] == "–"
    assert (
        "wheel_load: tried with inertia_kg = 0.01; both under implicit, since exact doesn't support the effect; "
        "both with motors, which the effect needs" in out
    )
    _, out = shown(capsys, replace(row, settings={"values": [], "other": None}))
    assert "wheel_load: tried with default settings" in out


def test_a_rung_that_was_not_run_says_why(capsys: pytest.CaptureFixture[str]) -> None:
    scene = load_scene("ladder")
    run = RungResult(Rung("viscous", "inertia", scene), [0.5, 0.45, 0.6], influence(4e-3))
    print_ladder(scene, [run, RungResult(Rung("fog", "fog", None), reason="it is dry")])
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["viscous", "inertia", "0.5", "0.07", "4", "3"] in lines
    assert ["fog", "left", "out:", "it", "is", "dry", "–", "–", "–", "–"] in lines
