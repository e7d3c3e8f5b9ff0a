"""What checkpoints cost: ticks a second without and with them, how large they are, how long a run takes to go on.

``python tests/benchmarks/deploy/checkpoint_cost.py`` prints its method and its figures.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from statistics import median

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from deploy.checkpoints.store import FILE_NAME, CheckpointStore, find_checkpoint, options_of, scene_of
from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene
from deploy.workers.plan import RunOptions

SIZES = ((3, 6, 6_000), (25, 40, 2_000), (100, 100, 800))
"""Rows, columns, ticks."""
QUICK = ((3, 6, 600),)
METHOD = """\
Method. heat_diffusion (diffusion number 0.2, one corner warm) under one parcel, {workers} worker process over Zenoh,
a checkpoint every {every:g} s of wall time. Ticks a second of the lockstep, the median of {repeats} rounds, in each of
which the run goes without checkpoints and with them. Start-up: until the first tick, of a run that begins and of one
that goes on.
"""


def scene(rows: int, columns: int, ticks: int) -> Scene:
    """An array that conducts heat, a parcel on it."""
    values = {
        "duration_s": round(ticks * 0.004096, 6),
        "array.rows": rows,
        "array.columns": columns,
        "parcels": [{"size_m": [0.25, 0.15], "mass_kg": 1.0, "position_m": [0.0, 0.0]}],
        "cells.parameters": {"diffusion_number": 0.2, "held": [{"cell": [0, 0], "speed_m_s": [0.01, 0.0]}]},
    }
    return load_scene("heat", [Override(tuple(key.split(".")), value, "") for key, value in values.items()])


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--every", type=float, default=1.0)
    parser.add_argument("--quick", action="store_true", help="the smallest array, a tenth of its ticks")
    asked = parser.parse_args()
    CheckpointStore.clear = _stay
    print(METHOD.format(workers=1, every=asked.every, repeats=asked.repeats))
    print(" cells   without/s      with/s   ratio   bytes     start-up begins, goes on (s)")
    for rows, columns, ticks in QUICK if asked.quick else SIZES:
        found_ = [_round(scene(rows, columns, ticks), asked.every) for _ in range(asked.repeats)]
        without, kept, size, begins, goes_on = (median(one) for one in zip(*found_, strict=True))
        ratio = median(one[1] / one[0] for one in found_)
        print(
            f"{rows * columns:6d} {without:11.0f} {kept:11.0f} {ratio:7.3f} {size:9.0f} {begins:8.2f} {goes_on:8.2f}",
            flush=True,
        )


def _stay(self: CheckpointStore) -> None:
    """Checkpoints of a run that is over, as though it had been killed."""


def _round(wanted: Scene, every_s: float) -> tuple[float, float, float, float, float]:
    """Ticks a second without and with, bytes, start-up of both."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bare = run(wanted, RunOptions(processes=1, output=folder, picture=False), quiet=True).summary
        options = RunOptions(processes=1, output=folder, picture=False, checkpoint_s=every_s)
        kept = run(wanted, options, quiet=True).summary
        assert bare.digest == kept.digest
        (folder / "summary.json").unlink()
        checkpoint, size = find_checkpoint(folder), (folder / FILE_NAME).stat().st_size
        again = RunOptions(output=folder, picture=False)
        gone_on = run(
            scene_of(checkpoint), options_of(checkpoint, again), quiet=True, resumed=checkpoint
        ).summary
        assert gone_on.digest == bare.digest
        return (
            bare.ticks_per_s or 0.0,
            kept.ticks_per_s or 0.0,
            float(size),
            kept.startup_s,
            gone_on.startup_s,
        )


if __name__ == "__main__":
    main()
