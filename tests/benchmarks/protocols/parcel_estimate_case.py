"""Arrays side by side, each with a parcel that the firmware ``parcel_estimate`` brings to its middle.

A plant carries all of them: they are islands in one lattice, too far apart for a parcel to reach the next. The cells of
an island know their places from its middle, and nothing of the others; that a cell does the same alone as among
thousands makes it the same as a run for each.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.build import build_controller
from cell_firmware.clocks import ArrayClocks
from cell_firmware.effects.base import ShardContext
from cell_firmware.effects.registry import CellEffects
from cell_firmware.firmware import Cells
from cell_firmware.loader import load
from cell_firmware.shard import Shard
from cell_firmware.specs import CellsSpec
from deploy.runs.setup import CellTimingSource
from plant.loads import find_supports
from plant.plant import Plant
from plant.specs import PlantSpec

GAP, PITCH_M = 3, 0.1
SENSORS_M: dict[int, tuple[tuple[float, float], ...]] = {
    1: ((0.0, 0.0),),
    3: ((0.0, 0.0), (0.03, 0.015), (-0.015, 0.03)),
    5: ((0.0, 0.0), (0.03, 0.015), (-0.015, 0.03), (-0.03, -0.015), (0.015, -0.03)),
}
"""By their number, where a cell's sensors are: no two in line with each other along rows or columns."""
_IMPLICIT = {"name": "implicit", "tolerance": 1e-4}


@dataclass(frozen=True)
class Case:
    """What is run.

    Attributes:
        size_m: The parcels' sides.
        cells: Rows, and columns, of an island; odd, so that a cell is in its middle.
        dead_percent: Share of the cells that are dead from the start.
        dying_percent: Share of the cells that die one by one, evenly over the run.
        sensors: How many a cell has.
        effects: Of the cells, as in a scene.
        wheel_m: Width of the wheels: over which a cell comes to carry; 0: points.
    """

    size_m: tuple[float, float]
    cells: int = 25
    dead_percent: float = 0.0
    dying_percent: float = 0.0
    sensors: int = 1
    seeds: int = 20
    seconds: float = 30.0
    period_ns: int = 16_384_000
    sample_s: float = 0.2
    speed_m_s: float = 0.2
    gain_per_s: float = 0.5
    effects: Mapping[str, Any] = field(default_factory=dict[str, Any])
    wheel_m: float = 0.0


@dataclass(frozen=True)
class Course:
    """What came of it.

    Attributes:
        time_s: ``(t,)``.
        truth: ``(t, seeds, 6)``, the parcels' states, from the middle of their islands.
        estimate: ``(t, seeds, 4)``, of the group on whose living cells most of the parcel is: centre and direction; NaN
            where no leader knows a pose.
        leaders: ``(t, seeds)``, how many know one.
        status: What became of the parcels.
    """

    time_s: NDArray[np.float64]
    truth: NDArray[np.float64]
    estimate: NDArray[np.float64]
    leaders: NDArray[np.int64]
    status: Sequence[str]


def run(case: Case) -> Course:
    """The case, one parcel a seed."""
    width, half = case.cells + GAP, case.cells // 2
    columns = case.seeds * width
    named = [
        (r, s * width + c) for s in range(case.seeds) for r in range(case.cells) for c in range(case.cells)
    ]
    middle: NDArray[np.float64] = np.array(
        [(seed * width + half - (columns - 1) / 2) * PITCH_M for seed in range(case.seeds)]
    )
    parcels, dead, dying = _chances(case, middle)
    wide = (
        {"effects": {"contact_width": {"width_m": case.wheel_m}}, "solver": _IMPLICIT} if case.wheel_m else {}
    )
    spec = PlantSpec.model_validate(
        {
            **wide,
            "array": {
                "rows": case.cells,
                "columns": columns,
                "pitch_m": PITCH_M,
                "cells": named,
                "sensors_m": SENSORS_M[case.sensors],
            },
            "parcels": parcels,
            "friction": {"law": "viscous", "coefficient_s_per_m": 0.2},
        }
    )
    plant, lattice = Plant(spec), spec.array.lattice()
    lost = np.array([lattice.index(cell) for cell in dead], dtype=np.int64)
    plant.release_wheels(lost.tolist(), "coast")
    clock = CellEffects.model_validate(case.effects).clock
    clocks = None if clock is None else clock.clocks(lattice, case.period_ns, 1)
    times = None if clocks is None else CellTimingSource(clocks.clocks)
    tick_ns = case.period_ns if clock is None else clock.window_ns(case.period_ns)
    shard = _shard(case, lattice, lost, width, clocks)
    ticks = int(case.seconds * 1e9 / tick_ns)
    every = max(1, round(case.sample_s * 1e9 / tick_ns))
    time_s: list[float] = []
    truths: list[NDArray[np.float64]] = []
    looks: list[tuple[NDArray[np.float64], NDArray[np.int64]]] = []
    drives, sense = np.zeros((len(lattice), 2)), plant.sense()
    for tick in range(ticks):
        for cell in dying[round(len(dying) * tick / ticks) : round(len(dying) * (tick + 1) / ticks)]:
            shard.retire([cell])
            plant.release_wheels([lattice.index(cell)], "coast")
        if tick % every == 0:
            time_s.append(tick * tick_ns * 1e-9)
            truths.append(plant.state)
            looks.append(_look(shard, case.seeds, width))
        drives[shard.indices] = shard.step(tick, sense.presence[shard.indices]).drive
        sense, _ = plant.advance(drives, (tick + 1) * tick_ns, None if times is None else times(tick))
    truth = np.array(truths)
    truth[:, :, 0] -= middle
    return Course(
        np.array(time_s),
        truth,
        np.array([found for found, _ in looks]),
        np.array([number for _, number in looks]),
        [status.state for status in plant.status],
    )


