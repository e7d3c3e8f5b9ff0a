"""How far ``implicit`` is from a finer tolerance under ``coulomb``, with effects that change loads or wheels.

``python tests/benchmarks/plant/coulomb_effects.py`` prints its method.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from plant.friction.coulomb import Coulomb
from tests.plant.laws import CONE, COULOMB, MU
from tests.plant.scenes import SECOND, Floats
from tests.plant.slipping import SPAN_S, controlled, distance_m_of, make_wide_scene

METHOD = """\
{seeds} random scenes of {span:g} s on 196 cells, spins up to {spin:g} rad/s; capture_m a tenth of the tolerance.
Off: implicit from itself at {finest:g}, at the footprint, over the tolerance. Steps: attempted, of all scenes.
Time: processor time of all scenes, once each.
"""
STATIC = Coulomb(law="coulomb", coefficient=MU, static_coefficient=1.5 * MU, contact="isotropic")
CASES = {
    "isotropic": (CONE, False, {}),
    "isotropic, motors": (CONE, True, {}),
    "isotropic, static": (STATIC, False, {}),
    "isotropic, static, motors": (STATIC, True, {}),
    "wheel_load": (COULOMB, True, {"wheel_load": {"inertia_kg": 0.05}}),
    "wheel_load, isotropic": (CONE, True, {"wheel_load": {"inertia_kg": 0.05}}),
    "contact_width": (COULOMB, False, {"contact_width": {"width_m": 0.012}}),
    "contact_width, motors": (COULOMB, True, {"contact_width": {"width_m": 0.012}}),
    "contact_width, narrow": (COULOMB, False, {"contact_width": {"width_m": 5e-4}}),
    "load_transfer": (COULOMB, False, {"load_transfer": {"centre_of_mass_height_m": 0.06}}),
    "load_transfer, motors": (COULOMB, True, {"load_transfer": {"centre_of_mass_height_m": 0.06}}),
}
TOLERANCES = (1e-4, 1e-6, 1e-8)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--spin", type=float, default=10.0)
    parser.add_argument("--finest", type=float, default=1e-9)
    parser.add_argument("--only", default="", help="cases whose names have this in them")
    asked = parser.parse_args()
    print(METHOD.format(seeds=asked.seeds, span=SPAN_S, spin=asked.spin, finest=asked.finest))
    print(f"{'':26} {'tolerance':>9} {'off: median':>12} {'worst':>9} {'steps':>8} {'time, s':>9}")
    for name, (law, motors, others) in CASES.items():
        if asked.only not in name:
            continue
        known: dict[int, Floats] = {}
        for tolerance in (asked.finest, *TOLERANCES):
            off: list[float] = []
            steps, spent = 0, 0.0
            for seed in range(asked.seeds):
                plant, drives = make_wide_scene(
                    seed, controlled(tolerance), law, asked.spin, motors=motors, others=others
                )
                begun = time.process_time()
                plant.advance(drives, round(SPAN_S * SECOND))
                spent += time.process_time() - begun
                steps += plant.effort
                state = plant.state[0].copy()
                off.append(distance_m_of(state, known.setdefault(seed, state)) / tolerance)
            if tolerance != asked.finest:
                line = f"{tolerance:9.0e} {np.median(off):12.1e} {max(off):9.1e} {steps:8d} {spent:9.3f}"
                print(f"{name:26} {line}")


if __name__ == "__main__":
    main()
