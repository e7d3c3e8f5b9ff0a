"""Parcels on islands of cells, side by side in one plant, that a firmware is to turn; and what became of them.

Islands are too far apart for a parcel to reach the next. The cells of an island know their places from its middle and
nothing of the others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bus.lattice import Lattice
from bus.partition import Partition
from bus.random_streams import rng
from bus.sensors import CameraFrame
from cell_firmware.build import build_controller
from cell_firmware.clocks import ArrayClocks
from cell_firmware.controller import Controller
from cell_firmware.effects.base import ShardContext
from cell_firmware.effects.registry import CellEffects
from cell_firmware.firmware import Cells
from cell_firmware.loader import load
from cell_firmware.shard import Shard
from cell_firmware.specs import CellsSpec
from deploy.runs.setup import CellTimingSource
from plant.effects.camera.camera import Camera
from plant.effects.camera.spec import CameraSpec
from plant.plant import Plant
from plant.specs import PlantSpec

Floats = NDArray[np.float64]

CELLS, GAP, PITCH_M = 15, 3, 0.1
SENSORS_M: dict[int, tuple[tuple[float, float], ...]] = {
    1: ((0.0, 0.0),),
    5: ((0.0, 0.0), (0.04, 0.02), (-0.02, 0.04), (-0.04, -0.02), (0.02, -0.04)),
}
"""By their number, where a cell's sensors are: five make a square lattice of 0.1 m / sqrt(5), no two in line."""
PERIOD_NS = 16_384_000


@dataclass(frozen=True)
class Start:
    """A parcel as it begins, on an island of its own; which of that island's cells are dead."""

    size_m: tuple[float, float]
    position_m: tuple[float, float]
    angle_rad: float
    dead: Sequence[tuple[int, int]] = ()


@dataclass(frozen=True)
class Case:
    """What is run.

    Attributes:
        starts: An island each.
        firmware: Name and parameters, but ``size_m`` for ``align``.
        sensors: How many a cell has.
        camera: The effect's settings, where there is one.
        effects: Of the cells, as in a scene.
    """

    starts: Sequence[Start]
    firmware: str
    parameters: Mapping[str, Any]
    sensors: int = 5
    seconds: float = 15.0
    camera: Mapping[str, float] | None = None
    effects: Mapping[str, Any] = field(default_factory=dict[str, Any])
    sample_s: float = 0.1


