"""What a queue of boxes held by a rail costs, beside one box held by the same rail, and beside MuJoCo.

``python tests/benchmarks/plant/contact_queues.py`` measures and prints its method.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from pathlib import Path

import mujoco
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from plant.effects.parcel_contact.spec import ParcelContactSpec
from plant.effects.registry import PlantEffects
from plant.friction.viscous import Viscous
from plant.parcel_spec import ArraySpec, ParcelSpec
from plant.plant import Plant
from plant.solver_specs import ExactSpec
from plant.specs import PlantSpec

BOX_M = 0.25
MASS_KG = 2.0
PITCH_M = 0.1
MU = 0.5
"""Viscous coefficient, s/m."""
G = 9.81
SPEED = 0.3
TICK_NS = 4_096_000
SPACE_M = 1e-3
"""Between neighbours at the start."""
SETTLE = 100
"""Ticks before the ones that are timed."""
STEP_S = 1e-3

METHOD = """\
Method. n boxes of 0.25 m in a row, 1 mm apart at the start, which a belt (viscous law, 0.3 m/s) presses against a rail;
restitution 0. Both engines: the first {settle} ticks of 4.096 ms are not timed, the next {ticks} are; wall time of a
tick, median of {turns} turns in which all sizes take their turn. "/one": over the time of one box at the same rail.
"power": logarithm of that over the logarithm of n. Plant: `exact`, steps of 1 ms while parcels press. MuJoCo: planar
boxes, its default solver and contacts, condim {condim}, timestep 1 ms, the belt as joint damping and a force.
"off": the farthest a box ends from where rigid boxes would be, overlap included.
"""


def columns(count: int) -> int:
    """Columns of cells under a queue."""
    return round((count + 2) * BOX_M / PITCH_M) + 4


def rail(count: int) -> float:
    """Place of the rail, m."""
    return 0.5 * PITCH_M * columns(count) - 0.2


def starts(count: int) -> list[float]:
    """Places of the boxes at the start, m."""
    return [rail(count) - 0.5 * BOX_M - SPACE_M - k * (BOX_M + SPACE_M) for k in range(count)]


def off(count: int, ends: np.ndarray) -> float:
    """How far boxes are from where rigid ones would be, m."""
    return float(np.abs(ends + 0.5 * BOX_M - rail(count) + BOX_M * np.arange(count)).max())


def in_plant(count: int, friction: float, ticks: int) -> tuple[float, float]:
    """Seconds a tick, and how far boxes are off, m."""
    edge = rail(count)
    rules = ParcelContactSpec(rails=(((edge, -0.3), (edge, 0.3)),), friction=friction)
    parcels = tuple(
        ParcelSpec.model_validate({"size_m": (BOX_M, BOX_M), "mass_kg": MASS_KG, "position_m": (x, 0.0)})
        for x in starts(count)
    )
    plant = Plant(
        PlantSpec(
            array=ArraySpec(rows=8, columns=columns(count), pitch_m=PITCH_M),
            parcels=parcels,
            friction=Viscous(coefficient_s_per_m=MU),
            effects=PlantEffects(parcel_contact=rules),
            solver=ExactSpec(),
        )
    )
    drives = np.full((len(plant.array), 2), (SPEED, 0.0))
    for _ in range(SETTLE):
        plant.advance(drives, plant.time_ns + TICK_NS)
    begin = time.perf_counter()
    for _ in range(ticks):
        plant.advance(drives, plant.time_ns + TICK_NS)
    return (time.perf_counter() - begin) / ticks, off(count, plant.state[:, 0])


def in_mujoco(count: int, friction: float, ticks: int) -> tuple[float, float]:
    """The same in MuJoCo."""
    edge, half, rate = rail(count), 0.5 * BOX_M, MU * G
    condim = 1 if friction == 0.0 else 3
    geom = f'condim="{condim}" friction="{friction} 0 0"'
    inertia = MASS_KG * BOX_M * BOX_M / 6.0
    boxes = "".join(
        f'<body pos="{x} 0 0">'
        f'<joint type="slide" axis="1 0 0" damping="{MASS_KG * rate}"/>'
        f'<joint type="slide" axis="0 1 0" damping="{MASS_KG * rate}"/>'
        f'<joint type="hinge" axis="0 0 1" damping="{inertia * rate}"/>'
        f'<inertial pos="0 0 0" mass="{MASS_KG}" diaginertia="1 1 {inertia}"/>'
        f'<geom type="box" size="{half} {half} {half}" {geom}/></body>'
        for x in starts(count)
    )
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option gravity="0 0 0" timestep="{STEP_S}"/><worldbody>'
        f'<geom type="box" pos="{edge + 0.1} 0 0" size="0.1 0.3 {half}" {geom}/>{boxes}</worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    data.qfrc_applied[0::3] = MASS_KG * rate * SPEED
    tick_s = TICK_NS * 1e-9
    while data.time < SETTLE * tick_s:
        mujoco.mj_step(model, data)
    begin, steps = time.perf_counter(), 0
    while data.time < (SETTLE + ticks) * tick_s:
        mujoco.mj_step(model, data)
        steps += 1
    spent = (time.perf_counter() - begin) / (steps * STEP_S / tick_s)
    return spent, off(count, np.array(starts(count)) + data.qpos[0::3])


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", type=int, nargs="+", default=[2, 5, 10, 20, 50])
    parser.add_argument("--friction", type=float, default=0.0)
    parser.add_argument("--ticks", type=int, default=50)
    parser.add_argument("--turns", type=int, default=5)
    chosen = parser.parse_args()
    condim = 1 if chosen.friction == 0.0 else 3
    print(METHOD.format(settle=SETTLE, ticks=chosen.ticks, turns=chosen.turns, condim=condim))
    sizes = [1, *chosen.sizes]
    engines = {"plant": in_plant, "MuJoCo": in_mujoco}
    in_plant(2, chosen.friction, 1)  # compiles
    spent: dict[tuple[str, int], list[float]] = {(name, n): [] for name in engines for n in sizes}
    error: dict[tuple[str, int], float] = {}
    for _ in range(chosen.turns):
        for n in sizes:
            for name, engine in engines.items():
                seconds, error[name, n] = engine(n, chosen.friction, chosen.ticks)
                spent[name, n].append(seconds)
    print(f"friction {chosen.friction:g}")
    print(
        f"{'n':>4} {'plant ms':>9} {'/one':>7} {'power':>6} {'off m':>8}   {'MuJoCo ms':>9} {'/one':>7} {'off m':>8}"
    )
    for n in sizes:
        ours, theirs = (statistics.median(spent[name, n]) for name in engines)
        first, second = (
            ratio / statistics.median(spent[name, 1]) for ratio, name in ((ours, "plant"), (theirs, "MuJoCo"))
        )
        power = np.log(first) / np.log(n) if n > 1 else 0.0
        print(
            f"{n:4d} {1e3 * ours:9.3f} {first:7.2f} {power:6.2f} {error['plant', n]:8.1e}   "
            f"{1e3 * theirs:9.3f} {second:7.2f} {error['MuJoCo', n]:8.1e}"
        )


if __name__ == "__main__":
    main()
