"""The scene ``potential``: a parcel that cells carry round a wall, knowing their neighbours' words alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from deploy.recordings.reader import load
from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.workers.plan import RunOptions

SINK_M = (0.85, -0.45)


@pytest.mark.parametrize(("change", "over_the_wall"), [("seed=1", True), ("array.missing=[]", False)])
def test_a_parcel_goes_round_the_wall_if_there_is_one_and_comes_to_the_sink(
    change: str, over_the_wall: bool, tmp_path: Path
) -> None:
    scene = load_scene("potential", [Override.parse(change), Override.parse("duration_s=12")])
    options = RunOptions(0, "memory", output=tmp_path, picture=False)
    (parcel,) = run(scene, options, quiet=True).summary.parcels
    assert parcel.state == "moving"
    assert np.hypot(parcel.position_m[0] - SINK_M[0], parcel.position_m[1] - SINK_M[1]) < 0.05
    above = load(tmp_path).run_trace().parcels[:, 0, 1].max() > 0.15
    assert above == over_the_wall
