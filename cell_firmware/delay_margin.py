"""Delay margin of a speed loop: how much dead time it bears."""

from __future__ import annotations

import math

from cell_firmware.specs import SpeedLoopSpec


def delay_margin_s(loop: SpeedLoopSpec, speed_per_volt_m_s: float, time_constant_s: float) -> float:
    """Return the dead time at which a PI loop on a first-order motor becomes unstable, s; infinite without a crossover.

    The phase margin at the gain's crossover divided by that frequency (Åström and Murray, *Feedback Systems*, 2008,
    section 9.3), for the loop gain ``K (kp s + ki) / (s (tau s + 1))``.

    Args:
        loop: Gains.
        speed_per_volt_m_s: K, steady speed per volt, m/s.
        time_constant_s: tau, s.
    """
    kp, ki = loop.kp_v_per_m_s * speed_per_volt_m_s, loop.ki_v_per_m * speed_per_volt_m_s
    # |L| = 1: tau^2 w^4 + (1 - kp^2) w^2 - ki^2 = 0, a quadratic in w^2 with one root that is not negative
    a, b, c = time_constant_s * time_constant_s, 1.0 - kp * kp, -ki * ki
    root = math.sqrt(b * b - 4.0 * a * c)
    squared = (root - b) / (2.0 * a) if b < 0.0 else -2.0 * c / (root + b)
    if squared <= 0.0:
        return math.inf
    frequency = math.sqrt(squared)
    # without an integral there is neither its pole at zero nor its lag of a quarter turn
    phase = math.atan2(kp * frequency, ki) - math.atan(time_constant_s * frequency) + math.pi / 2.0
    return phase / frequency
