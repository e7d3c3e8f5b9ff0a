"""What a run with a report says: numbers against the spectrum, and the same however it is run."""

from __future__ import annotations

import csv
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell_firmware.errors import FirmwareError
from deploy.cli import main
from deploy.protocol_report.from_recording import report_from_recording
from deploy.recordings.reader import load
from deploy.runs.run import run
from deploy.runs.summary import Summary
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene
from deploy.workers.plan import RunOptions

ROWS, COLUMNS, NUMBER = 2, 5, 0.2
HELD = [
    {"cell": [row, column], "speed_m_s": [speed, 0.0]}
    for row in range(ROWS)
    for column, speed in ((0, 0.3), (COLUMNS - 1, 0.0))
]


def scene(duration_s: float = 1.0, parameters: dict[str, Any] | None = None, **more: Any) -> Scene:
    """A small array, both of its ends held, without a parcel."""
    values = {
        "duration_s": duration_s,
        "array.rows": ROWS,
        "array.columns": COLUMNS,
        "parcels": [],
        "cells.parameters": {"diffusion_number": NUMBER, "held": HELD} if parameters is None else parameters,
        **{name.replace("__", "."): value for name, value in more.items()},
    }
    return load_scene("heat", [Override(tuple(key.split(".")), value, "") for key, value in values.items()])


def reported(scene: Scene, output: Path, **options: Any) -> Summary:
    given = {"processes": 0, "transport": "memory", "picture": False, "protocol_report": 1, **options}
    return run(scene, RunOptions(output=output, **given), quiet=True).summary


def slowest() -> float:
    """Of the errors between the held ends: the spectrum of a chain between absorbing ends."""
    inner = COLUMNS - 2
    chain = 2 * np.eye(inner) - np.eye(inner, k=1) - np.eye(inner, k=-1)
    return 1 - NUMBER * float(np.linalg.eigvalsh(chain)[0])


def test_heat_falls_at_the_rate_of_its_spectrum(tmp_path: Path) -> None:
    report = reported(scene(), tmp_path).protocol
    assert report is not None
    assert (report.observed, report.rate_of, report.ticks, report.cells) == ("speed_m_s", "error", 245, 10)
    assert report.rate is not None
    assert report.rate.factor == pytest.approx(slowest(), rel=1e-6)
    assert report.predicted_factor == pytest.approx(slowest(), rel=1e-9)
    assert report.rate_ratio == pytest.approx(1.0, abs=1e-5)
    assert report.verdict.endswith("the rates agree within 0.01 %.")
    line = 0.3 * np.array([0.0, 0.75, 0.5, 0.25, 0.0])  # what is missing of the straight line in tick 0
    error = report.residuals["error"]
    assert error.first_rms == pytest.approx(np.sqrt(np.mean(line**2) / 2))
    assert error.settled_1_percent_tick == pytest.approx(np.log(0.01) / np.log(slowest()), abs=3)


def test_the_table_has_a_line_a_tick(tmp_path: Path) -> None:
    summary = reported(scene(), tmp_path)
    with (tmp_path / "protocol.csv").open() as lines:
        rows = list(csv.DictReader(lines))
    assert [int(row["tick"]) for row in rows] == list(range(245))
    assert rows[0]["change_rms"] == ""
    assert list(rows[0]) == ["tick", "change_rms", "change_max", "error_rms", "error_max"]
    assert summary.protocol is not None
    assert float(rows[-1]["error_max"]) == summary.protocol.residuals["error"].last_max


def test_messages_and_what_they_would_take_on_a_line(tmp_path: Path) -> None:
    report = reported(scene(), tmp_path).protocol
    assert report is not None
    links = report.links
    assert links is not None
    directions = 2 * (ROWS * (COLUMNS - 1) + COLUMNS * (ROWS - 1))
    assert (links.sent, links.received) == (245 * directions, 244 * directions)
    assert links.sent_per_cell_tick == directions / (ROWS * COLUMNS)
    assert (links.message_bytes, links.line_bytes, links.on_lines, links.baud) == (16, 17, False, 9615)
    # ten bits of 208 clocks of 500 ns each, in 4.096 ms
    assert links.line_capacity_bytes_per_tick == pytest.approx(4.096e-3 / (10 * 208 * 500e-9))
    assert links.line_load == pytest.approx(17 / links.line_capacity_bytes_per_tick)


