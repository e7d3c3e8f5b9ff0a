"""What a parcel that chatters costs beside parcels of its like that don't, in the field of the scene ``elliptic``.

``python tests/benchmarks/plant/chatter_cost.py`` measures both in one process and prints its method.
"""

from __future__ import annotations

import argparse
import gc
import itertools
import json
import statistics
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from deploy.runs.field_simulation import field_speeds
from deploy.scenes.files import load_scene
from plant.plant import Plant
from plant.specs import PlantSpec

SECOND = 1_000_000_000
SECONDS = 20
TARGET = 3.0
"""How many times as much a parcel that chatters may cost."""
SIZES = tuple(
    itertools.product(
        (0.42, 0.46, 0.50, 0.54, 0.58, 0.62, 0.66, 0.68, 0.70, 0.72, 0.74), (0.38, 0.40, 0.42, 0.44, 0.46)
    )
)
QUICK = ((0.54, 0.38), (0.68, 0.42))

METHOD = """\
Method. The scene elliptic with {sizes} sizes of parcel, {seconds} s each, in one process, warm: medians of processor
time over {turns} turns, without building the plant. "chatter" are the sizes whose chatter is captured. Whole: one call
of Plant.advance. Ticks: one for each control period. Ratios are to the median of the sizes that don't chatter.
"""


@dataclass(frozen=True)
class Row:
    """One size of parcel.

    Attributes:
        size_m: length and width.
        chatters: whether chatter was captured.
        changes: of supports.
        whole_s: processor time in one call.
        ticks_s: processor time in ticks.
    """

    size_m: tuple[float, float]
    chatters: bool
    changes: int
    whole_s: float
    ticks_s: float


def _spec(scene: PlantSpec, size: tuple[float, float]) -> PlantSpec:
    parcel = scene.parcels[0].model_copy(update={"size_m": size})
    return scene.model_copy(update={"parcels": (parcel,)})


def _timed(plant: Plant, speeds: np.ndarray, ends_ns: range | list[int]) -> tuple[float, bool]:
    """Processor time of advancing to each of the ends, and whether chatter was captured on the way."""
    gc.collect()
    gc.disable()
    captured = False
    begun = time.process_time()
    for until_ns in ends_ns:
        _, events = plant.advance(speeds, until_ns)
        captured = captured or any(event.kind == "captured" for event in events)
    spent = time.process_time() - begun
    gc.enable()
    return spent, captured


def measure(turns: int, sizes: Sequence[tuple[float, float]]) -> list[Row]:
    """Rows of these sizes, in turns."""
    scene = load_scene("elliptic")
    spec, period_ns = scene.plant_spec(), scene.cells.period_ns
    whole, ticks = [SECONDS * SECOND], range(period_ns, SECONDS * SECOND, period_ns)
    rows: list[Row] = []
    for size in sizes:
        spent: dict[str, list[float]] = {"whole": [], "ticks": []}
        chatters, changes = False, 0
        for _ in range(turns):
            for name, ends_ns in (("whole", whole), ("ticks", ticks)):
                plant = Plant(_spec(spec, size))
                seconds, captured = _timed(plant, field_speeds(scene, plant.array.positions_m), ends_ns)
                spent[name].append(seconds)
                if name == "whole":
                    chatters, changes = captured, plant.support_changes
        medians = {name: statistics.median(values) for name, values in spent.items()}
        rows.append(Row(size, chatters, changes, medians["whole"], medians["ticks"]))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--quick", action="store_true", help="two sizes, of which one chatters")
    options = parser.parse_args()
    sizes = QUICK if options.quick else SIZES
    rows = measure(options.turns, sizes)
    calm, chattering = ([row for row in rows if row.chatters is which] for which in (False, True))
    middle = {name: statistics.median(getattr(row, name) for row in calm) for name in ("whole_s", "ticks_s")}
    ratio = {
        f"{which}_{name}": choose(getattr(row, name) for row in chattering) / middle[name]
        for which, choose in (("median", statistics.median), ("dearest", max))
        for name in middle
    }
    if options.json:
        print(json.dumps({"rows": [asdict(row) for row in rows], "ratio": ratio, "target": TARGET}))
        return
    print(METHOD.format(sizes=len(sizes), seconds=SECONDS, turns=options.turns))
    print(f"{'':24}{'sizes':>7}{'changes':>9}{'whole, ms':>11}{'ticks, ms':>11}")
    for title, group in (("do not chatter, median", calm), ("chatter, median", chattering)):
        changes, whole, ticks = (
            statistics.median(getattr(row, name) for row in group)
            for name in ("changes", "whole_s", "ticks_s")
        )
        print(f"{title:24}{len(group):7}{changes:9.0f}{whole * 1e3:11.2f}{ticks * 1e3:11.1f}")
    for row in sorted(chattering, key=lambda row: -row.whole_s)[:5]:
        size = f"  {row.size_m[0]:g} x {row.size_m[1]:g} m"
        print(f"{size:24}{'':7}{row.changes:9}{row.whole_s * 1e3:11.2f}{row.ticks_s * 1e3:11.1f}")
    print()
    for which in ("median", "dearest"):
        times = (
            f"{ratio[f'{which}_whole_s']:.1f} times as much whole, {ratio[f'{which}_ticks_s']:.1f} in ticks"
        )
        print(f"{which} of those that chatter: {times}; target: {TARGET:.0f}")


if __name__ == "__main__":
    main()
