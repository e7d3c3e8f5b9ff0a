"""What the lockstep costs over a bare Zenoh exchange of the same payloads.

``python tests/benchmarks/bus/lockstep.py`` measures and prints its method. Both sides run the same processes on the
same sessions' settings.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))
# the server that forks the workers knows no other way to find their module
os.environ["PYTHONPATH"] = os.pathsep.join(sys.path)

from lockstep_bare import Bare
from lockstep_case import MESSAGE, RUN, SENSORS, Case, Side, start_workers

from bus.lockstep import Coordinator
from bus.sensors import SensorSchema
from bus.transports.zenoh import open_hub
from bus.wire.frames import Control, SenseFrame

CASES = (
    Case("18 cells, 1 worker, packed", 3, 6, 1, "packed", 1000, 1 / 2.5),
    Case("1,024 cells, 2 workers, packed", 32, 32, 2, "packed", 300, None),
    Case("18 cells, each a process, per cell", 3, 6, 18, "per_cell", 100, 0.6),
    Case("18 cells, each a process, relayed", 3, 6, 18, "relayed", 100, 0.6),
)

METHOD = """\
Method. Lockstep of one plant and its workers over Zenoh, TCP on loopback; the plant's session is a peer that listens,
each worker a forked process of its own, client of it. A tick: senses (presence bits, encoder travel) to every worker,
messages ("u", float64) over every link that crosses a border, drives back; relayed, the messages are in the drives
and in the next senses. The bare side is plain Zenoh code (FifoChannel, recv, put) that exchanges payloads of the same
number and sizes and reads none of them; the lockstep side is bus.lockstep with cells that compute nothing. Both are
started {sessions} times anew; each time they take turns of a fraction of a second, each first in every other pair, so
that what else the machine does meets both alike.
"ratio" is the median, over {pairs} pairs of neighbouring turns each time, of lockstep ticks/s by bare ticks/s, between
the quartiles; rates are medians.
"cpu" is processor time a tick of all processes together, which a busy machine disturbs less than the rate.
"""


class Lockstep(Side):
    """The plant's side: a ``Coordinator``."""

    def __init__(self, case: Case) -> None:
        partition = case.partition()
        self._hub = open_hub()
        self._host = Coordinator(
            self._hub,
            partition,
            case.form,
            run=RUN,
            readings=SensorSchema(SENSORS, encoders=True),
            message=MESSAGE,
        )
        self.workers = start_workers("lockstep", case, self._hub.locator)
        self._host.barrier()
        cells = len(partition.lattice)
        self._presence = np.zeros((cells, SENSORS), dtype=np.bool_)
        self._encoder_m = np.full((cells, 2), 0.1)

    def tick(self, k: int) -> None:
        self._host.publish(SenseFrame(k, self._presence, self._encoder_m))
        _, losses = self._host.gather(k)
        if losses:
            raise SystemExit(f"a worker was lost: {losses[0]}")

    def stop(self) -> None:
        self._host.control(Control("stop", 0))

    def close(self) -> None:
        self._host.close()
        self._hub.close()


SIDES: dict[str, type[Bare | Lockstep]] = {"bare": Bare, "lockstep": Lockstep}


@dataclass
class Tally:
    """What a side did in all its turns: ticks a wall second in each, and its processor time."""

    rates: list[float]
    ticks: int = 0
    cpu_s: float = 0.0

    @property
    def ticks_per_s(self) -> float:
        return statistics.median(self.rates)

    @property
    def cpu_us(self) -> float:
        return 1e6 * self.cpu_s / self.ticks


def take_turn(side: Side, tally: Tally, ticks: int) -> None:
    """Runs ``ticks`` ticks; the plant's processor time counts here, the workers' when they end."""
    spent, start = time.process_time(), time.perf_counter()
    for k in range(tally.ticks, tally.ticks + ticks):
        side.tick(k)
    tally.rates.append(ticks / (time.perf_counter() - start))
    tally.ticks += ticks
    tally.cpu_s += time.process_time() - spent


def run_session(case: Case, pairs: int) -> dict[str, Tally]:
    """Both sides on processes of their own, in turns."""
    sides: dict[str, Side] = {}
    tallies = {name: Tally([]) for name in SIDES}
    try:
        for name, make in SIDES.items():
            sides[name] = make(case)
        for pair in range(pairs + 1):
            for name in sorted(sides, reverse=pair % 2 == 1):
                take_turn(sides[name], tallies[name], case.ticks)
        for name, side in sides.items():
            side.stop()
            tallies[name].cpu_s += sum(worker.spent_s() for worker in side.workers)
            del tallies[name].rates[0]  # to warm up
            side.close()
    finally:
        # A worker of the bare side does not notice that its plant is gone.
        for side in sides.values():
            for worker in side.workers:
                worker.process.kill()
    return tallies


def run_case(case: Case, sessions: int, pairs: int) -> dict[str, Any]:
    """Rates of both sides, and the lockstep's ratios to the bare exchange."""
    tallies = {name: Tally([]) for name in SIDES}
    for _ in range(sessions):
        for name, tally in run_session(case, pairs).items():
            tallies[name].rates += tally.rates
            tallies[name].ticks += tally.ticks
            tallies[name].cpu_s += tally.cpu_s
    bare, lockstep = tallies["bare"], tallies["lockstep"]
    ratios = [ours / theirs for theirs, ours in zip(bare.rates, lockstep.rates, strict=True)]
    low, ratio, high = statistics.quantiles(ratios, n=4)
    return {
        "case": case.title,
        **{
            name: {"ticks_per_s": tally.ticks_per_s, "cpu_us": tally.cpu_us}
            for name, tally in tallies.items()
        },
        "ratio": ratio,
        "ratio_quartiles": [low, high],
        "cpu_ratio": bare.cpu_us / lockstep.cpu_us,
        "target": case.target,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sessions", type=int, default=5, help="times to start both sides anew")
    parser.add_argument("--repeat", type=int, default=8, help="turns of each side in a session")
    parser.add_argument("--case", type=int, action="append", help=f"only this case, 0..{len(CASES) - 1}")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    rows = [
        run_case(case, options.sessions, options.repeat)
        for case in (CASES[i] for i in options.case or range(len(CASES)))
    ]
    if options.json:
        print(json.dumps(rows))
        return
    print(METHOD.format(sessions=options.sessions, pairs=options.repeat))
    head = "".join(f"{side + ', ticks/s':>20}{'cpu, us':>9}" for side in SIDES)
    print(f"{'case':36}{head}{'ratio':>8}{'quartiles':>14}{'cpu':>6}  target")
    for row in rows:
        rates = "".join(f"{row[side]['ticks_per_s']:20.0f}{row[side]['cpu_us']:9.0f}" for side in SIDES)
        low, high = row["ratio_quartiles"]
        target = "-" if row["target"] is None else f">= {row['target']:.2f}"
        spread = f"{low:.2f} .. {high:.2f}"
        print(f"{row['case']:36}{rates}{row['ratio']:8.2f}{spread:>14}{row['cpu_ratio']:6.2f}  {target}")


if __name__ == "__main__":
    main()
