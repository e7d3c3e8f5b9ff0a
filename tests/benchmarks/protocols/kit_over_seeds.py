"""The kit's protocols over many seeds, beside theory: the worst of all seeds.

``python tests/benchmarks/protocols/kit_over_seeds.py`` prints its method and its figures.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from tests.cell_firmware.kit import trials

METHOD = f"""\
Method. {{seeds}} arrays of {trials.ROWS} x {trials.COLUMNS} cells less up to {trials.MOST_HOLES}, by seed. All
registers begin with random values. Then {trials.LOSSY_TICKS} ticks with a loss of {trials.LOSS} on every link, in which
{trials.DEATHS} cells of each array die, for good or (slots) until the end of these ticks; of the tree the root, too, in
every other array. "ticks": from the last disturbance until all cells are right for good, as NetworkX has it; median and
greatest. "of bound": the greatest share of the bound. Tree: distances, limit {trials.LIMIT}. Counts: of cells and of
covered cells. Push-sum: random values from -8 to 8 on the largest part of each array, until all errors stay below
{trials.ENOUGH} of the range; the bound is that of the spectrum, for perfect links. Synchroniser: loss {trials.LOSS},
half of the links late by 0 to 3 ticks, not in order.
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=200)
    seeds = range(1, parser.parse_args().seeds + 1)
    print(METHOD.format(seeds=len(seeds)))
    print(f"{'':32}{'ticks':>6}{'greatest':>9}{'of bound':>9}")
    for one in (*trials.tree_trials(seeds), *trials.slots_trials(seeds)):
        share = (one.ticks / one.bound).max()
        print(f"{one.what:32}{np.median(one.ticks):6.0f}{one.ticks.max():9}{share:9.2f}", flush=True)
    gossip = trials.gossip_trials(seeds)
    for what, ticks in (("push-sum", gossip.perfect_ticks), ("push-sum, lossy links", gossip.lossy_ticks)):
        share = (ticks / gossip.bound_ticks).max()
        print(f"{what:32}{np.median(ticks):6.0f}{ticks.max():9}{share:9.2f}")
    print(f"push-sum: mass that was ever missing: {gossip.mass_lost.max()} units of 2^-32")
    print(
        f"push-sum: greatest error over the bound of its tick, perfect links: {gossip.share_of_bound.max():.2f}"
    )
    rounds = trials.synchroniser_trials(seeds)
    print(
        f"synchroniser: values with other bits than on perfect links: {rounds.wrong.sum()}; pulses of neighbours "
        f"apart by {rounds.apart.max()}; {rounds.pulses.min()} to {rounds.pulses.max()} rounds in "
        f"{trials.SYNCHRONISED_TICKS} ticks"
    )


if __name__ == "__main__":
    main()
