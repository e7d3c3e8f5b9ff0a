"""How far ``implicit`` is from itself with every crossing located, in scenes that chatter, with effects and laws.

``python tests/benchmarks/plant/chatter_effects.py`` prints its method.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from plant.errors import PlantUnstable
from plant.friction.coulomb import Coulomb
from tests.plant.chattering import SPAN_S, make_chattering
from tests.plant.laws import MU, ROLLING, STICK_SLIP, VISCOUS
from tests.plant.scenes import SECOND, Floats
from tests.plant.slipping import controlled, distance_m_of

METHOD = """\
{seeds} scenes a case (tests/plant/chattering.py) of {span:g} s, begun at rest within {off:g} m of an edge that draws
the parcel from both sides. capture_m is a tenth of the tolerance. Off: from a tolerance of 1e-9 with a capture_m of a
hundredth of that distance, which locates the crossings, at the footprint, over the tolerance. Changes and steps: of
supports, attempted, of all. A capture takes the first swing's velocity, which goes with the root of that distance.
"""
DAMPED = Coulomb(law="coulomb", coefficient=MU, viscous_n_s_per_m=10.0)
DAMPED_CONE = Coulomb(law="coulomb", coefficient=MU, viscous_n_s_per_m=10.0, contact="isotropic")
MOTORS = {"motors": {"time_constant_s": 0.05, "speed_per_volt_m_s": 0.05}}
LOADED = MOTORS | {"wheel_load": {"inertia_kg": 0.05}}
TALL = {"load_transfer": {"centre_of_mass_height_m": 0.03}}
SPRINGS = {"uneven_supports": {"stiffness_n_per_m": 2e4, "stiffness_spread": 0.2}}
CASES: dict[str, tuple[Any, dict[str, object], float]] = {
    "wheel_load, coulomb": (DAMPED, LOADED, 20.0),
    "wheel_load, isotropic": (DAMPED_CONE, LOADED, 20.0),
    "wheel_load, viscous": (VISCOUS, LOADED, 20.0),
    "stick_slip, uneven_supports": (STICK_SLIP, SPRINGS, 1.0),
    "stick_slip, uneven_friction": (
        STICK_SLIP,
        {"uneven_friction": {"cell_spread": 0.2, "wheel_spread": 0.1}},
        1.0,
    ),
    "stick_slip, roller_drag": (STICK_SLIP, {"roller_drag": {"drag_s_per_m": 0.1}}, 1.0),
    "load_transfer, viscous": (VISCOUS, TALL, 1.0),
    "load_transfer, rolling": (ROLLING, TALL, 1.0),
    "load_transfer, stick_slip": (STICK_SLIP, TALL, 1.0),
    "load_transfer, coulomb": (DAMPED, TALL, 1.0),
}


def run(
    seed: int, case: str, solver: dict[str, Any], off_m: float, span_s: float
) -> tuple[Floats | None, int, int]:
    """Where a scene ends, None if it ends as unstable; its support changes; the steps attempted."""
    law, effects, volts = CASES[case]
    plant, drives = make_chattering(seed, solver, law, effects, volts=volts, off_m=off_m)
    try:
        plant.advance(drives, round(span_s * SECOND))
    except PlantUnstable:
        return None, plant.support_changes, plant.effort
    return plant.state[0].copy(), plant.support_changes, plant.effort


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--only", default="", help="cases whose names have this in them")
    parser.add_argument(
        "--off", type=float, default=1e-13, help="distance from the edge at first, m, at most"
    )
    parser.add_argument("--span", type=float, default=SPAN_S, help="s")
    asked = parser.parse_args()
    located = {"name": "implicit", "tolerance": 1e-9, "capture_m": 1e-2 * asked.off}
    print(METHOD.format(seeds=asked.seeds, span=asked.span, off=asked.off))
    print(
        f"{'':28} {'tolerance':>9} {'off: median':>12} {'worst':>9} {'changes':>8} {'steps':>8} {'unstable':>9}"
    )
    for case in CASES:
        if asked.only not in case:
            continue
        known = [run(seed, case, located, asked.off, asked.span) for seed in range(asked.seeds)]
        for tolerance in (1e-6, 1e-8, None):
            ends = known if tolerance is None else []
            if tolerance is not None:
                solver = controlled(tolerance)
                ends = [run(seed, case, solver, asked.off, asked.span) for seed in range(asked.seeds)]
            off = [
                distance_m_of(end, right) / (tolerance or 1e-9)
                for (end, _, _), (right, _, _) in zip(ends, known, strict=True)
                if end is not None and right is not None
            ]
            changes, steps = sum(end[1] for end in ends), sum(end[2] for end in ends)
            failed = sum(end is None for end, _, _ in ends)
            name = "located" if tolerance is None else f"{tolerance:.0e}"
            median, worst = (np.median(off), max(off)) if off else (np.nan, np.nan)
            print(f"{case:28} {name:>9} {median:12.1e} {worst:9.1e} {changes:8d} {steps:8d} {failed:9d}")


if __name__ == "__main__":
    main()
