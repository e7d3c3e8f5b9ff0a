"""Settings of the effect ``clock`` and what they give every cell."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from bus.lattice import Lattice
from cell_firmware.effects.clock.spec import CellClockSpec, ClockSpec
from cell_firmware.specs import CellsSpec

PERIOD_NS = 4_096_000
LARGE = Lattice((r, c) for r in range(60) for c in range(60))


def test_errors_and_phases_are_drawn_evenly_over_their_whole_ranges() -> None:
    clocks = ClockSpec(error_ppm=100).clocks(LARGE, PERIOD_NS, 7).clocks
    for drawn, low, high in ((clocks.ppb, -100_000, 100_001), (clocks.phase_ns, 0, PERIOD_NS)):
        counts, _ = np.histogram(drawn, bins=10, range=(low, high))
        assert counts.sum() == 3_600  # none lies outside
        assert ((counts - 360.0) ** 2 / 360.0).sum() < 27.9  # chi-squared, 9 degrees: 0.1 % lie beyond


def test_errors_phases_and_cells_are_drawn_apart() -> None:
    clocks = ClockSpec(error_ppm=100).clocks(LARGE, PERIOD_NS, 7).clocks
    assert abs(np.corrcoef(clocks.ppb, clocks.phase_ns)[0, 1]) < 0.06
    assert abs(np.corrcoef(clocks.ppb[1:], clocks.ppb[:-1])[0, 1]) < 0.06
    other = ClockSpec(error_ppm=100).clocks(LARGE, PERIOD_NS, 8).clocks
    assert abs(np.corrcoef(clocks.ppb, other.ppb)[0, 1]) < 0.06


def test_a_cell_s_own_clock_changes_no_other_s() -> None:
    lattice = Lattice([(0, 0), (0, 1), (2, 5)])
    own = CellClockSpec(cell=(2, 5), error_ppm=-12.345, phase_s=0.001)
    drawn = ClockSpec().clocks(lattice, PERIOD_NS, 1).clocks
    known = ClockSpec(cells=(own,)).clocks(lattice, PERIOD_NS, 1).clocks
    assert known.ppb.tolist() == [*drawn.ppb[:2].tolist(), -12_345]
    assert known.phase_ns.tolist() == [*drawn.phase_ns[:2].tolist(), 1_000_000]


def test_clocks_are_found_by_row_and_column() -> None:
    lattice = Lattice([(0, 0), (0, 1), (2, 5)])
    clocks = ClockSpec().clocks(lattice, PERIOD_NS, 1)
    row, column = np.array([[2, 0], [1, 0]]), np.array([[5, 1], [0, 9]])
    assert clocks.ppb(row, column).tolist() == [[clocks.clocks.ppb[2], clocks.clocks.ppb[1]], [0, 0]]
    assert clocks.of(row[0], column[0]).phase_ns.tolist() == clocks.clocks.phase_ns[[2, 1]].tolist()


def test_a_window_is_the_shortest_period_that_the_settings_allow_or_a_part_of_it() -> None:
    assert ClockSpec(error_ppm=0).window_ns(PERIOD_NS) == PERIOD_NS
    assert ClockSpec(error_ppm=50).window_ns(PERIOD_NS) == 4_095_795
    fast = CellClockSpec(cell=(0, 0), error_ppm=-1000)
    assert ClockSpec(error_ppm=50, cells=(fast,)).window_ns(PERIOD_NS) == 4_091_904
    slow = CellClockSpec(cell=(0, 0), error_ppm=1000)
    assert ClockSpec(error_ppm=50, cells=(slow,), exchanges_per_period=4).window_ns(PERIOD_NS) == 1_023_948


@pytest.mark.parametrize("exchanges", [1, 5])
def test_no_cell_has_two_instants_in_a_window(exchanges: int) -> None:
    spec = ClockSpec(error_ppm=60_000, exchanges_per_period=exchanges)
    clocks = spec.clocks(LARGE, PERIOD_NS, 5).clocks
    at = clocks.instant(np.zeros(len(LARGE), dtype=np.int64))
    for number in range(1, 30):
        after = clocks.instant(np.full(len(LARGE), number))
        assert (after // clocks.window_ns > at // clocks.window_ns).all()
        at = after


@pytest.mark.parametrize(
    ("settings", "rule"),
    [
        ({"error_ppm": 60_001}, "less than or equal to 60000"),
        ({"error_ppm": 0.0001}, "must be a whole number of ppb"),
        ({"error_ppm": -1}, "greater than or equal to 0"),
        ({"phase": "late"}, "'random' or 'aligned'"),
        ({"exchanges_per_period": 0}, "greater than or equal to 1"),
        ({"cells": [{"cell": [0, 0]}, {"cell": [0, 0], "phase_s": 0.0}]}, r"cells names \[0, 0\] twice"),
        ({"cells": [{"cell": [0, 0], "phase_s": 1.5e-9}]}, "must be a whole number of nanoseconds"),
        ({"cells": [{"cell": [0, 0], "error_ppm": 0.00001}]}, "must be a whole number of ppb"),
    ],
)
def test_settings_that_make_no_clock_are_refused(settings: dict[str, Any], rule: str) -> None:
    with pytest.raises(ValidationError, match=rule):
        ClockSpec.model_validate(settings)


def test_settings_that_do_not_fit_the_cells_are_named() -> None:
    late = CellClockSpec(cell=(3, 3), phase_s=0.004096)
    spec = ClockSpec(cells=(CellClockSpec(cell=(0, 0), phase_s=0.0), late))
    assert list(spec.fit_problems(CellsSpec())) == [
        (("cells", 1, "phase_s"), 0.004096, "must be less than cells.period_s")
    ]
    assert list(spec.problems(Lattice([(0, 0)]), 0.1)) == [
        (("cells", 1, "cell"), [3, 3], "the array has no cell there")
    ]
    (short,) = ClockSpec(exchanges_per_period=64).fit_problems(CellsSpec(period_s=5e-8))
    assert short == (("exchanges_per_period",), 64, "windows of less than a nanosecond in a period of 50 ns")
