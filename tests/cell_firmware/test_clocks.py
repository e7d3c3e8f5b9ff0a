"""Instants of cells against exact rational arithmetic."""

from __future__ import annotations

from fractions import Fraction
from math import ceil, floor

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from cell_firmware.clocks import NOT_IN_WINDOW, CellClocks

PERIOD_NS = 4_096_000
ERRORS = st.integers(-60_000_000, 60_000_000)


def instant(period_ns: int, ppb: int, phase_ns: int, number: int) -> int:
    """By definition."""
    return phase_ns + floor(number * period_ns * (1 + Fraction(ppb, 10**9)))


def clocks(period_ns: int, window_ns: int, ppb: list[int], phase_ns: list[int]) -> CellClocks:
    return CellClocks(period_ns, window_ns, np.array(ppb), np.array(phase_ns))


@settings(max_examples=300)
@given(
    period_ns=st.integers(1, 10**11),
    ppb=ERRORS,
    share=st.fractions(0, 1),
    time_ns=st.integers(0, 10**18),
)
def test_instants_are_the_floor_of_exact_multiples_up_to_a_billion_seconds(
    period_ns: int, ppb: int, share: Fraction, time_ns: int
) -> None:
    phase_ns = floor(share * (period_ns - 1))
    made = clocks(period_ns, 1, [ppb], [phase_ns])
    true_period = period_ns * (1 + Fraction(ppb, 10**9))
    number = max(ceil((time_ns - phase_ns) / true_period), 0)
    assert made.count_before(time_ns).tolist() == [number]
    assert made.instant(np.array([number])).tolist() == [instant(period_ns, ppb, phase_ns, number)]


@given(
    ppb=st.lists(ERRORS, min_size=1, max_size=5),
    phase_ns=st.integers(0, PERIOD_NS - 1),
    window=st.integers(0, 10**11),
    exchanges=st.integers(1, 7),
)
def test_windows_hold_every_instant_once(ppb: list[int], phase_ns: int, window: int, exchanges: int) -> None:
    window_ns = PERIOD_NS * (10**9 + min(ppb)) // 10**9 // exchanges
    made = clocks(PERIOD_NS, window_ns, ppb, [phase_ns] * len(ppb))
    windows = range(window, window + 3 * exchanges)
    followed = [made.instants(k) for k in windows]
    begin, end = window * window_ns, windows[-1] * window_ns + window_ns
    for cell, error in enumerate(ppb):
        number = max(ceil((begin - phase_ns) / (PERIOD_NS * (1 + Fraction(error, 10**9)))), 0)
        wanted: list[int] = []
        while (at := instant(PERIOD_NS, error, phase_ns, number)) < end:
            wanted.append(at)
            number += 1
        found = [
            (k, int(at[cell])) for k, at in zip(windows, followed, strict=True) if at[cell] != NOT_IN_WINDOW
        ]
        assert [at for _, at in found] == wanted
        assert [at // window_ns for at in wanted] == [k for k, _ in found]


@given(ppb=ERRORS, phase_ns=st.integers(0, PERIOD_NS - 1))
def test_whoever_follows_the_clocks_finds_the_same(ppb: int, phase_ns: int) -> None:
    made = clocks(PERIOD_NS, PERIOD_NS * 94 // 100, [ppb], [phase_ns])
    count = np.zeros(1, dtype=np.int64)
    for window in range(40):
        due = made.due(window, count)
        assert due.tolist() == made.instants(window).tolist()
        count = count + (due != NOT_IN_WINDOW)


def test_there_is_no_instant_before_the_first() -> None:
    made = clocks(PERIOD_NS, PERIOD_NS, [0, 0], [0, 7])
    assert made.instants(-1).tolist() == [NOT_IN_WINDOW, NOT_IN_WINDOW]
    assert made.instants(0).tolist() == [0, 7]
