"""What ``align`` comes to over bad links, clocks that drift and dead cells.

Run: ``python tests/benchmarks/protocols/align_over_faults.py`` (``--source sensors`` or ``camera`` for one of the two,
``--seeds`` for fewer parcels).

50 parcels of 0.54 by 0.38 m begin up to 0.2 m from the middle of 15 by 15 cells along x and y, at any angle, and are to
lie along the rows in the middle; 20 s later: by how many degrees are they off, and how many by more than 2? One
presence sensor a cell. Lost: ``link_loss``; delay: ``link_delay`` of 2 ticks, or 0 to 4 not in order; clocks 5 % off; a
tenth of the cells dead from the start, their wheels turning freely. A parcel that tipped off dead cells is told.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any, Final

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from tests.benchmarks.protocols.align_case import Case, off_deg, run, starts
from tests.benchmarks.protocols.align_sweep import CAMERA

SIZE_M: Final = (0.54, 0.38)
CONDITIONS: Final[dict[str, tuple[dict[str, Any], float]]] = {
    "as it is": ({}, 0.0),
    "loss 0.05": ({"link_loss": {"probability": 0.05}}, 0.0),
    "loss 0.2": ({"link_loss": {"probability": 0.2}}, 0.0),
    "delay 2": ({"link_delay": {"ticks": 2}}, 0.0),
    "delay 0 to 4": ({"link_delay": {"between_ticks": [0, 4], "ordered": False}}, 0.0),
    "clocks 5 % off": ({"clock": {"error_ppm": 50_000.0}}, 0.0),
    "10 % dead": ({}, 10.0),
}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--source", choices=("sensors", "camera"), action="append")
    asked = parser.parse_args()
    print(f"{asked.seeds} parcels of {SIZE_M[0]} x {SIZE_M[1]} m, 20 s; degrees off, mm off")
    print(f"{'':8}{'':16}{'median':>8}{'90 %':>8}{'worst':>8}{'over 2':>8}{'mm':>8}{'worst':>8}{'cpu s':>8}")
    for source in asked.source or ("sensors", "camera"):
        for name, (effects, dead_percent) in CONDITIONS.items():
            if source == "camera" and any(effect.startswith("link") for effect in effects):
                continue  # it has no messages
            begun = starts([SIZE_M] * asked.seeds, 2, dead_percent)
            parameters = {"source": source, "target_m": (0.0, 0.0)}
            camera = CAMERA if source == "camera" else None
            began = time.process_time()
            _, states = run(Case(begun, "align", parameters, 1, 20.0, camera, effects))
            off, at_mm = off_deg(states[-1], begun), 1e3 * np.hypot(states[-1, :, 0], states[-1, :, 1])
            print(
                f"{source:8}{name:16}{np.median(off):8.2f}{np.quantile(off, 0.9):8.2f}{off.max():8.2f}"
                f"{np.mean(off > 2.0):8.0%}{np.median(at_mm):8.2f}{at_mm.max():8.1f}"
                f"{time.process_time() - began:8.0f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
