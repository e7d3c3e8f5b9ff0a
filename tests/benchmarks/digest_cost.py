"""Cost of the digests of a tick, and of the second chain among it: processor time at two sizes.

``python tests/benchmarks/digest_cost.py`` prints its method and its figures.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from deploy.recordings.digest import Digest, continued

METHOD = """\
Method. Digest.tick of cells with one sensor and one parcel: both chains; and one link of a chain alone. Processor time,
in turns, best of 7.
"""


def main() -> None:
    """Print the method and the figures."""
    print(METHOD)
    print(f"{'cells':>6} {'both, us':>9} {'a chain, us':>12}")
    for cells, ticks in ((18, 5_000), (10_000, 300)):
        presence, drives = np.zeros((cells, 1), dtype=np.bool_), np.full((cells, 2), 0.1)
        parcels = np.zeros((1, 6))
        works: list[Callable[[], object]] = [
            partial(Digest(b"").tick, 1, presence, drives, parcels),
            partial(continued, bytes(32), bytes(8 + cells // 8), np.full(2 * cells + 6, 0.1)),
        ]
        best = [np.inf, np.inf]
        for _ in range(7):
            for i, work in enumerate(works):
                begun = time.process_time()
                for _ in range(ticks):
                    work()
                best[i] = min(best[i], (time.process_time() - begun) / ticks)
        print(f"{cells:>6} {1e6 * best[0]:>9.2f} {1e6 * best[1]:>12.2f}")


if __name__ == "__main__":
    main()
