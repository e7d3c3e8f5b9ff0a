"""A constant field through cells is the constant field of the simulator."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from deploy.runs.field_simulation import simulate
from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.workers.plan import RunOptions


def test_run_and_simulate_agree_on_the_elliptic_scene_after_ten_seconds(tmp_path: Path) -> None:
    options = RunOptions(0, "memory", output=tmp_path / "run", picture=False)
    through_cells = run(load_scene("elliptic"), options, quiet=True).summary
    tight = load_scene("elliptic", [Override(("solver", "tolerance"), 1e-12, "")])
    alone = simulate(tight, output=tmp_path / "simulate", picture=False, quiet=True).summary
    for a, b in zip(through_cells.parcels, alone.parcels, strict=True):
        assert np.allclose(a.position_m, b.position_m, rtol=0.0, atol=1e-9)
        assert a.angle_rad == pytest.approx(b.angle_rad, abs=1e-9)
        assert a.state == b.state
    assert through_cells.support_changes == alone.support_changes
    assert through_cells.ticks == alone.ticks