def test_over_serial_lines_the_received_messages_are_those_that_they_carry(tmp_path: Path) -> None:
    report = reported(scene(effects__serial={}), tmp_path).protocol
    assert report is not None
    assert report.links is not None
    assert report.links.on_lines
    assert report.links.received_per_cell_tick < 0.3 * report.links.sent_per_cell_tick
    assert "effect serial" in report.verdict


def without_times(summary: Summary) -> dict[str, Any]:
    assert summary.protocol is not None
    return {"digest": summary.digest, "effects": dict(summary.effects), **asdict(summary.protocol)}


@pytest.mark.slow
def test_a_report_changes_nothing_and_is_the_same_for_any_processes(tmp_path: Path) -> None:
    noisy = scene(
        0.4,
        effects__link_loss={"probability": 0.1},
        effects__clock={"error_ppm": 50.0},
        faults=[
            {"kind": "crash", "at_s": 0.2, "cell": [0, 1]},
            {"kind": "crash", "at_s": 0.25, "cell": [1, 3]},
        ],
    )
    plain = reported(noisy, tmp_path, protocol_report=None)
    assert plain.protocol is None
    assert not (tmp_path / "protocol.csv").exists()
    alone = without_times(reported(noisy, tmp_path))
    assert (alone["digest"], alone["effects"]) == (plain.digest, plain.effects)
    assert (alone["cells"], alone["cells_dead"]) == (10, 2)
    assert "effect link_loss, effect clock, 2 cells died" in alone["verdict"]
    several = without_times(reported(noisy, tmp_path, processes=2, transport="zenoh"))
    each = without_times(reported(noisy, tmp_path, processes="each", transport="zenoh"))
    assert several == each == alone


def test_where_cells_die_the_rate_is_that_before_or_of_the_change_after(tmp_path: Path) -> None:
    late = [{"kind": "crash", "at_s": 0.6, "cell": [0, 2]}, {"kind": "crash", "at_s": 0.6, "cell": [1, 2]}]
    report = reported(scene(faults=late), tmp_path).protocol
    assert report is not None
    assert report.rate is not None
    assert (report.rate_of, report.rate.to_tick < 147) == ("error", True)
    assert report.rate.factor == pytest.approx(slowest(), rel=1e-5)
    early = [{**fault, "at_s": 0.012} for fault in late]
    report = reported(scene(faults=early), tmp_path).protocol
    assert report is not None
    assert report.rate is not None
    assert report.rate_of == "change"
    # a cell between a held one and the dead: u += r (held - u)
    assert report.rate.factor == pytest.approx(1 - NUMBER, rel=1e-5)


def test_drives_of_the_dead_do_not_count(plain: str, tmp_path: Path) -> None:
    dead = [{"kind": "crash", "at_s": 0.05, "cell": [0, 2]}]
    braked = scene(0.1, {}, cells__firmware=f"{plain}:Unnamed", faults=dead, stall__policy="brake")
    with_one = reported(braked, tmp_path).protocol  # whose drive goes from 0.1 m/s to 0
    assert with_one is not None
    assert (with_one.cells_dead, with_one.ticks, with_one.last_change_tick) == (1, 25, 0)


def test_with_registers_the_recording_has_them_in_their_ticks_alone(tmp_path: Path) -> None:
    summary = reported(scene(0.1), tmp_path, registers=10)
    assert summary.protocol is not None
    assert summary.protocol.ticks == 25
    recording = load(tmp_path)
    assert recording.register_tick.tolist() == [0, 10, 20]
    assert {"firmware.speed_m_s", "messages.sent"} <= recording.registers.keys()


def test_looking_now_and_then_finds_the_same_rate(tmp_path: Path) -> None:
    report = reported(scene(), tmp_path, protocol_report=5).protocol
    assert report is not None
    assert (report.every_ticks, report.ticks) == (5, 49)
    assert report.rate is not None
    assert report.rate.factor == pytest.approx(slowest(), rel=1e-6)


