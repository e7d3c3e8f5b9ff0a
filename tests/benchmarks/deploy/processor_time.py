"""Processor time of a cell's board on an MC68HC11: the speed loop's program against the emulation, and what bytes take.

``python tests/benchmarks/deploy/processor_time.py`` prints its method and the figures of docs/board.md.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numba
import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from cell_firmware.processor_time import BYTE_E, EDGE_E, LOOP_E
from tests.cell_firmware.speed_loop import hc11
from tests.cell_firmware.speed_loop.hc11_cases import compared

METHOD = """\
Method. The speed loop of the effect fixed_point (1,920 counts, 2,000 levels, the default gains), both wheels, written
as a program of the MC68HC11: unrolled, all variables in page 0, generated from the loop's own scaling. An interpreter
runs it and adds up the cycles of the reference manual, 14 to enter an interrupt and 12 to return. {updates:,} updates,
half with integrals, references and counts from anywhere in their range, half with counts within two of the reference.
Integral and duty of each must be those of FixedPointLoop, bit for bit.
"""
PERIOD_E = 8192

# An external chip of four UARTs; per side a block of memory: status, data, head, tail, ring, bytes left, pointer.
FIND = (("ldab vector, the side that asks", 4), ("ldx #table", 3), ("abx", 3), ("ldx 0,x, its block", 5))
BYTES = {
    "received": (
        *FIND, ("ldaa status,x", 4), ("bita #errors", 2), ("bne error", 3), ("ldaa data,x", 4), ("ldab head,x", 4),
        ("incb", 2), ("andb #15", 2), ("cmpb tail,x", 4), ("beq full", 3), ("stab head,x", 4), ("abx", 3),
        ("staa ring,x", 4),
    ),
    "sent": (
        *FIND, ("ldab left,x", 4), ("beq done", 3), ("dec left,x", 6), ("ldy next,x", 6), ("ldaa 0,y", 5),
        ("staa data,x", 4), ("iny", 4), ("sty next,x", 6),
    ),
}  # fmt: skip


def quick(table: NDArray[np.int64], memory: NDArray[np.int64]) -> NDArray[np.int64]:
    """Cycles of each update, compiled."""
    run = numba.njit(hc11.run)

    @numba.njit
    def each(table: NDArray[np.int64], memory: NDArray[np.int64]) -> NDArray[np.int64]:
        spent = np.empty(len(memory), dtype=np.int64)
        for i in range(len(memory)):
            spent[i] = run(table, memory[i])
        return spent

    return each(table, memory)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--updates", type=int, default=400_000)
    asked = parser.parse_args()
    print(METHOD.format(updates=asked.updates))
    cycles, saturated, wrong = [], [], 0
    for near in (False, True):
        found = compared(asked.updates // 2, near=near, seed=3, each=quick)
        wrong += int(
            (found.integral != found.expected_integral).sum() + (found.duty != found.expected_duty).sum()
        )
        cycles.append(found.cycles)
        saturated.append(found.saturated)
    spent, wheels = np.concatenate(cycles), np.concatenate(saturated)
    print(f"numbers that differ: {wrong}")
    for count in range(3):
        some = spent[wheels == count]
        low, high = int(some.min()), int(some.max())
        share = f"{100 * low / PERIOD_E:.1f} to {100 * high / PERIOD_E:.1f} % of {PERIOD_E:,} E"
        print(
            f"{count} wheels saturated: {low:,} to {high:,} E, mean {some.mean():,.0f}; {share}; {len(some):,} updates"
        )
    print(f"an encoder's edge: {EDGE_E} E")
    for what, instructions in BYTES.items():
        total = hc11.ENTRY_E + sum(cost for _, cost in instructions) + 12
        print(f"a byte {what}: {total} E")
        wrong += total > BYTE_E
    wrong += not LOOP_E[0] <= spent.min() <= spent.max() <= LOOP_E[1]
    sys.exit(wrong > 0)


if __name__ == "__main__":
    main()
