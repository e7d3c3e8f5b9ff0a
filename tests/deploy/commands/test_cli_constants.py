"""``mdms constants`` prints what the plant computes, for people and for programs."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest

from deploy.cli import main

CENTRED = ("--set", "parcels.0.position_m=[0.02,0.01]", "--set", "parcels.0.angle_rad=0")
WEIGHT_N = 2.0 * 9.81


def constants(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    assert main(["constants", "elliptic", "--json", *arguments]) == 0
    return json.loads(capsys.readouterr().out)


def test_in_a_linear_field_the_stiffness_is_the_fields_whatever_the_supports(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for pose in ((), CENTRED):
        found = constants(capsys, *pose)
        assert sum(found["loads_n"]) == pytest.approx(WEIGHT_N, rel=1e-12)
        assert len(found["supports"]) == len(found["loads_n"])
        (xx, xy), (yx, yy) = found["k_s_n_per_m"]
        assert (xx, yy) == pytest.approx((-0.2 * WEIGHT_N, -2 * 0.2 * WEIGHT_N), rel=1e-12)
        assert (xy, yx) == pytest.approx((0.0, 0.0), abs=1e-12)
        assert found["equilibrium_m"] == pytest.approx([0.0, 0.0], abs=1e-12)
    assert found["equilibrium_inside"] is True


def test_the_table_names_the_pose_the_constants_and_every_support(capsys: pytest.CaptureFixture[str]) -> None:
    found = constants(capsys, *CENTRED)
    assert main(["constants", "elliptic", *CENTRED]) == 0
    out = capsys.readouterr().out
    assert out.startswith(
        f"scene elliptic, parcel 0 at (0.02, 0.01) m, 0 rad (0°), carried by {len(found['supports'])} cells"
    )
    assert all(len(line) <= 80 for line in out.splitlines())
    assert "-0.981 ± 1.721i, -0.981 ± 0.9998i 1/s" in out
    for name in ("k_s", "f0", "tau0", "k_tau", "equilibrium", "eigenvalues"):
        assert f"\n{name} " in out
    for row, column in found["supports"]:
        assert f"\n{row},{column} " in out


def test_another_pose_is_given_in_metres_and_degrees(capsys: pytest.CaptureFixture[str]) -> None:
    there = constants(capsys, "--at", "0.02,-0.01,30")
    assert (there["position_m"], there["angle_rad"]) == ([0.02, -0.01], pytest.approx(math.pi / 6, rel=1e-15))
    moved = "--set", "parcels.0.position_m=[0.02,-0.01]", "--set", f"parcels.0.angle_rad={math.pi / 6}"
    assert constants(capsys, *moved) == there
    assert there["supports"] != constants(capsys)["supports"]
    assert main(["constants", "elliptic", "--at", "0.02,-0.01,30"]) == 0
    assert "at (0.02, -0.01) m, 0.523599 rad (30°), carried by" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["elliptic", "--parcel", "1"], "scene elliptic: --parcel 1: the scene has parcels 0..0"),
        (["elliptic", "--set", "parcels=[]"], "scene elliptic: --parcel 0: the scene has no parcels"),
        (["elliptic", "--set", "parcels.0.position_m=[5,0]"], "scene elliptic: parcels[0]"),
        (["elliptic", "--at", "5,0,0"], "scene elliptic: parcels[0]: no set of cells carries"),
        (["elliptic", "--at", "0,0"], "--at 0,0: must be X,Y,DEGREES, numbers"),
        (["elliptic", "--at", "0,0,nan"], "--at 0,0,nan: must be X,Y,DEGREES, numbers"),
        (["elliptic", "--at", "0,0,east"], "--at 0,0,east: must be X,Y,DEGREES, numbers"),
        (["heat"], 'scene heat: cells.firmware = "heat_diffusion": must be velocity_field'),
    ],
)
def test_what_has_no_constants_is_refused_in_one_line(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["constants", *arguments]) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith(message)
    assert len(shown.err.splitlines()) == 1
