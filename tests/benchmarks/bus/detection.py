"""How soon the plant's side sees that a cell's process was killed, or stopped: the time until its token goes.

    python tests/benchmarks/bus/detection.py [--killed 100] [--stopped 20] [--lease 2]

The processes are forked as a run's are, connect over TCP on loopback, and show their tokens. They are killed one after
another, a tenth of a second apart; then others are stopped, all at once, as each takes its lease to be missed. The time
is from the signal to the token's going, told by the plant's endpoint.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

import numpy as np
from detection_cell import KEY, Cell

from bus.transports.base import Endpoint, LivelinessChange
from bus.transports.zenoh import open_hub
from deploy.workers.pool import WorkerPool

_PRELOAD = ("zenoh", "bus.transports.zenoh")
_QUANTILES = (0.5, 0.9, 0.99, 1.0)


def measure(how: signal.Signals, count: int, lease_s: float, apart_s: float) -> list[float]:
    """Seconds from the signal to the token's going, of each process."""
    with WorkerPool(_PRELOAD) as crew:
        hub = open_hub()
        try:
            hub.watch_alive(KEY.format("*"))
            crew.start(Cell(hub.locator, lease_s), [f"cell {number}" for number in range(count)])
            _wait(hub, {KEY.format(number): True for number in range(count)})
            while crew.poll(0.1):
                pass
            sent: dict[str, float] = {}
            went: dict[str, float] = {}
            for number in range(count):
                key = KEY.format(number)
                sent[key] = time.monotonic()
                os.kill(crew.pids[number], how)
                if apart_s:
                    went |= _wait(hub, {key: False})
                    time.sleep(apart_s)
            went |= _wait(hub, {key: False for key in sent if key not in went})
            return [went[key] - sent[key] for key in sent]
        finally:
            hub.close()


def _wait(hub: Endpoint, wanted: dict[str, bool]) -> dict[str, float]:
    """When each token came or went, as wanted."""
    found: dict[str, float] = {}
    while len(found) < len(wanted):
        event = hub.receive(60.0)
        now = time.monotonic()
        if event is None:
            raise TimeoutError(f"{len(wanted) - len(found)} tokens neither came nor went")
        if isinstance(event, LivelinessChange) and wanted.get(event.key) is event.present:
            found[event.key] = now
    return found


def _row(name: str, times_s: list[float]) -> None:
    cells = " | ".join(f"{1e3 * value:.1f}" for value in np.quantile(times_s, _QUANTILES))
    print(f"| {name} | {len(times_s)} | {1e3 * min(times_s):.1f} | {cells} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--killed", type=int, default=100)
    parser.add_argument("--stopped", type=int, default=20)
    parser.add_argument("--lease", type=float, default=2.0, help="of those that are stopped, s")
    options = parser.parse_args()
    print(
        "| ms until the token went | processes | least | median | 90 % | 99 % | most |\n|---|---|---|---|---|---|---|"
    )
    _row("killed (SIGKILL)", measure(signal.SIGKILL, options.killed, 10.0, 0.1))
    _row(
        f"stopped (SIGSTOP), lease {options.lease:g} s",
        measure(signal.SIGSTOP, options.stopped, options.lease, 0.0),
    )


if __name__ == "__main__":
    main()
