"""What capturing chatter costs in accuracy and saves in time, on random scenes.

``python tests/benchmarks/plant/captured_chatter.py`` measures and prints its method.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from plant.errors import PlantError, PlantUnstable
from plant.friction.viscous import Viscous
from plant.parcel_spec import ArraySpec, ParcelSpec
from plant.plant import Plant
from plant.solver_specs import ExactSpec
from plant.specs import PlantSpec

SECONDS = 6
SAMPLE_NS = 20_000_000
LOCATED_M = 1e-10
"""A capture this small lets every crossing of these runs be located."""
CAPTURES_M = (1e-5, 1e-6, 1e-7, 1e-8)
NUDGES = ((1e-9, 0.0), (-1e-9, 0.0), (0.0, 1e-8), (0.0, -1e-8))
"""Changes of the start: rad of the angle, m/s of the velocity."""

METHOD = """\
Method. {scenes} random scenes of {seconds} s: up to 40 % of the cells missing, rectangles whose mass is off the centre,
fields that draw them to the middle. Compared with a run that locates every crossing (capture_m {located:g}): how far
apart a point as far out as the farthest corner is at most. "nudged" is the located run itself, begun 1e-9 rad or
1e-8 m/s beside: the farthest of {nudges} such runs. Only scenes in which a capture_m of 1e-6 captures something count.
"""


def scene(seed: int, capture_m: float, nudge: tuple[float, float]) -> tuple[Plant, np.ndarray]:
    """A plant and its wheel speeds; the same seed gives the same scene whatever the capture."""
    draw = np.random.default_rng([seed, 0x6D646D73])
    rows, columns = (int(n) for n in draw.integers(8, 18, 2))
    cells = [(r, c) for r in range(rows) for c in range(columns)]
    holes = draw.choice(len(cells), int(len(cells) * draw.uniform(0.0, 0.4)), replace=False)
    size = draw.uniform(0.12, 0.7, 2)
    body = ParcelSpec(
        size_m=(float(size[0]), float(size[1])),
        mass_kg=float(draw.uniform(0.5, 5.0)),
        centre_of_mass_m=tuple(float(v) for v in 0.15 * draw.uniform(-1.0, 1.0, 2) * size),
        position_m=tuple(float(v) for v in draw.uniform(-0.2, 0.2, 2)),
        angle_rad=float(draw.uniform(-3.0, 3.0)) + nudge[0],
        velocity_m_s=(nudge[1], 0.0),
    )
    plant = Plant(
        PlantSpec(
            array=ArraySpec(rows=rows, columns=columns, pitch_m=0.1, missing=tuple(cells[i] for i in holes)),
            parcels=(body,),
            friction=Viscous(coefficient_s_per_m=float(10.0 ** draw.uniform(-1.0, 0.5))),
            solver=ExactSpec(tolerance=1e-11, capture_m=capture_m),
        )
    )
    places = plant.array.positions_m
    if draw.random() < 0.5:
        return plant, -places * draw.uniform(0.3, 3.0, 2)
    return plant, -np.sign(places) * draw.uniform(0.1, 0.8, 2)


def run(
    seed: int, capture_m: float, nudge: tuple[float, float] = (0.0, 0.0)
) -> tuple[np.ndarray, bool, int, float]:
    """Poses ``(samples, 3)`` with the angle in metres at the farthest corner; captured?; changes; s of processor."""
    plant, drives = scene(seed, capture_m, nudge)
    begun = time.process_time()
    result = plant.trajectory(drives, SECONDS * 1_000_000_000, SAMPLE_NS)
    spent = time.process_time() - begun
    radius = float(np.max(np.hypot(*plant.footprints_m[0].T)))
    captured = any(event.kind == "captured" for event in result.events)
    return result.state[:, 0, :3] * (1.0, 1.0, radius), captured, plant.support_changes, spent


def apart(a: np.ndarray, b: np.ndarray) -> float:
    """Largest displacement between two runs, m."""
    return float(np.max(np.hypot(*(a - b)[:, :2].T) + np.abs(a - b)[:, 2]))


def compare(seed: int) -> list[tuple[float, int, float]] | None:
    """(error, changes, time) for each of ``CAPTURES_M``, the located run and the nudged; None: nothing to compare."""
    try:
        if not run(seed, 1e-6)[1]:
            return None
        exact, _, changes, spent = run(seed, LOCATED_M)
        rows = []
        for capture_m in CAPTURES_M:
            poses, _, count, cost = run(seed, capture_m)
            rows.append((apart(poses, exact), count, cost))
        rows.append((0.0, changes, spent))
        rows.append((max(apart(run(seed, LOCATED_M, nudge)[0], exact) for nudge in NUDGES), changes, spent))
    except (PlantError, PlantUnstable):
        return None
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=400)
    scenes = parser.parse_args().scenes
    found = [(seed, rows) for seed in range(scenes) if (rows := compare(seed)) is not None]
    print(METHOD.format(scenes=scenes, seconds=SECONDS, located=LOCATED_M, nudges=len(NUDGES)))
    print(f"{len(found)} scenes captured\n")
    print(f"{'capture_m':>10}{'changes':>9}{'ms':>8}{'error, m: median':>18}{'90 %':>9}{'worst':>9}")
    for i, name in enumerate((*(f"{c:g}" for c in CAPTURES_M), "located", "nudged")):
        errors, changes, costs = np.array([rows[i] for _, rows in found]).T
        at = np.quantile(errors, (0.5, 0.9, 1.0))
        print(
            f"{name:>10}{np.median(changes):9.0f}{1e3 * np.median(costs):8.2f}"
            f"{at[0]:18.1e}{at[1]:9.1e}{at[2]:9.1e}"
        )
    print("\nworst at 1e-6, and how far the located run itself moves when its start does:")
    for seed, rows in sorted(found, key=lambda entry: -entry[1][1][0])[:8]:
        print(f"  scene {seed:4}: {rows[1][0]:.1e} m, nudged {rows[-1][0]:.1e} m")


if __name__ == "__main__":
    main()
