"""Instants of a cell's clock, as ``cell_firmware.clocks`` defines them."""

from __future__ import annotations

import numpy as np

from cell_firmware.kernels.jit import kernel

BILLION = 1_000_000_000

CLOCK = np.dtype([("ppb", "<i8"), ("phase_ns", "<i8"), ("count", "<i8"), ("drive", "<f8", (2,))])
"""State of a cell with a clock of its own."""


@kernel
def by_clock(span_ns, ppb):
    """How long a clock that is slow by ``ppb`` takes to count a span, ns rounded down."""
    return span_ns + span_ns * ppb // BILLION


@kernel
def instant(period_ns, ppb, phase_ns, number):
    """A cell's instant of this number, counted from 0, ns."""
    nominal = number * period_ns
    # floor(nominal ppb / 10^9), in two parts: the product can exceed 64 bits
    whole = nominal // BILLION
    rest = nominal - whole * BILLION
    return phase_ns + nominal + whole * ppb + rest * ppb // BILLION


@kernel
def due(period_ns, window_ns, ppb, phase_ns, window, count):
    """The instant in a window after ``count`` earlier ones, ns; -1 if there is none."""
    at_ns = instant(period_ns, ppb, phase_ns, count)
    return at_ns if at_ns < (window + 1) * window_ns else -1


@kernel
def count_before(period_ns, ppb, phase_ns, time_ns):
    """How many instants a cell has before a time."""
    parts = ppb + BILLION
    whole = (time_ns - phase_ns) // parts
    rest = (time_ns - phase_ns) - whole * parts
    true = whole * BILLION - -rest * BILLION // parts
    return max(-(-true // period_ns), 0)