def run(case: Case) -> tuple[Floats, Floats]:
    """``(t,)`` s, and ``(t, islands, 6)`` states of the parcels from the middle of their islands."""
    width, count = CELLS + GAP, len(case.starts)
    columns = count * width
    middle = (np.arange(count) * width + CELLS // 2 - (columns - 1) / 2) * PITCH_M
    named = [(r, i * width + c) for i in range(count) for r in range(CELLS) for c in range(CELLS)]
    plant = Plant(_spec(case, middle, named, columns))
    lattice = plant.array.lattice
    dead = [(r, i * width + c) for i, start in enumerate(case.starts) for r, c in start.dead]
    plant.release_wheels([lattice.index(cell) for cell in dead], "coast")
    groups = _groups(case)
    partition = Partition(
        lattice, [np.flatnonzero(np.isin(lattice.columns // width, group)) for group in groups]
    )
    effects = CellEffects.model_validate(case.effects)
    clocks = None
    if effects.clock is not None:
        clocks = effects.clock.clocks(lattice, PERIOD_NS, 1)
    tick_ns = PERIOD_NS if effects.clock is None else effects.clock.window_ns(PERIOD_NS)
    times = None if clocks is None else CellTimingSource(clocks.clocks)
    shards = [_shard(case, group[0], s, partition, effects, clocks, width) for s, group in enumerate(groups)]
    for shard in shards:
        shard.retire(dead)
    camera = None
    if case.camera is not None:
        camera = Camera(CameraSpec.model_validate(case.camera), tick_ns, 1, 0 if clocks is None else 1)
    every, seen = max(1, round(case.sample_s * 1e9 / tick_ns)), list[Floats]()
    ticks = int(case.seconds * 1e9 / tick_ns)
    drives, sense = np.zeros((len(lattice), 2)), plant.sense()
    for tick in range(ticks + 1):
        if tick % every == 0 or tick == ticks:
            seen.append(plant.state)
        shown = None if camera is None else camera.capture(tick, plant.state, plant.on_surface)
        for group, shard in zip(groups, shards, strict=True):
            own = None if shown is None else _own(shown, group[0], middle[group[0]])
            drives[shard.indices] = shard.step(tick, sense.presence[shard.indices], camera=own).drive
        sense, _ = plant.advance(drives, (tick + 1) * tick_ns, None if times is None else times(tick))
    states = np.array(seen)
    states[:, :, 0] -= middle
    return np.minimum(np.arange(len(states)) * every, ticks) * tick_ns * 1e-9, states


def _groups(case: Case) -> list[list[int]]:
    """Islands whose cells a shard steps at once: where parcels are alike, and no camera shows each its own."""
    if case.camera is not None:
        return [[i] for i in range(len(case.starts))]
    sizes = [start.size_m for start in case.starts]
    return [[i for i, size in enumerate(sizes) if size == one] for one in dict.fromkeys(sizes)]


def _own(shown: CameraFrame, island: int, middle_m: float) -> CameraFrame:
    """What of a picture concerns an island, as seen from its middle."""
    here = shown.parcel == island
    return CameraFrame(shown.parcel[here], shown.pose[here] - (middle_m, 0.0, 0.0))


def _spec(case: Case, middle: Floats, named: list[tuple[int, int]], columns: int) -> PlantSpec:
    parcels = [
        {
            "size_m": start.size_m,
            "mass_kg": 1.0,
            "position_m": (middle[i] + start.position_m[0], start.position_m[1]),
            "angle_rad": start.angle_rad,
        }
        for i, start in enumerate(case.starts)
    ]
    return PlantSpec.model_validate(
        {
            "array": {
                "rows": CELLS,
                "columns": columns,
                "pitch_m": PITCH_M,
                "cells": named,
                "sensors_m": SENSORS_M[case.sensors],
            },
            "parcels": parcels,
            "friction": {"law": "viscous", "coefficient_s_per_m": 0.2},
        }
    )


def _shard(
    case: Case,
    island: int,
    shard: int,
    partition: Partition,
    effects: CellEffects,
    clocks: ArrayClocks | None,
    width: int,
) -> Shard:
    """A shard of islands like one of them."""
    lattice: Lattice = partition.lattice
    parameters = dict(case.parameters)
    if case.firmware == "align":
        parameters["size_m"] = case.starts[island].size_m
    spec = CellsSpec(firmware=case.firmware, period_s=PERIOD_NS / 1e9, parameters=parameters)
    firmware = load(spec)
    controller: Controller = build_controller(firmware, spec, effects, None, clocks)
    place = np.stack((lattice.columns % width, lattice.rows), axis=1) - CELLS // 2
    cells = Cells.of(lattice, place * PITCH_M, spec.period_s, SENSORS_M[case.sensors], pitch_m=PITCH_M)
    site = ShardContext(partition.cells(shard), case.sensors, controller.link_type, 1)
    return Shard(controller, cells, partition, shard, effects.input_filters(site))


def starts(sizes_m: Sequence[tuple[float, float]], seed: int, dead_percent: float = 0.0) -> list[Start]:
    """A start for each size: up to 0.2 m from the middle along x and y, at any angle; some cells dead."""
    draw = rng(seed, "align.starts")
    found: list[Start] = []
    for size_m in sizes_m:
        x, y = draw.uniform(-0.2, 0.2, 2).tolist()
        angle = float(draw.uniform(0.0, np.pi))
        order = draw.permutation(CELLS * CELLS)[: round(CELLS * CELLS * dead_percent / 100)].tolist()
        found.append(Start(size_m, (x, y), angle, [(i // CELLS, i % CELLS) for i in order]))
    return found


def off_deg(states: Floats, begun: Sequence[Start], target_rad: float = 0.0) -> Floats:
    """By how much each parcel is off the target's angle, degrees: half a turn looks alike, a square's quarter too."""
    alike = np.array([np.pi / 2.0 if start.size_m[0] == start.size_m[1] else np.pi for start in begun])
    error = states[..., 2] - target_rad
    return np.degrees(np.abs(error - alike * np.round(error / alike)))
