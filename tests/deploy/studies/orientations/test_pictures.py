"""The pictures of orientations show what is stable."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.image import imread

from deploy.cli import main
from deploy.commands.options import load_scene
from deploy.studies.orientations.plots import draw_orientations, draw_sizes
from deploy.studies.orientations.study import OrientationStudy, SizeMap, size_map, study
from deploy.util.colours import colour
from plant.analysis.orientations import TorqueProfile

CONTINUOUS = "#8fa0b2"
NONE = "#e3e7ec"


def _pixels(path: Path, shade: str) -> int:
    """How many pixels have this colour."""
    picture = imread(path)[..., :3]
    return int((np.abs(picture - mpl.colors.to_rgb(shade)).max(axis=2) < 0.02).sum())


@pytest.fixture
def misaligned() -> OrientationStudy:
    return study(load_scene("misaligned"), 0, (0.0, 0.0))


def test_every_stable_orientation_is_drawn_in_its_colour(
    misaligned: OrientationStudy, tmp_path: Path
) -> None:
    draw_orientations(misaligned, misaligned.profile(), tmp_path / "o.png")
    shown = [_pixels(tmp_path / "o.png", colour(number)) for number in range(6)]
    assert min(shown) > 100
    # a parcel half a turn round lies on the same outline, and the later one on top
    assert _pixels(tmp_path / "o.png", colour(6)) == 0


def test_where_the_torque_never_vanishes_the_parcel_is_drawn_as_it_starts(tmp_path: Path) -> None:
    orientation_study = study(load_scene("motors"), 0, None)
    profile = orientation_study.profile()
    assert profile.stable() == ()
    draw_orientations(orientation_study, profile, tmp_path / "o.png")
    assert _pixels(tmp_path / "o.png", "#22272e") > 1000


def test_the_continuous_curve_is_drawn_where_the_field_is_linear(tmp_path: Path) -> None:
    drawn = {}
    for name, place in (("elliptic", (0.0, 0.0)), ("squeeze", (0.0, 0.3))):
        orientation_study = study(load_scene(name), 0, place)
        # without steps and marks, which would lie on the curve
        profile = dataclasses.replace(
            orientation_study.profile(), torque_n_m=np.ones(1), angles_rad=np.zeros(0)
        )
        draw_orientations(orientation_study, profile, tmp_path / f"{name}.png")
        drawn[name] = _pixels(tmp_path / f"{name}.png", CONTINUOUS)
    assert drawn["elliptic"] > 300
    assert drawn["squeeze"] < 50


def test_angles_at_which_the_parcel_tips_are_hatched(misaligned: OrientationStudy, tmp_path: Path) -> None:
    whole = misaligned.profile()
    cut = whole.torque_n_m.copy()
    cut[:12] = np.nan
    for name, torque in (("whole", whole.torque_n_m), ("cut", cut)):
        profile: TorqueProfile = dataclasses.replace(whole, torque_n_m=torque)
        draw_orientations(misaligned, profile, tmp_path / f"{name}.png")
    hatched = (_pixels(tmp_path / f"{name}.png", "#c9d0d8") for name in ("cut", "whole"))
    assert next(hatched) > next(hatched) + 300


def test_sizes_without_a_stable_orientation_are_grey(misaligned: OrientationStudy, tmp_path: Path) -> None:
    sizes = size_map(misaligned, np.array([0.5, 0.6]), np.array([0.32, 0.42]))
    nothing = SizeMap(sizes.lengths_m, sizes.widths_m, ((None, ()), ((), None)))
    for name, shown in (("some", sizes), ("none", nothing)):
        draw_sizes(misaligned, shown, tmp_path / f"{name}.png")
    assert _pixels(tmp_path / "some.png", NONE) < 0.05 * _pixels(tmp_path / "none.png", NONE)


def test_a_single_size_is_a_map_too(misaligned: OrientationStudy, tmp_path: Path) -> None:
    draw_sizes(misaligned, size_map(misaligned, np.array([0.5]), np.array([0.4])), tmp_path / "one.png")
    assert _pixels(tmp_path / "one.png", NONE) < 1000


def test_pictures_go_beside_what_a_folder_holds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "summary.json").write_text("{}")
    for more, name in ((), "orientations.png"), (("--sizes", "0.5:0.5:1,0.3:0.3:1"), "orientation_sizes.png"):
        assert main(["orientations", "elliptic", *more, "--output", str(tmp_path)]) == 0
        assert capsys.readouterr().out.endswith(f"\n{tmp_path / name}\n")
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "orientation_sizes.png",
        "orientations.png",
        "summary.json",
    ]


def test_the_same_study_gives_the_same_pictures(misaligned: OrientationStudy, tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        draw_orientations(misaligned, misaligned.profile(), tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
