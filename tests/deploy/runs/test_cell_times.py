"""Cells with clocks of their own and the plant: the same instants on both sides, and runs of both."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from bus.partition import Partition
from cell_firmware.clocks import NOT_IN_WINDOW
from cell_firmware.effects.clock.spec import ClockSpec
from cell_firmware.firmware import Cells
from cell_firmware.shard import Shard
from deploy.recordings.reader import load
from deploy.runs.run import run
from deploy.runs.setup import CellTimingSource, cell_times
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene
from deploy.workers.plan import RunOptions
from deploy.workers.worker import make_controller
from plant.plant import Plant

PERIOD_NS = 4_096_000
ALIGNED = {"error_ppm": 0.0, "phase": "aligned"}


def _scene(name: str, duration_s: float, **effects: object) -> Scene:
    changes = [Override(("duration_s",), duration_s, "")]
    return load_scene(name, [*changes, *(Override(("effects", k), v, "") for k, v in effects.items())])


def _parcels(scene: Scene, folder: Path) -> NDArray[np.float64]:
    """States at every tick of a run."""
    outcome = run(scene, RunOptions(0, "memory", output=folder, picture=False), quiet=True)
    assert outcome.summary.status == "ok", outcome
    return load(folder).parcels


def test_a_scene_without_clocks_has_ticks_of_a_period_and_no_instants() -> None:
    scene = _scene("motors", 1.0)
    assert scene.tick_ns == scene.cells.period_ns == PERIOD_NS
    assert scene.clocks() is None
    assert cell_times(scene) is None


def test_ticks_of_a_scene_with_clocks_are_windows() -> None:
    scene = _scene("motors", 1.0, clock={"error_ppm": 20_000.0, "exchanges_per_period": 3})
    assert scene.tick_ns == PERIOD_NS * 98 // 100 // 3
    assert scene.ticks == -(-1_000_000_000 // scene.tick_ns)
    assert scene.tick_at(0.5) == -(-500_000_000 // scene.tick_ns)


def test_the_plant_lets_cells_act_a_window_after_they_read() -> None:
    lattice = _scene("motors", 1.0).lattice()
    clocks = ClockSpec(error_ppm=60_000).clocks(lattice, PERIOD_NS, 3).clocks
    times, read = CellTimingSource(clocks), np.full(len(lattice), NOT_IN_WINDOW)
    rests = 0
    for tick in range(200):
        acts_ns, reads_ns = times(tick)
        assert (
            acts_ns.tolist()
            == np.where(read == NOT_IN_WINDOW, NOT_IN_WINDOW, read + clocks.window_ns).tolist()
        )
        read = reads_ns
        begin, there = tick * clocks.window_ns, read != NOT_IN_WINDOW
        assert reads_ns.tolist() == clocks.instants(tick).tolist()
        assert ((begin <= read[there]) & (read[there] < begin + clocks.window_ns)).all()
        rests += int((~there).sum())
    assert rests > 0


def test_equal_clocks_move_a_parcel_as_the_field_does_one_window_later(tmp_path: Path) -> None:
    """Drives act a window after their reading, so the first window passes on wheels that stand."""
    plain = _parcels(_scene("elliptic", 0.3), tmp_path / "plain")
    later = _parcels(_scene("elliptic", 0.3 + 0.004096, clock=ALIGNED), tmp_path / "later")
    assert later[0].tobytes() == later[1].tobytes()
    np.testing.assert_allclose(later[1:-1], plain[:-1], rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ["motors", "heat"])
def test_equal_clocks_are_the_lockstep_with_drives_that_act_a_window_later(name: str, tmp_path: Path) -> None:
    """Speed loops and all, against a loop by hand over the plant and cells without clocks."""
    scene, n = _scene(name, 0.2), len(_scene(name, 0.2).lattice())
    plant, drives = Plant(scene.plant_spec()), np.zeros((n, 2))
    array = plant.array
    cells = Cells.of(array.lattice, array.positions_m, scene.cells.period_s)
    shard = Shard(make_controller(scene), cells, Partition.even(array.lattice, 1), 0)
    states = [plant.state]
    for tick in range(scene.ticks):
        sense = plant.sense()
        answer = shard.step(tick, sense.presence, sense.encoder_m).drive
        plant.advance(drives, min((tick + 1) * PERIOD_NS, scene.duration_ns))
        drives = answer
        states.append(plant.state)
    found = _parcels(_scene(name, 0.2, clock=ALIGNED), tmp_path)
    np.testing.assert_allclose(found, np.array(states), rtol=0, atol=1e-13)
    assert np.abs(found[-1] - found[0]).max() > 1e-4


def test_more_exchanges_a_period_bring_drives_nearer_to_their_readings(tmp_path: Path) -> None:
    """With e exchanges a period drives are a period / e late: the error against none late falls in proportion."""
    plain = _parcels(_scene("motors", 1.0), tmp_path / "plain")[-1]
    off = [
        np.abs(
            _parcels(_scene("motors", 1.0, clock={**ALIGNED, "exchanges_per_period": e}), tmp_path / f"{e}")[
                -1
            ]
            - plain
        ).max()
        for e in (1, 4, 16)
    ]
    assert off[0] / off[1] == pytest.approx(4.0, rel=0.2)
    assert off[1] / off[2] == pytest.approx(4.0, rel=0.2)