def test_a_recording_with_registers_gives_the_same_report_but_for_messages(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dead = [{"kind": "crash", "at_s": 0.7, "cell": [0, 2]}]
    live = without_times(reported(scene(faults=dead), tmp_path, registers=1))
    _, report = report_from_recording(load(tmp_path))
    assert asdict(report) == {key: live[key] for key in asdict(report)} | {"links": None}
    assert main(["plot", str(tmp_path), "--kind", "protocol"]) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'protocol.png'}\n"
    assert (tmp_path / "protocol.png").read_bytes().startswith(b"\x89PNG")
    reported(scene(0.1), tmp_path)
    assert main(["plot", str(tmp_path), "--kind", "protocol"]) == 2
    assert "has no registers of speed_m_s: record them with mdms run --registers" in capsys.readouterr().err


def test_a_recording_always_has_the_drives(plain: str, tmp_path: Path) -> None:
    live = reported(scene(0.1, {}, cells__firmware=f"{plain}:Unnamed"), tmp_path).protocol
    assert live is not None
    _, report = report_from_recording(load(tmp_path))
    assert asdict(report) == asdict(live)


PLAIN = """
from cell_firmware.cell import CellFirmware, CellOutputs
from cell_firmware.program import Theory

class Counter(CellFirmware):
    observable = "count"

    def init(self, cell):
        return {"count": 0, "column": cell.column}

    def step(self, state, inputs):
        count = min(state["count"] + 1, state["column"])
        return {**state, "count": count}, CellOutputs((0.1, 0.0))

    def theory(self, lattice):
        return Theory("a cell counts to its column", ticks=int(lattice.columns.max()), limit=lattice.columns)


class Unnamed(Counter):
    observable = None

    def theory(self, lattice):
        return None


class Confused(Counter):
    def theory(self, lattice):
        return Theory("of another array", limit=lattice.columns[:3])


class Lost(Counter):
    def theory(self, lattice):
        raise ZeroDivisionError("no law")
"""


@pytest.fixture
def plain(tmp_path: Path) -> str:
    (tmp_path / "plain.py").write_text(PLAIN)
    return str(tmp_path / "plain.py")


def test_a_program_in_plain_python_is_held_against_its_own_theory(plain: str, tmp_path: Path) -> None:
    report = reported(scene(0.1, {}, cells__firmware=f"{plain}:Counter"), tmp_path).protocol
    assert report is not None
    assert (report.observed, report.last_change_tick, report.predicted_ticks) == ("count", 3, 4)
    assert report.residuals["error"].last_max == 0.0
    assert report.verdict.endswith("This agrees with theory.")
    assert report.links is None


def test_a_program_that_names_no_field_is_shown_by_its_drives(plain: str, tmp_path: Path) -> None:
    report = reported(scene(0.1, {}, cells__firmware=f"{plain}:Unnamed"), tmp_path).protocol
    assert report is not None
    assert (report.observed, report.ticks, report.last_change_tick) == ("drive", 25, 0)
    assert report.notes == ("the program declares no field (observable): its drives are shown",)


def test_a_limit_of_another_array_is_left_out(plain: str, tmp_path: Path) -> None:
    report = reported(scene(0.1, {}, cells__firmware=f"{plain}:Confused"), tmp_path).protocol
    assert report is not None
    assert list(report.residuals) == ["change"]
    assert report.notes == ("theory's limit has 3 rows, not one a cell: left out",)


def test_a_theory_that_raises_is_bad_input_with_its_traceback(plain: str, tmp_path: Path) -> None:
    with pytest.raises(
        FirmwareError, match=r"(?s)plain.py:Lost.: theory\(\) raised .*no law\n.*plain.py.*no law$"
    ):
        reported(scene(0.1, {}, cells__firmware=f"{plain}:Lost"), tmp_path)


def test_the_command_prints_it_for_people_and_programs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["run", "heat", "--duration", "0.2", "--processes", "0", "--transport", "memory"]
    arguments += ["--protocol-report", "--output", str(tmp_path)]
    assert main([*arguments, "--json", "--no-picture"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["protocol"]["rate"].keys() >= {
        "factor",
        "low",
        "high",
        "from_tick",
        "to_tick",
        "decades",
        "floor",
    }
    assert found == json.loads((tmp_path / "summary.json").read_text())
    assert not (tmp_path / "protocol.png").exists()
    assert main(arguments) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "field speed_m_s of 200 cells, every tick" in shown
    assert "if the scene had serial lines" in shown
    assert (tmp_path / "protocol.png").read_bytes().startswith(b"\x89PNG")
    assert main(["run", "heat", "--protocol-report", "0"]) == 2
    assert "--protocol-report 0: must be a number of ticks from 1" in capsys.readouterr().err
