"""``mdms orientations`` reports where a parcel comes to rest, for people and for programs."""

from __future__ import annotations

import json
import math
import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deploy.cli import main
from deploy.commands.options import load_scene
from deploy.studies.orientations.study import size_map, study
from plant.analysis.torque_profile import TorqueProfiler

TIPS = ("motors", "--set", "parcels.0.size_m=[0.4,0.2]", "--at", "0.1,0")
"""Where some angles have no cells all round the centre of mass."""
SIZES = ("--sizes", "0.5:0.6:3,0.3:0.4:2")


def orientations(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    assert main(["orientations", *arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_the_json_has_the_staircase_and_what_is_stable_on_it(capsys: pytest.CaptureFixture[str]) -> None:
    found = orientations(capsys, "misaligned")
    assert found["centre_m"] == pytest.approx([0.0, 0.0], abs=1e-14)
    assert found["largest_force_n"] == 0.0
    assert len(found["angles_rad"]) == len(found["torque_n_m"]) == len(found["supports"]) == 48
    stable = [one for one in found["orientations"] if one["nature"] == "attracting"]
    assert len(stable) == 6
    for one in stable:
        assert one["before_n_m"] > 0.0 > one["after_n_m"]
        assert {one["low_rad"], one["high_rad"] % (2.0 * math.pi)} <= set(found["angles_rad"])


def test_a_run_ends_where_the_table_says(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["simulate", "misaligned", "--duration", "40", "--output", str(tmp_path), "--json"]) == 0
    (end,) = json.loads(capsys.readouterr().out)["parcels"]
    found = orientations(capsys, "misaligned")["orientations"]
    (there,) = (one for one in found if one["low_rad"] - 1e-9 <= end["angle_rad"] <= one["high_rad"] + 1e-9)
    assert there["nature"] == "attracting"
    assert there["low_rad"] > 0.1  # askew, as the scene's title says


def test_the_table_is_in_degrees_and_fits_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["orientations", "elliptic", "--set", "parcels.0.size_m=[0.68,0.42]"]) == 0
    shown = capsys.readouterr()
    assert shown.err == ""
    lines = shown.out.splitlines()
    assert all(len(line) <= 80 for line in lines)
    rows = [" ".join(line.split()) for line in lines if line[:1].isdigit() and "a turn" not in line]
    assert len(rows) == 12
    assert rows[0] == "10.2705 attracting angle yes 0.001962 -0.01261"
    assert rows[2] == "86.4365 to 93.5635 attracting interval yes 0.01585 -0.01585"
    assert rows[-1].startswith("356.4365 to 3.5635 repelling interval no ")


def test_a_square_in_this_array_may_lie_at_any_angle(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["orientations", "elliptic", "--set", "parcels.0.size_m=[0.4,0.4]"]) == 0
    assert capsys.readouterr().out.splitlines()[-1].split() == ["all", "neutral", "interval", "no", "–", "–"]


def test_what_the_table_can_t_promise_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["orientations", "squeeze", "--at", "0.013,0.3"]) == 0
    assert "The point is not an equilibrium at every angle" in capsys.readouterr().out
    assert main(["orientations", *TIPS]) == 0
    assert "At some angles the parcel tips" in capsys.readouterr().out
    assert main(["orientations", "motors"]) == 0
    assert "the parcel never stops turning" in " ".join(capsys.readouterr().out.split())


def test_where_a_parcel_does_not_stand_the_json_has_no_torque(capsys: pytest.CaptureFixture[str]) -> None:
    found = orientations(capsys, *TIPS)
    carried = [count > 0 for count in found["supports"]]
    assert carried == [torque is not None for torque in found["torque_n_m"]]
    assert set(carried) == {True, False}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["elliptic", "--parcel", "1"], "scene elliptic: --parcel 1: the scene has parcels 0..0"),
        (["elliptic", "--at", "0"], "--at 0: must be X,Y, numbers"),
        (
            ["elliptic", "--at", "5,0"],
            "scene elliptic: a parcel with its centre of mass at (5, 0) m stands at no",
        ),
        (["squeeze"], "scene squeeze: parcels[0]: from its start no point is found"),
        (["heat"], 'scene heat: cells.firmware = "heat_diffusion": must be velocity_field'),
        (["elliptic", "--sizes", "1:2:3"], "--sizes 1:2:3: must be LMIN:LMAX:N,BMIN:BMAX:N"),
        (["elliptic", "--sizes", "1:2:3,1:2:x"], "--sizes 1:2:3,1:2:x: must be LMIN:LMAX:N,BMIN:BMAX:N"),
        (["elliptic", "--sizes", "0:2:3,1:2:3"], "--sizes 0:2:3,1:2:3: lengths and widths must be > 0"),
        (
            ["elliptic", "--sizes", "1:2:9999,1:2:3"],
            "--sizes 1:2:9999,1:2:3: 9,999 lengths or widths; at most 1,000",
        ),
        (
            ["coulomb"],
            'scene coulomb: friction.law = "coulomb": there are stable orientations for the law viscous',
        ),
        (["elliptic", "--sizes", "1:2:0,1:2:3"], "--sizes 1:2:0,1:2:3: lengths and widths must be > 0"),
        (
            [
                "elliptic",
                *SIZES,
                "--set",
                "parcels=[{vertices_m=[[0,0],[1,0],[0,1]],mass_kg=1,position_m=[0,0]}]",
            ],
            "scene elliptic: parcels[0].vertices_m: --sizes needs a parcel with size_m",
        ),
    ],
)
def test_an_unanswerable_request_is_refused_in_one_line(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["orientations", *arguments]) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith(message)
    assert len(shown.err.splitlines()) == 1


