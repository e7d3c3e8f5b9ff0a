"""Throughput of the scene ``junction`` against how many parcels arrive, and how many of them leave where cells die.

``python tests/benchmarks/protocols/junction.py`` prints its method and its figures; ``--docs docs`` draws the picture
too; ``--parcels 120 --gaps 2.8 --seconds 0 --dying 0.05 --seeds 50`` is a study over seeds, half a minute a seed.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from bus.partition import Partition
from bus.random_streams import rng
from cell_firmware.board import Board
from cell_firmware.firmware import Cells
from cell_firmware.loader import load
from cell_firmware.shard import Shard
from deploy.plots.theme import write_picture
from deploy.runs.setup import load_plant
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.studies.accuracy.experiments.markdown import panels
from deploy.util.colours import colour

FEEDERS = 4
METHOD = """\
Method. The scene junction in one process, every tick of it: 4 feeders, exponential gaps of the mean "gap" s each, to 4
exits at random by the seed. "offered" and "left": parcels a second that were due, and that left, in the second half of
the time. "transit": mean time from feeding to leaving. "lost" tipped or went over an edge; "met" counts pairs
that came to overlap, looked at every tick; "there" are still on the array at the end, "waiting" at the feeders.
"""


@dataclass
class Row:
    """What a run came to."""

    seed: int
    gap_s: float
    seconds: float
    offered_per_s: float
    left_per_s: float
    transit_s: float
    left: int
    misrouted: int
    lost: int
    met: int
    there: int
    waiting: int
    dead: int

    def __str__(self) -> str:
        rates = f"{self.seed:6}{self.gap_s:6.2f}{self.seconds:9.1f}{self.offered_per_s:9.2f}{self.left_per_s:7.2f}"
        counts = (self.left, self.misrouted, self.lost, self.met, self.there, self.waiting, self.dead)
        return f"{rates}{self.transit_s:9.2f}" + "".join(f"{count:10}" for count in counts)


HEAD = f"{'seed':>6}{'gap':>6}{'time':>9}{'offered':>9}{'left/s':>7}{'transit':>9}" + "".join(
    f"{name:>10}" for name in ("left", "misrouted", "lost", "met", "there", "waiting", "dead")
)


def run(gap_s: float, parcels: int, dying: float, seconds: float, seed: int) -> Row:
    """One run, until all parcels have left or the time is over, or nobody has left for a minute."""
    feed = [("mean_s", gap_s), ("count", parcels // FEEDERS)]
    texts = [f"effects.feeders.feed.{i}.{key}={value}" for i in range(FEEDERS) for key, value in feed]
    scene = load_scene("junction", [Override.parse(text) for text in (f"seed={seed}", *texts)])
    plant = load_plant(scene, print)
    lattice, period_ns = plant.array.lattice, scene.cells.period_ns
    cells = Cells.of(
        lattice,
        plant.array.positions_m,
        scene.cells.period_s,
        scene.array.sensors_m,
        pitch_m=scene.array.pitch_m,
    )
    shard = Shard(Board(load(scene.cells)), cells, Partition.even(lattice, 1), 0)
    draw = rng(seed, "benchmark.dead")
    doomed = draw.choice(len(lattice), round(dying * len(lattice)), replace=False).tolist()
    span_s = min(seconds, parcels / FEEDERS * gap_s)
    at = dict(zip((draw.uniform(0.0, span_s, len(doomed)) * 1e9 // period_ns).tolist(), doomed, strict=True))
    sense, left_s, lost, met, dead = plant.sense(), [0.0], 0, 0, 0
    for tick in range(int(seconds * 1e9 // period_ns)):
        if tick in at:
            shard.retire([lattice.cells[at[tick]]])
            plant.release_wheels([at[tick]], "coast")
            dead += 1
        out = shard.step(tick, sense.presence, label=sense.label)
        sense, events = plant.advance(out.drive, (tick + 1) * period_ns)
        left_s += [event.time_s for event in events if event.kind == "left"]
        met += sum(event.kind == "overlap" for event in events)
        lost += sum(event.kind in ("tipped", "off_array") for event in events)
        if len(left_s) > parcels // FEEDERS * FEEDERS or (tick + 1) * period_ns * 1e-9 > left_s[-1] + 60.0:
            break
    traffic, time_s = plant.traffic(), plant.time_ns * 1e-9
    assert traffic is not None
    late = sum(moment > time_s / 2 for moment in left_s) / (time_s / 2)
    transit = traffic.transit_s.mean if traffic.transit_s else float("nan")
    ends = (traffic.left, traffic.misrouted, lost, met, traffic.there, traffic.waiting, dead)
    return Row(seed, gap_s, time_s, FEEDERS / gap_s, late, transit, *ends)


def over_seeds(rows: list[Row], parcels: int) -> str:
    """Distribution of a study over seeds, with its worst."""
    left = np.array([row.left for row in rows])
    worst = rows[int(left.argmin())]
    counts = sorted({int(one) for one in left}, reverse=True)
    spread = ", ".join(f"{one} in {int((left == one).sum())}" for one in counts)
    sums = [
        sum(getattr(row, name) for row in rows) for name in ("misrouted", "lost", "met", "there", "waiting")
    ]
    transit = np.array([row.transit_s for row in rows])
    return "\n".join(
        (
            f"{len(rows)} seeds of {parcels} parcels: {int(left.sum())} of {parcels * len(rows)} left",
            f"left, by seed: {spread}",
            f"worst: seed {worst.seed}, {worst.left} left, {worst.there} there, {worst.waiting} waiting",
            "over all seeds: {} misrouted, {} lost, {} met, {} there, {} waiting".format(*sums),
            f"mean transit, s: {np.median(transit):.2f} in the median seed, {transit.max():.2f} in the worst",
        )
    )


def draw(rows: list[Row]) -> Figure:
    """Draw throughput, and how long it takes, against what is offered."""
    offered = [row.offered_per_s for row in rows]
    figure, (left, right) = panels(
        "Parcels through the junction, 4 feeders and 4 exits",
        "scene junction; left: how many leave; right: how long a parcel takes",
        widths_in=(4.2, 4.2),
        height_in=3.2,
    )
    left.plot(offered, offered, color="#b9c1c9", linewidth=1.0, label="all that come")
    left.plot(offered, [row.left_per_s for row in rows], color=colour(0), marker="o", ms=4, label="leave")
    left.set(
        xlabel="parcels that arrive (1/s)", ylabel="parcels that leave (1/s)", ylim=(0.0, 1.15 * max(offered))
    )
    left.legend(frameon=False)
    right.plot(offered, [row.transit_s for row in rows], color=colour(0), marker="o", ms=4)
    right.set(xlabel="parcels that arrive (1/s)", ylabel="mean transit (s)", ylim=(0.0, None))
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--gaps", type=float, nargs="+", default=[16.0, 8.0, 5.0, 4.0, 3.0, 2.0, 1.0])
    parser.add_argument("--parcels", type=int, default=4000)
    parser.add_argument("--dying", type=float, default=0.0, help="share of cells that die during the run")
    parser.add_argument(
        "--seconds", type=float, default=60.0, help="simulated, at most; 0: as long as it takes"
    )
    parser.add_argument("--seed", type=int, default=1, help="the first")
    parser.add_argument("--seeds", type=int, default=1, help="so many from the first on, at every gap")
    parser.add_argument("--docs", type=Path, help="folder of the documentation, for the picture")
    asked = parser.parse_args()
    print(METHOD)
    print(HEAD, flush=True)
    rows: list[Row] = []
    for gap_s in asked.gaps:
        for seed in range(asked.seed, asked.seed + asked.seeds):
            rows.append(run(gap_s, asked.parcels, asked.dying, asked.seconds or 1e5, seed))
            print(rows[-1], flush=True)
        if asked.seeds > 1:
            print(over_seeds(rows[-asked.seeds :], asked.parcels // FEEDERS * FEEDERS), flush=True)
    if asked.docs:
        write_picture(lambda: draw(rows), asked.docs / "images" / "junction-throughput.png")


if __name__ == "__main__":
    main()
