"""The delay margin against the sampled loop's own eigenvalues."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cell_firmware.delay_margin import delay_margin_s
from cell_firmware.specs import SpeedLoopSpec


def _spectral_radius(loop: SpeedLoopSpec, gain: float, tau_s: float, dead_s: float, steps: int) -> float:
    """Of the loop in steps of ``dead_s / steps``, its volts ``steps`` late: below 1 it is stable."""
    h = dead_s / steps
    decay = math.exp(-h / tau_s)
    # speed, integral of the error, volts under way (the oldest last)
    a = np.zeros((steps + 2, steps + 2))
    a[0, 0], a[0, -1] = decay, gain * (1.0 - decay)
    a[1, 0], a[1, 1] = -h, 1.0
    a[2, 0], a[2, 1] = -loop.kp_v_per_m_s, loop.ki_v_per_m
    a[3:, 2:-1] = np.eye(steps - 1)
    if not loop.ki_v_per_m:  # nothing depends on the integral
        a = np.delete(np.delete(a, 1, axis=0), 1, axis=1)
    return float(np.abs(np.linalg.eigvals(a)).max())


@pytest.mark.parametrize(
    ("kp", "ki", "gain", "tau_s"),
    [
        (12.0, 200.0, 0.1, 0.06),
        (20.0, 50.0, 0.1, 0.06),
        (5.0, 400.0, 0.1, 0.06),
        (30.0, 0.0, 0.1, 0.2),
        (0.0, 30.0, 0.2, 0.1),
    ],
)
def test_a_loop_is_stable_below_its_delay_margin_and_not_above(
    kp: float, ki: float, gain: float, tau_s: float
) -> None:
    loop = SpeedLoopSpec(kp_v_per_m_s=kp, ki_v_per_m=ki)
    margin_s = delay_margin_s(loop, gain, tau_s)
    assert _spectral_radius(loop, gain, tau_s, 0.97 * margin_s, 400) < 1.0
    assert _spectral_radius(loop, gain, tau_s, 1.03 * margin_s, 400) > 1.0


def test_the_default_loop_has_a_quarter_turn_at_its_crossover() -> None:
    # its zero cancels the motor's pole: an integrator of 20 rad/s is left
    assert delay_margin_s(SpeedLoopSpec(), 0.1, 0.06) == pytest.approx(math.pi / 2.0 / 20.0, rel=1e-12)


def test_a_loop_without_a_crossover_bears_any_dead_time() -> None:
    assert delay_margin_s(SpeedLoopSpec(kp_v_per_m_s=5.0, ki_v_per_m=0.0), 0.1, 0.06) == math.inf