def test_a_picture_can_t_go_where_a_file_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    for more in ((), SIZES):
        assert main(["orientations", "elliptic", *more, "--output", str(tmp_path / "file")]) == 2
        assert f"output {tmp_path / 'file'}: is a file, must be a folder" in capsys.readouterr().err


# --- sizes ------------------------------------------------------------------------------------------


def test_every_size_has_the_orientations_of_a_parcel_of_that_size(capsys: pytest.CaptureFixture[str]) -> None:
    rows = orientations(capsys, "elliptic", *SIZES)["rows"]
    assert [(row["length_m"], row["width_m"]) for row in rows] == [
        pytest.approx((length, width)) for width in (0.3, 0.4) for length in (0.5, 0.55, 0.6)
    ]
    for row in rows:
        size = f"parcels.0.size_m=[{row['length_m']},{row['width_m']}]"
        alone = orientations(capsys, "elliptic", "--at", "0,0", "--set", size)["orientations"]
        stable = [[one["low_rad"], one["high_rad"]] for one in alone if one["nature"] == "attracting"]
        assert row["stable_rad"] == [pytest.approx(one, abs=1e-9) for one in stable]
        ends = np.mod(np.ravel(stable) + math.pi, 2.0 * math.pi) - math.pi
        across = any(high > 2.0 * math.pi for _, high in stable)
        assert row["nearest_rad"] == pytest.approx(0.0 if across else np.abs(ends).min(), abs=1e-9)


def test_the_summary_counts_every_size_once(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["orientations", "elliptic", "--sizes", "0.05:0.5:2,0.05:0.38:2"]) == 0
    out = capsys.readouterr().out
    assert "4 sizes, 0.05 to 0.5 m long and 0.05 to 0.38 m wide" in out
    assert sum(int(line.split()[-1]) for line in out.splitlines()[4:]) == 4
    assert "\nstands at no angle " in out


def test_a_map_over_sizes_says_in_a_log_how_far_it_is(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("deploy.studies.orientations.study.LINE_S", -1.0)
    size_map(study(load_scene("elliptic"), 0, (0.0, 0.0)), np.array([0.5]), np.array([0.3, 0.4, 0.5]))
    assert capsys.readouterr().err.splitlines() == [f"mdms: {done} of 3 widths" for done in range(3)]


def test_interrupted_a_map_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    turn, done = TorqueProfiler.profile, []

    def turn_twice(*arguments: Any) -> Any:
        done.append(arguments)
        if len(done) == 3:
            os.kill(os.getpid(), signal.SIGINT)
        return turn(*arguments)

    monkeypatch.setattr(TorqueProfiler, "profile", turn_twice)
    assert main(["orientations", "elliptic", *SIZES, "--output", str(tmp_path)]) == 130
    assert len(done) == 3
    assert tuple(capsys.readouterr()) == ("", "mdms: interrupted\n")
    assert not list(tmp_path.iterdir())
