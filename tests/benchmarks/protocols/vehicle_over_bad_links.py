"""What ``virtual_vehicle`` comes to where messages, sensors, clocks and cells fail: arrivals, delays, errors.

``python tests/benchmarks/protocols/vehicle_over_bad_links.py`` prints its method and its figures.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.board import Board
from cell_firmware.effects.base import ShardContext
from cell_firmware.effects.clock.mailbox import Mailbox
from cell_firmware.effects.clock.wrapper import LocalClockWrapper
from cell_firmware.effects.registry import CellEffects
from cell_firmware.firmware import Cells
from cell_firmware.loader import load
from cell_firmware.protocols.virtual_vehicle import ARRIVED, CARRIES
from cell_firmware.shard import Shard
from cell_firmware.specs import CellsSpec
from deploy.runs.setup import CellTimingSource
from plant.plant import Plant
from plant.sampling import Timing
from plant.specs import PlantSpec

ROWS, COLUMNS, PERIOD_S, DURATION_S = 9, 13, 0.016384, 12.0
START, END, ANGLE = (-0.35, -0.05), (0.25, -0.05), 1.5707963267948966
VEHICLE = {
    "start_m": START,
    "radius_m": 0.3,
    "speed_m_s": 0.2,
    "turn_rate_rad_s": 0.5,
    "legs": [{"to_m": END}, {"turn_rad": ANGLE}],
}
CASES: dict[str, tuple[dict[str, Any], float]] = {
    "as they are": ({}, 0.0),
    "loss 0.05": ({"link_loss": {"probability": 0.05}}, 0.0),
    "loss 0.2": ({"link_loss": {"probability": 0.2}}, 0.0),
    "delay 0 to 4": ({"link_delay": {"between_ticks": [0, 4]}}, 0.0),
    "clocks within 1 %": ({"clock": {"error_ppm": 10_000}}, 0.0),
    "sensors err, 0.05": ({"sensor": {"false_positive": 0.05, "false_negative": 0.05}}, 0.0),
    "dead 0.05": ({}, 0.05),
    "dead 0.1": ({}, 0.1),
    "dead 0.2": ({}, 0.2),
    "dead 0.1, loss 0.2": ({"link_loss": {"probability": 0.2}}, 0.1),
}
METHOD = f"""\
Method. One vehicle on {ROWS} x {COLUMNS} cells, pitch 0.1 m, periods of {PERIOD_S * 1e3:g} ms: from {START} to
{END} m at 0.2 m/s, then a quarter turn at 0.5 rad/s, 6.14 s in all; {DURATION_S:g} s are simulated. Viscous friction,
0.3 s/m; a parcel of 0.42 x 0.29 m that begins up to 0.02 m along each axis and 0.1 rad off, by the seed; {{seeds}}
seeds, each on a floor of its own. Cells die (their wheels turn freely) at one instant each in the first 5 s.
"arrived": the record is at its end and the parcel within 0.05 m of it. "late": of the record's end after the
journey's time, s. "off": of the parcel's centre, mm; "turned off": of its angle, degrees; medians and worst of those
that arrived. "told": of the others, those in which no living cell says that it carries the vehicle.
"""


@dataclass
class Floors:
    """As many floors as seeds, in one array of cells that knows no links between them; a plant for each."""

    plants: list[Plant]
    shard: Shard
    lattice: Lattice
    times: CellTimingSource | None
    tick_ns: int

    @staticmethod
    def of(effects: CellEffects, seeds: int) -> Floors:
        rows = ROWS + 1  # a row of nothing between two floors
        places = [(f * rows + r, c) for f in range(seeds) for r in range(ROWS) for c in range(COLUMNS)]
        lattice = Lattice(places)
        plants = [Plant(_plant(seed)) for seed in range(seeds)]
        spec = CellsSpec(
            firmware="virtual_vehicle",
            period_s=PERIOD_S,
            parameters={"vehicles": [VEHICLE], "centring_per_s": [0.7, 2.0]},
        )
        firmware, partition = load(spec), Partition.even(lattice, 1)
        position = np.tile(plants[0].array.positions_m, (seeds, 1))
        cells = Cells.of(lattice, position, PERIOD_S, pitch_m=0.1)
        clock = effects.clock
        if clock is None:
            controller, times, tick_ns = Board(firmware), None, spec.period_ns
        else:
            clocks = clock.clocks(lattice, spec.period_ns, 0)
            assert firmware.message is not None
            box = Mailbox(firmware.message, clocks.clocks.window_ns)
            controller = LocalClockWrapper(Board(firmware, None, box), clocks)
            times, tick_ns = CellTimingSource(clocks.clocks), clocks.clocks.window_ns
        site = ShardContext(partition.cells(0), 1, controller.link_type, 0)
        return Floors(
            plants,
            Shard(controller, cells, partition, 0, effects.input_filters(site)),
            lattice,
            times,
            tick_ns,
        )


def _plant(seed: int) -> PlantSpec:
    off = np.random.default_rng(seed).uniform(-1.0, 1.0, 3)
    parcel = {
        "size_m": (0.42, 0.29),
        "mass_kg": 1.5,
        "position_m": (START[0] + 0.02 * off[0], START[1] + 0.02 * off[1]),
        "angle_rad": 0.1 * off[2],
    }
    return PlantSpec.model_validate(
        {
            "array": {"rows": ROWS, "columns": COLUMNS},
            "parcels": [parcel],
            "friction": {"law": "viscous", "coefficient_s_per_m": 0.3},
            "solver": {"name": "exact", "tolerance": 1e-6},
        }
    )


@dataclass
class Course:
    """What came of all floors: end poses ``(seeds, 3)``, when records ended (s; NaN: never), what cells said."""

    pose: NDArray[np.float64]
    ended_s: NDArray[np.float64]
    told: NDArray[np.bool_]


def course(effects: CellEffects, dead: float, seeds: int) -> Course:
    """Lets all floors run."""
    floors, size = Floors.of(effects, seeds), ROWS * COLUMNS
    chance = np.random.default_rng(17)
    n = len(floors.lattice)
    dies = np.where(chance.uniform(size=n) < dead, chance.integers(0, int(5e9 / floors.tick_ns), n), -1)
    ended = np.full(seeds, np.nan)
    presence = np.concatenate([plant.sense().presence for plant in floors.plants])
    state = np.zeros(n, dtype=np.int64)
    for tick in range(round(DURATION_S * 1e9 / floors.tick_ns)):
        gone = np.flatnonzero(dies == tick)
        floors.shard.retire(floors.lattice.cells[cell] for cell in gone)
        for cell in gone:
            floors.plants[cell // size].release_wheels([cell % size], "coast")
        drive = floors.shard.step(tick, presence).drive
        timing = None if floors.times is None else floors.times(tick)
        for f, plant in enumerate(floors.plants):
            own = slice(f * size, (f + 1) * size)
            part = None if timing is None else Timing(timing.acts_ns[own], timing.reads_ns[own])
            sense, _ = plant.advance(drive[own], (tick + 1) * floors.tick_ns, part)
            presence[own] = sense.presence
        places, registers = floors.shard.registers()
        state[:] = 0
        state[floors.lattice.find(places[:, 0], places[:, 1])] = registers["firmware.state"]
        arrived = (state == ARRIVED).reshape(seeds, size).any(axis=1)
        ended = np.where(np.isnan(ended) & arrived, (tick + 1) * floors.tick_ns * 1e-9, ended)
    pose = np.array([plant.state[0, :3] for plant in floors.plants])
    told = (state != CARRIES).reshape(seeds, size).all(axis=1)
    return Course(pose, ended, told)


def row(name: str, found: Course) -> str:
    """One line of the table."""
    off = np.hypot(*(found.pose[:, :2] - END).T)
    arrived = ~np.isnan(found.ended_s) & (off < 0.05)
    late = found.ended_s[arrived] - 6.1416
    turned = np.degrees(abs(found.pose[arrived, 2] - ANGLE))
    figures = "".join(
        f"{np.median(values):9.{digits}f}{values.max():8.{digits}f}" if len(values) else f"{'-':>9}{'-':>8}"
        for values, digits in ((late, 2), (off[arrived] * 1e3, 1), (turned, 1))
    )
    return f"{name:22}{arrived.sum():8}{figures}{(found.told & ~arrived).sum():6} of {(~arrived).sum()}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=50)
    seeds = parser.parse_args().seeds
    print(METHOD.format(seeds=seeds))
    print(
        f"{'':22}{'arrived':>8}{'late':>9}{'worst':>8}{'off':>9}{'worst':>8}{'turned off':>11}{'worst':>6}  told"
    )
    for name, (tables, dead) in CASES.items():
        print(row(name, course(CellEffects.model_validate(tables), dead, seeds)), flush=True)


if __name__ == "__main__":
    main()
