"""What a worker makes of its order."""

from __future__ import annotations

import numpy as np

from bus.partition import Partition
from cell_firmware.effects.clock.wrapper import LocalClockWrapper
from deploy.runs.setup import sensor_schema
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene
from deploy.workers.worker import WorkerConfig, build_shard, make_controller
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
