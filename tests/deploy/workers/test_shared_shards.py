"""Shards that are built before their processes are forked, and the modules that the fork server has by then."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, get_args

import pytest

from bus.partition import Partition
from bus.wire.keys import WireFormat
from deploy.runs.setup import sensor_schema
from deploy.scenes.files import load_scene
from deploy.workers.groups import PRELOAD
from deploy.workers.pool import WorkerPool
from deploy.workers.shared_shards import share_shards
from deploy.workers.worker import WorkerConfig, build_shard, modules_of
from plant.plant import Plant
from tests.deploy.workers import forked


def _order(name: str, shards: int | None = None, **settings: Any) -> WorkerConfig:
    """Order of a run of a bundled scene; by default with a process for each cell."""
    scene = load_scene(name, [])
    plant = Plant(scene.plant_spec())
    order = WorkerConfig(
        scene=scene,
        array=plant.array,
        partition=Partition.even(plant.array.lattice, shards or len(plant.array)),
        wire="relayed",
        run="r",
        connect="",
        sensors=sensor_schema(scene, plant.sense()),
        register_requests=(),
        metered=True,
        byte_accurate_links=False,
        joins_running=False,
        keys=(),
        own_process=shards is None,
    )
    return replace(order, **settings)


@pytest.mark.parametrize("wire", get_args(WireFormat))
@pytest.mark.parametrize("scene", ["prototype", "heat"])
def test_the_shards_of_all_workers_are_built_once_and_have_not_been_stepped(scene: str, wire: str) -> None:
    order = _order(scene, wire=wire)
    shared = share_shards(order)
    assert isinstance(shared, partial), "the workers build their shards themselves"
    built = [one.cells for one in shared.args[1]]
    assert [shard.cells for shard in built] == [(cell,) for cell in order.array.lattice.cells]
    for index in (0, len(built) - 1):
        shard, expected = built[index], build_shard(order, index).cells
        assert shard.tick == expected.tick == -1
        assert (shard.counters(), shard.alive) == (expected.counters(), expected.alive)


def test_large_shards_are_left_to_their_workers() -> None:
    order = _order("heat", shards=2)
    assert share_shards(order) is order


def test_a_program_of_a_user_runs_in_the_processes_of_its_cells_alone(tmp_path: Path) -> None:
    program = tmp_path / "ours.py"
    program.write_text(
        "from pathlib import Path\nfrom mdms import CellFirmware, CellOutputs\n"
        "Path(__file__).with_suffix('.imported').touch()\n"
        "class Ours(CellFirmware):\n    def step(self, cell, inputs):\n        return CellOutputs()\n"
    )
    order = _order("prototype")
    cells = order.scene.cells.model_copy(update={"firmware": str(program), "parameters": {}})
    order = replace(order, scene=order.scene.model_copy(update={"cells": cells}))
    assert share_shards(order) is order
    assert not program.with_suffix(".imported").exists()


UNUSED = (
    "PIL",
    "deploy.commands",
    "deploy.recordings",
    "deploy.runs",
    "lz4",
    "matplotlib",
    "mcap",
    "numba.np.arraymath",
    "plant.kernels",
    "plant.plant",
    "plant.solvers",
    "rich",
    "scipy.linalg",
    "typer",
)
"""Modules that no cell uses."""


def _used(modules: set[str], name: str) -> bool:
    return any(module == name or module.startswith(f"{name}.") for module in modules)


@pytest.mark.parametrize(
    ("scene", "shards", "kernels"), [("elliptic", 1, False), ("heat", None, True), ("prototype", None, True)]
)
def test_a_fork_server_imports_nothing_that_the_cells_of_its_scene_do_not_use(
    scene: str, shards: int | None, kernels: bool, tmp_path: Path
) -> None:
    order = _order(scene, shards)
    report = tmp_path / "modules"
    with WorkerPool((*PRELOAD, *modules_of(order.scene))) as crew:
        crew.start(forked.ReportModules(order, str(report)), ["only"], forked.prepared)
        assert crew.wait(60.0)
        assert crew.failures == []
    modules = set(report.read_text().split())
    assert [name for name in UNUSED if _used(modules, name)] == []
    assert _used(modules, "numba") is kernels
    programs = {name for name in modules if name.startswith("cell_firmware.protocols.")}
    assert programs == {f"cell_firmware.protocols.{order.scene.cells.firmware}"}
