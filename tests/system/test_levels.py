"""Levels, from the plant to the firmware of either form."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from bus.wire.keys import WireFormat
from deploy.recordings.reader import load
from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.workers.plan import RunOptions, Transport
from plant.plant import Plant

PLAIN = """
from cell_firmware.cell import CellFirmware, CellOutputs

class Followers(CellFirmware):
    def init(self, cell):
        return None

    def step(self, state, inputs):
        return state, CellOutputs((inputs.level[0], 0.5 * inputs.level[1]))
"""
ARRAYS = """
import numpy as np
from cell_firmware.firmware import Firmware, Outputs

class Followers(Firmware):
    def init(self, cells):
        return {}

    def step(self, state, inputs):
        return state, Outputs(inputs.level * np.array([1.0, 0.5]))
"""
"""Wheels as fast as their cell's spots are covered."""


@pytest.mark.parametrize(
    ("firmware", "transport", "wire"),
    [
        (ARRAYS, "memory", "packed"),
        (ARRAYS, "memory", "per_cell"),
        (PLAIN, "memory", "packed"),
        (PLAIN, "zenoh", "per_cell"),
    ],
)
@pytest.mark.parametrize("adc", [False, True])
def test_firmware_reads_what_the_plant_has_as_the_converter_has_it(
    firmware: str,
    transport: Transport,
    wire: WireFormat,
    adc: bool,
    small: Callable[[str], Path],
    tmp_path: Path,
) -> None:
    (tmp_path / "followers.py").write_text(firmware)
    effects = {"analogue_sensors": {"spot_radius_m": 0.05}} | ({"adc": {}} if adc else {})
    scene = load_scene(
        str(small("[[faults]]\nkind = 'crash'\nat_s = 0.05\ncell = [0, 2]\n[stall]\npolicy = 'brake'\n")),
        [
            Override(("cells",), {"firmware": str(tmp_path / "followers.py")}, ""),
            Override(("array", "sensors_m"), [[0.0, 0.01], [-0.02, 0.0]], ""),
            Override(("effects",), effects, ""),
        ],
    )
    options = RunOptions(0, transport, wire, output=tmp_path, picture=False)
    assert run(scene, options, quiet=True).summary.status == "ok"
    recorded = load(tmp_path)
    # the same parcel, moved by the drives that were recorded
    plant, partly = Plant(scene.plant_spec()), 0
    (crashed,) = (i for i, cell in enumerate(plant.array.lattice.cells) if cell == (0, 2))
    for tick, drives in enumerate(recorded.drives[:-1]):
        level = plant.sense().level
        assert level is not None
        wanted = np.minimum(np.floor(256 * level), 255) / 256 if adc else level.copy()
        partly += np.count_nonzero((wanted > 0.0) & (wanted < 0.99))
        if tick * 0.004096 >= 0.05:
            wanted[crashed] = 0.0
        assert drives.tobytes() == (wanted * [1.0, 0.5]).tobytes()
        plant.advance(drives, min((tick + 1) * scene.cells.period_ns, scene.duration_ns))
    assert partly > 100