def _chances(
    case: Case, middle: NDArray[np.float64]
) -> tuple[list[dict[str, Any]], list[tuple[int, int]], list[tuple[int, int]]]:
    """Where parcels begin, which cells are dead, and which will die in which order; by seed, whatever the case asks."""
    width, radius = case.cells + GAP, 0.5 * float(np.hypot(*case.size_m))
    reach = case.cells * PITCH_M / 2 - radius - PITCH_M
    parcels: list[dict[str, Any]] = []
    dead: list[tuple[int, int]] = []
    dying: list[tuple[int, int]] = []
    for seed in range(case.seeds):
        chance = np.random.default_rng([seed, *(round(1e3 * side) for side in case.size_m)])
        x, y, angle = _standing(case, reach, chance)
        parcels.append(
            {"size_m": case.size_m, "mass_kg": 1.0, "position_m": (middle[seed] + x, y), "angle_rad": angle}
        )
        order = [
            (int(i) // case.cells, seed * width + int(i) % case.cells)
            for i in chance.permutation(case.cells * case.cells)
        ]
        first = round(case.cells * case.cells * case.dead_percent / 100)
        dead += order[:first]
        dying += order[first : first + round(case.cells * case.cells * case.dying_percent / 100)]
    turn = np.random.default_rng(case.seeds).permutation(len(dying))
    return parcels, dead, [dying[int(i)] for i in turn]


def _standing(case: Case, reach_m: float, chance: np.random.Generator) -> tuple[float, float, float]:
    """A pose drawn evenly of those in which a parcel does not tip over at once."""
    place = (np.arange(case.cells) - case.cells // 2).astype(np.float64) * PITCH_M
    grid = np.stack(np.meshgrid(place, place), axis=-1).reshape(-1, 2)
    while True:
        x, y = chance.uniform(-reach_m, reach_m, 2)
        angle = chance.uniform(0.0, np.pi)
        offsets: NDArray[np.float64] = grid - np.array([x, y])
        along = offsets @ (np.cos(angle), np.sin(angle))
        across = offsets @ (-np.sin(angle), np.cos(angle))
        under = (abs(along) <= case.size_m[0] / 2) & (abs(across) <= case.size_m[1] / 2)
        if under.any() and find_supports(offsets[under], np.ones(under.sum(), dtype=np.bool_), PITCH_M):
            return float(x), float(y), float(angle)


def _shard(
    case: Case, lattice: Lattice, lost: NDArray[np.int64], width: int, clocks: ArrayClocks | None
) -> Shard:
    """The living cells; the dead ones are a shard that nobody steps."""
    spec = CellsSpec(
        firmware="parcel_estimate",
        period_s=case.period_ns / 1e9,
        parameters={
            "size_m": case.size_m,
            "target_m": (0.0, 0.0),
            "speed_m_s": case.speed_m_s,
            "gain_per_s": case.gain_per_s,
        },
    )
    firmware = load(spec)
    place = (np.stack((lattice.columns % width, lattice.rows), axis=1) - case.cells // 2).astype(np.float64)
    cells = Cells.of(lattice, place * PITCH_M, spec.period_s, SENSORS_M[case.sensors], pitch_m=PITCH_M)
    living = np.setdiff1d(np.arange(len(lattice)), lost)
    partition = Partition(lattice, [living, np.sort(lost)] if len(lost) else [living])
    effects = CellEffects.model_validate(case.effects)
    controller = build_controller(firmware, spec, effects, None, clocks)
    site = ShardContext(partition.cells(0), case.sensors, controller.link_type, 1)
    return Shard(controller, cells, partition, 0, effects.input_filters(site))


def _look(shard: Shard, seeds: int, width: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """What leaders believe: that of each island whose group is on its feet best, and how many there are."""
    cells, registers = shard.registers()
    own = {name.removeprefix("firmware."): array for name, array in registers.items()}
    found, number = np.full((seeds, 4), np.nan), np.zeros(seeds, dtype=np.int64)
    best = np.zeros(seeds)
    for i in np.flatnonzero(own["leads"] & (own["age"] < 255)):
        island = int(cells[i, 1]) // width
        number[island] += 1
        if own["grip"][i] > best[island]:
            best[island] = own["grip"][i]
            found[island] = (*own["centre_m"][i], *own["direction"][i])
    return found, number
