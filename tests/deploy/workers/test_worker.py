"""What a worker makes of its order."""

from __future__ import annotations

import subprocess
import sys

import numpy as np

from bus.partition import Partition
from cell_firmware.effects.clock.wrapper import LocalClockWrapper
from deploy.runs.setup import sensor_schema
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene
from deploy.workers.worker import WorkerConfig, build_shard, make_controller, modules_of
from plant.plant import Plant


def _order(scene: Scene, shards: int) -> WorkerConfig:
    plant = Plant(scene.plant_spec())
    return WorkerConfig(
        scene=scene,
        array=plant.array,
        partition=Partition.even(plant.array.lattice, shards),
        wire="packed",
        run="r",
        connect="",
        sensors=sensor_schema(scene, plant.sense()),
        register_requests=(),
        metered=False,
        byte_accurate_links=False,
        joins_running=False,
        keys=(),
        own_process=False,
    )


def _scene(*changes: str) -> Scene:
    return load_scene("elliptic", [Override.parse(change) for change in changes])


CLOCK = "effects.clock={ error_ppm = 300.0, exchanges_per_period = 2 }"


def test_a_shard_and_its_stages_have_the_clocks_of_their_own_cells() -> None:
    scene = _scene(CLOCK, "effects.sensor={ debounce_ticks = 2 }")
    every = scene.clocks()
    assert every is not None
    order = _order(scene, 3)
    for index in range(3):
        shard, site, _ = build_shard(order, index)
        own = every.clocks.take(order.partition.cells(index))
        assert site.clocks is not None
        for name in ("ppb", "phase_ns"):
            np.testing.assert_array_equal(getattr(site.clocks, name), getattr(own, name))
        assert (site.clocks.period_ns, site.clocks.window_ns) == (own.period_ns, own.window_ns)
        assert len(shard) == len(own)
        fresh = [site.fresh(tick) for tick in range(1, 9)]
        assert not all(one is None or one.all() for one in fresh), "not every exchange brings a reading"


def test_a_controller_has_the_scene_s_clocks_and_none_without() -> None:
    assert isinstance(make_controller(_scene(CLOCK)), LocalClockWrapper)
    assert not isinstance(make_controller(_scene()), LocalClockWrapper)
    site = build_shard(_order(_scene(), 2), 0).site
    assert site.clocks is None


def test_validators_of_faults_are_built_with_the_shards_of_a_run_that_takes_faults() -> None:
    """Hundreds of processes would build them in the tick of the first fault."""
    code = """
import sys
from dataclasses import replace
from cell_firmware.faults.registry import CELL_FAULTS
from deploy.workers.worker import build_shard
from tests.deploy.workers.test_worker import _order, _scene
order = replace(_order(_scene(), 1), byte_accurate_links=sys.argv[1] == "live")
assert CELL_FAULTS.pydantic_complete is False
build_shard(order, 0)
print(CELL_FAULTS.pydantic_complete)
"""
    found = [
        subprocess.run([sys.executable, "-c", code, kind], capture_output=True, text=True, check=True).stdout
        for kind in ("live", "recorded")
    ]
    assert found == ["True\n", "False\n"]


def test_kernels_of_byte_wise_lines_are_loaded_ahead_where_faults_may_come() -> None:
    scene = load_scene("prototype")
    assert "cell_firmware.kernels.uarts" in modules_of(scene, live=True)
    assert "cell_firmware.kernels.uarts" not in modules_of(scene)
