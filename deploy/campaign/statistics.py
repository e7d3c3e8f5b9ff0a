"""Shares and means with their confidence intervals.

Both intervals are chosen for few runs. Wilson's for a share stays inside [0, 1] and keeps its width where all runs
succeed, or none; the textbook's shrinks to a point there. Student's t for a mean allows for not knowing the spread
itself; bootstrap intervals take the few runs there are for all there is, and are too narrow then.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, final

_LEAST = 2
"""Runs, for there to be an interval."""


@final
@dataclass(frozen=True, slots=True)
class Share:
    """A share of runs.

    Attributes:
        share: In [0, 1]; None of no runs.
        low: Of the interval; None of fewer than two runs.
        high: The same.
    """

    share: float | None
    low: float | None
    high: float | None


@final
@dataclass(frozen=True, slots=True)
class Mean:
    """A mean over runs.

    Attributes:
        mean: None of no runs.
        low: Of the interval, >= 0; None of fewer than two runs.
        high: The same.
        runs: Over how many.
    """

    mean: float | None
    low: float | None
    high: float | None
    runs: int


def share_of(successes: int, runs: int, confidence: float) -> Share:
    """The share of successes and its Wilson score interval.

    Args:
        successes: How many of the runs.
        runs: How many there were.
        confidence: In (0, 1).

    Source: Wilson, "Probable inference, the law of succession, and statistical inference", JASA 22 (1927).
    """
    if runs < _LEAST:
        return Share(successes / runs if runs else None, None, None)
    stats: Any = import_module("scipy.stats")  # it has no types
    found = stats.binomtest(successes, runs).proportion_ci(confidence, "wilson")
    return Share(successes / runs, float(found.low), float(found.high))


def mean_of(values: Sequence[float], confidence: float) -> Mean:
    """The mean of what can't be negative, and its Student t interval, cut off at 0.

    Args:
        values: Finite, >= 0.
        confidence: In (0, 1).
    """
    runs = len(values)
    if not runs:
        return Mean(None, None, None, 0)
    mean = math.fsum(values) / runs
    if runs < _LEAST:
        return Mean(mean, None, None, runs)
    variance = math.fsum((value - mean) ** 2 for value in values) / (runs - 1)
    special: Any = import_module("scipy.special")
    half = float(special.stdtrit(runs - 1, 0.5 + 0.5 * confidence)) * math.sqrt(variance / runs)
    return Mean(mean, max(0.0, mean - half), mean + half, runs)
