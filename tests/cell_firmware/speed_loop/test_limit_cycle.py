"""The integer loop never settles on a motor with friction; how far it strays is the encoder's doing.

Motor: time constant 60 ms, 1.2 m/s (6.4 rev/s) at 12 V, Coulomb friction 4 % and static friction 7 % of the supply;
2 rev/s asked for; kp 6 V per m/s, ki 100 V/m. Rms and peak to peak are of the true speed at the ends of the control
periods about its mean, over 8 s after 4 s.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from cell_firmware.specs import SpeedLoopSpec
from tests.cell_firmware.speed_loop.wheels import PERIOD_S, SUPPLY_V, TURN_M, Wheel, drive, follow

GAINS = SpeedLoopSpec(kp_v_per_m_s=6.0, ki_v_per_m=100.0)
WANTED = 2.0
BEGIN, END = round(4.0 / PERIOD_S), round(12.0 / PERIOD_S)


@cache
def speeds(counts: int | None, levels: int | None, wanted: float = WANTED) -> NDArray[np.float64]:
    """True speeds in rev/s of an integer loop with an encoder and PWM, or the floating one with neither."""
    wheel = Wheel(0.04 * SUPPLY_V, 0.07 * SUPPLY_V)
    part = drive(GAINS)
    if counts is not None:
        part = drive(GAINS, encoder={"counts_per_revolution": counts}, pwm={"levels": levels}, fixed_point={})
    found, _ = follow(part, [wanted * TURN_M] * END, wheel)
    return found[BEGIN:] / TURN_M


def rms(counts: int, levels: int = 2000, wanted: float = WANTED) -> float:
    return float(speeds(counts, levels, wanted).std())


@pytest.mark.parametrize(("counts", "expected", "peaks"), [(256, 0.012, 0.040), (1920, 0.0016, 0.0053)])
def test_the_integer_loop_strays_by_as_much_as_the_study_says(
    counts: int, expected: float, peaks: float
) -> None:
    assert rms(counts) == pytest.approx(expected, rel=0.1)
    assert np.ptp(speeds(counts, 2000)) == pytest.approx(peaks, rel=0.2)


def test_it_never_settles() -> None:
    late = speeds(256, 2000)
    for part in np.array_split(late, 8):
        assert part.std() > 0.008


def test_straying_scales_as_one_over_the_counts() -> None:
    assert rms(256) / rms(1920) == pytest.approx(7.5, rel=0.2)


def test_floating_point_settles() -> None:
    assert np.sqrt(np.mean((speeds(None, None) - WANTED) ** 2)) < 1e-5


@pytest.mark.parametrize(("counts", "wanted"), [(256, 1.9), (256, 2.0), (256, 2.1), (1920, 2.0)])
def test_levels_of_the_pwm_hardly_matter(counts: int, wanted: float) -> None:
    """At 1,920 counts they matter more at other speeds: a level is no longer small beside a sixteenth of a count."""
    assert rms(counts, 255, wanted) == pytest.approx(rms(counts, 2000, wanted), rel=0.2)


@pytest.mark.parametrize("counts", [256, 1920])
def test_the_mean_is_off_by_no_more_than_the_rounding_of_the_reference(counts: int) -> None:
    per_count = 1.0 / (counts * PERIOD_S)
    assert abs(speeds(counts, 2000).mean() - WANTED) < per_count / 32 * 1.05
