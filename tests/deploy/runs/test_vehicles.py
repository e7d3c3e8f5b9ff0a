"""The bundled scenes in which vehicles of wheels carry parcels: these arrive, turned as they should be."""

from __future__ import annotations

from collections.abc import Callable
from math import degrees, pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deploy.errors import InputError
from deploy.runs.run import run
from deploy.runs.summary import Summary
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.workers.plan import RunOptions


@pytest.fixture
def ended(tmp_path: Path) -> Callable[..., Summary]:
    """Runs a bundled scene with other values, its cells in this process."""

    def outcome(scene: str, **changes: Any) -> Summary:
        overrides = [
            Override(tuple(int(part) if part.isdigit() else part for part in key.split("__")), value, "")
            for key, value in changes.items()
        ]
        options = RunOptions(0, "memory", "packed", output=tmp_path, picture=False)
        return run(load_scene(scene, overrides), options, quiet=True).summary

    return outcome


@pytest.mark.slow
def test_three_parcels_go_round_the_carousel_and_turn_each_in_its_direction(
    ended: Callable[..., Summary],
) -> None:
    """Within 2 mm, for it still settles, and the 2 degrees by which one lies off before the next cell turns it back."""
    summary = ended("carousel", cells__period_s=0.032768)
    assert summary.status == "ok"
    wanted = (((-0.6, 0.6), pi), ((-0.6, -0.6), 0.0), ((0.6, -0.6), -pi))
    for parcel, (place, angle) in zip(summary.parcels, wanted, strict=True):
        assert parcel.position_m == pytest.approx(place, abs=2e-3)
        assert abs(degrees(parcel.angle_rad - angle)) < 2.0


def test_a_parcel_goes_along_a_row_and_back(ended: Callable[..., Summary]) -> None:
    summary = ended("vehicle_row", cells__period_s=0.032768)
    (parcel,) = summary.parcels
    assert parcel.position_m == pytest.approx((-0.25, 0.0), abs=1e-3)
    assert parcel.angle_rad == 0.0


def test_off_the_line_of_a_row_no_parcel_is_carried(ended: Callable[..., Summary]) -> None:
    with pytest.raises(InputError, match="the parcel would tip"):
        ended("vehicle_row", parcels__0__position_m=[-0.35, 0.001])


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [{"effects": {}, "cells__period_s": 0.032768}, {"cells__board": "hc11"}],
    ids=["ideal wheels", "hc11"],
)
def test_18_cells_hand_a_box_on_and_turn_it(changes: dict[str, Any], ended: Callable[..., Summary]) -> None:
    """So few cells hold a box that is nearly square to some 12 degrees, and it still swings at the end."""
    summary = ended("vehicle_prototype", duration_s=8.5, **changes)
    (parcel,) = summary.parcels
    assert summary.status == "ok"
    assert parcel.position_m == pytest.approx((0.15, 0.05), abs=5e-3)
    assert abs(degrees(parcel.angle_rad - pi / 2)) < 16.0


@pytest.mark.parametrize("at_s", [0.7, 2.0, 4.0])
def test_behind_its_reference_a_parcel_is_the_damped_oscillator_that_started_late(
    at_s: float, ended: Callable[..., Summary]
) -> None:
    """e'' = -mu g (k e + e') from e' = -U on, to the way of the few periods in which the core was handed on."""
    pace, k, speed = 0.3 * 9.81, 0.7, 0.15
    slow, fast = np.sort(abs(np.roots([1.0, pace, pace * k])))
    behind = speed * (np.exp(-slow * at_s) - np.exp(-fast * at_s)) / (fast - slow)
    (parcel,) = ended("vehicle_row", duration_s=at_s).parcels
    handed_on = parcel.position_m[0] + 0.35 + behind - speed * at_s
    assert -speed * 0.004096 * (2 + speed * at_s / 0.1) < handed_on <= 0.0
