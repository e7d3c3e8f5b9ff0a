"""The viscous coefficient that emerges from rollers' impacts (effect ``roller_impacts``), and how far motions scatter.

``python tests/benchmarks/plant/emerging_friction.py`` measures and prints its method.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from plant.plant import Plant
from plant.specs import PlantSpec

METHOD = """\
Method. 20 x 20 cells at a pitch of 0.1 m, a parcel of 0.54 x 0.32 m that starts at rest,
impulse_s / spacing_m = {ratio} s/m, {seeds} seeds. The scene's own law is viscous with 1e-9 s/m.
Emerged: -ln(1 - U/V) / (g t) of the speed U that all wheels at V = 0.1 m/s give the parcel in
t = 0.5 s; mean and standard deviation over the seeds. Scatter: rms over the seeds of the farthest
that the parcel's centre comes, in 6 s of the field (-x, -2y), from where the solver exact has it
under the viscous law with {ratio} s/m; the same of its angle. Time: of one such motion, median."""

RATIO = 0.2
SECOND = 1_000_000_000
G = 9.81
SPACINGS_M = (8e-3, 4e-3, 2e-3, 1e-3, 5e-4)

Floats = NDArray[np.float64]


def plant(coefficient: float, solver: str, **settings: object) -> Plant:
    """The study scene under the viscous law."""
    scene = {
        "array": {"rows": 20, "columns": 20, "pitch_m": 0.1},
        "parcels": [{"mass_kg": 2.0, "position_m": (0.55, 0.5), "angle_rad": 0.9, "size_m": (0.54, 0.32)}],
        "friction": {"law": "viscous", "coefficient_s_per_m": coefficient},
        "gravity_m_s2": G,
        "solver": {"name": solver},
    }
    return Plant(PlantSpec.model_validate(scene | settings))


def bumpy(spacing_m: float, seed: int) -> Plant:
    """The same with rollers, and next to no friction besides."""
    rollers = {"spacing_m": spacing_m, "impulse_s": RATIO * spacing_m}
    return plant(1e-9, "implicit", seed=seed, effects={"roller_impacts": rollers})


def emerged(spacing_m: float, seed: int) -> float:
    """The coefficient by which a parcel picks up the speed of its wheels, s/m."""
    one = bumpy(spacing_m, seed)
    one.advance(np.tile((0.1, 0.0), (len(one.array.positions_m), 1)), SECOND // 2)
    return float(-np.log(1.0 - one.state[0, 3] / 0.1) / (0.5 * G))


def path(one: Plant) -> Floats:
    """``(61, 3)`` poses in the elliptic field."""
    field = one.array.positions_m * (-1.0, -2.0)
    return one.trajectory(field, 6 * SECOND, SECOND // 10).state[:, 0, :3]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20, help="at least 2")
    parser.add_argument("--quick", action="store_true", help="the widest spacing alone")
    asked = parser.parse_args()
    seeds: int = asked.seeds
    print(METHOD.format(ratio=RATIO, seeds=seeds))
    known = path(plant(RATIO, "exact"))
    path(bumpy(SPACINGS_M[0], 0))  # compiles
    print("\nspacing, mm   emerged, s/m        centre, mm   angle, mrad   seconds")
    for spacing_m in SPACINGS_M[:1] if asked.quick else SPACINGS_M:
        found = np.array([emerged(spacing_m, seed) for seed in range(seeds)])
        far, turned, seconds = [], [], []
        for seed in range(seeds):
            begun = time.process_time()
            off = path(bumpy(spacing_m, seed)) - known
            seconds.append(time.process_time() - begun)
            far.append(np.max(np.hypot(off[:, 0], off[:, 1])))
            turned.append(np.max(np.abs(off[:, 2])))
        centre_mm, angle_mrad = (1e3 * np.sqrt(np.mean(np.square(each))) for each in (far, turned))
        print(
            f"{1e3 * spacing_m:<13g} {np.mean(found):.4f} +- {np.std(found, ddof=1):.4f}    {centre_mm:<12.3f} "
            f"{angle_mrad:<13.2f} {np.median(seconds):.2f}"
        )


if __name__ == "__main__":
    main()
