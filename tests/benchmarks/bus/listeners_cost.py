"""Cost of listeners to the lockstep.

``python tests/benchmarks/bus/listeners_cost.py`` measures a lockstep by itself, beside a mirror to which nobody
listens, and with a listener who subscribes to everything and reads, or never reads.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))
# the server that forks the workers knows no other way to find their module
os.environ["PYTHONPATH"] = os.pathsep.join(sys.path)

from lockstep import CASES, Lockstep, Tally, take_turn
from lockstep_case import RUN, Case

from bus.transports.zenoh import Mirror, open_outside
from bus.wire.keys import message_kinds
from deploy.security.policy import open_gate

ROOT = Path(__file__).resolve().parents[3]
METHOD = """\
Method. The lockstep of tests/benchmarks/bus/lockstep.py, TCP on loopback, cells that compute nothing. "alone" has no
mirror, "nobody" has one to which nobody listens. To the others somebody listens in a process of its own, by a plain
Zenoh subscriber of mdms/**; "stuck" never reads, and is measured from its third turn. All take turns. "ratio" is the
median over {repeat} rounds of ticks/s by those of "alone" in the same round, between the quartiles.
"""
HOW = {"alone": None, "nobody": None, "reads": "reads", "stuck": "never"}


class Listened(Lockstep):
    """A lockstep, and who listens to it."""

    def __init__(self, case: Case, name: str) -> None:
        super().__init__(case)
        self._mirror: Mirror | None = None
        self._listener: subprocess.Popen[str] | None = None
        if name == "alone":
            return
        outside = open_outside(None, gate=open_gate())
        units = case.workers if case.form == "packed" else case.rows * case.columns
        kinds = {key: 64 * number for key, number in message_kinds(RUN, case.form, units).items()}
        self._mirror = Mirror(self._hub, outside, kinds, f"mdms/{RUN}/**")
        how = HOW[name]
        if how is not None:
            command = [sys.executable, "-m", "tests.system.listener", outside.locator, how]
            self._listener = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT
            )

    def close(self) -> None:
        if self._listener is not None:
            self._listener.kill()
            self._listener.communicate()
        if self._mirror is not None:
            self._mirror.close()
        super().close()


def measure(case: Case, repeat: int) -> None:
    """Print a case's row."""
    sides = {name: Listened(case, name) for name in HOW}
    tallies = {name: Tally([]) for name in HOW}
    try:
        for turn in range(repeat + 2):
            for name in list(HOW) if turn % 2 else reversed(list(HOW)):
                take_turn(sides[name], tallies[name], case.ticks)
        for side in sides.values():
            side.stop()
            for worker in side.workers:
                worker.spent_s()
            side.close()
    finally:
        for side in sides.values():
            for worker in side.workers:
                worker.process.kill()
    print(case.title)
    for name, tally in tallies.items():
        rates = tally.rates[2:]  # the first two: to warm up, and to fill links that nobody reads
        ratios = [mine / alone for mine, alone in zip(rates, tallies["alone"].rates[2:], strict=True)]
        low, ratio, high = statistics.quantiles(ratios, n=4)
        print(
            f"  {name:8}{statistics.median(rates):8.0f} ticks/s  ratio {ratio:.2f} ({low:.2f} .. {high:.2f})",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=12, help="rounds of turns")
    parser.add_argument("--case", type=int, action="append", help=f"only this case, 0..{len(CASES) - 1}")
    given = parser.parse_args()
    print(METHOD.format(repeat=given.repeat))
    for case in (CASES[i] for i in given.case or range(len(CASES))):
        measure(case, given.repeat)


if __name__ == "__main__":
    main()
