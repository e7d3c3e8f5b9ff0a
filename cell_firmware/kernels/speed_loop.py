"""The PI loops of ``cell_firmware.speed_loop`` for one wheel: tachometers, both laws, pulse-width modulation."""

from __future__ import annotations

import numpy as np

from cell_firmware.kernels.jit import kernel

FIXED_POINT = 1
"""Kind of a loop, in integers; ..."""
FLOATING_POINT = 2
"""... in floating point."""
TRAVEL = 0
"""Kind of a tachometer: the exact travel; ..."""
WORD = 1
"""... rounded to a word in Q4; ..."""
COUNTER = 2
"""... an 8-bit counter of counts of the encoder."""

LOOP = np.dtype(
    [
        ("kind", "<i8"),
        ("tachometer", "<i8"),
        ("period_s", "<f8"),
        ("unit_m_s", "<f8"),
        ("m_per_count", "<f8"),
        ("largest", "<i8"),
        ("fraction_shift", "<i8"),
        ("supply_v", "<f8"),
        ("levels", "<i8"),  # of PWM; 0: none
        # fixed point
        ("step_m_s", "<f8"),
        ("volts_per_step", "<f8"),
        ("reference_limit", "<i8"),
        ("error_limit", "<i8"),
        ("output_limit", "<i8"),
        ("kp_word", "<i8"),
        ("kp_shift", "<i8"),
        ("ki_word", "<i8"),
        ("ki_shift", "<i8"),
        ("ahead_word", "<i8"),
        ("ahead_shift", "<i8"),
        ("share_word", "<i8"),
        ("share_shift", "<i8"),
        # floating point
        ("kp", "<f8"),
        ("ki", "<f8"),
        ("ahead", "<f8"),
        ("share", "<f8"),
    ]
)
"""Constants of a loop; a field that its kind does not use is 0."""

WHEELS = np.dtype(
    [
        # of a behavioural cell
        ("integral_v", "<f8", (2,)),
        ("encoder_m", "<f8", (2,)),
        # of one with a loop in integers and counters
        ("integral", "<i4", (2,)),
        ("duty", "<i4", (2,)),
        ("count", "u1", (2,)),
        # of both
        ("seen", "u1", (1,)),
    ],
    align=True,
)
"""State of a cell's loop; one kind of loop and tachometer uses some of it."""

_OUTPUT_BITS = 12
_HALF = 1 << (_OUTPUT_BITS - 1)


@kernel
def within(value, limit):
    """The value, no further from zero than a limit."""
    return min(max(value, -limit), limit)


@kernel
def times(word, shift, value):
    """``Gain.times``."""
    if shift <= 0:
        return (value * word) << -shift
    return (value * word + (np.int64(1) << (shift - 1))) >> shift


@kernel
def away_from_zero(word, shift, value):
    """``Gain.away_from_zero``: in 64 bits the product needs no halves."""
    moved = (abs(value) * word + (np.int64(1) << shift) - 1) >> shift
    return -moved if value < 0 else moved


@kernel
def counted(k, encoder_m):
    """The count of the 8-bit counter."""
    return np.int64(np.floor(encoder_m / k.m_per_count)) & 255


@kernel
def signed_difference(count, before):
    """The difference of two 8-bit counts as a signed byte."""
    return ((count - before + 128) & 255) - 128


@kernel
def nearest(value, largest):
    """Rounded to the nearest integer, ties to even, and no further from zero than ``largest``."""
    return np.int64(np.rint(min(max(value, -float(largest)), float(largest))))


@kernel
def measured_m_s(k, encoder_m, count, last_m, last_count):
    """The speed that a loop in floating point reads, m/s."""
    if k.tachometer == COUNTER:
        return signed_difference(count, last_count) * k.unit_m_s
    return (encoder_m - last_m) / k.period_s * k.unit_m_s


@kernel
def measured_q4(k, encoder_m, count, last_m, last_count):
    """The speed that a loop in integers reads, Q4."""
    if k.tachometer == COUNTER:
        return signed_difference(count, last_count) << k.fraction_shift
    return nearest((encoder_m - last_m) / k.period_s / k.unit_m_s, k.largest) << k.fraction_shift


@kernel
def act_fixed(k, integral, reference, measured):
    """``FixedPointLoop.act``: the next integral and the output, Q12, from an integral and two speeds in Q4."""
    error = within(reference - measured, k.error_limit)
    grown = integral + times(k.ki_word, k.ki_shift, error)
    wanted = times(k.ahead_word, k.ahead_shift, reference) + times(k.kp_word, k.kp_shift, error) + grown
    output = within(wanted, k.output_limit)
    if wanted == output:
        return within(grown, k.output_limit), output
    ahead = times(k.ahead_word, k.ahead_shift, within(measured, k.reference_limit))
    holding = within(output - ahead, k.output_limit)
    return integral + away_from_zero(k.share_word, k.share_shift, holding - integral), output


@kernel
def whole_levels(output):
    """An output in Q12 as whole levels, the magnitude rounded to the nearest, ties up."""
    levels = (abs(output) + _HALF) >> _OUTPUT_BITS
    return -levels if output < 0 else levels


@kernel
def act_floating(k, integral_v, reference_m_s, measured):
    """The law of ``SpeedLoop``: the next integral and the voltage, V."""
    error = reference_m_s - measured
    ahead = k.ahead * reference_m_s + k.kp * error
    grown = integral_v + k.ki * error * k.period_s
    wanted = ahead + grown
    volts = within(wanted, k.supply_v)
    if wanted == volts:
        return grown, volts
    return integral_v + k.share * (volts - k.ahead * measured - integral_v), volts


@kernel
def duty_of(k, volts):
    """``Pwm.duty``: whole counts, magnitudes rounded to the nearest, ties up."""
    counts = np.int64(np.floor(abs(volts) * (k.levels / k.supply_v) + 0.5))
    return -counts if volts < 0.0 else counts


@kernel
def drive_wheel(k, wheels, axis, reference_m_s, encoder_m):
    """One control period of a wheel.

    Args:
        k: Record of ``LOOP``.
        wheels: Record of ``WHEELS``; the caller sets ``seen`` after both wheels.
        axis: Of the cell's wheels.
        reference_m_s: Wanted speed, finite.
        encoder_m: Travel since the start.

    Returns:
        The motor's voltage, V.
    """
    last_m, last_count, seen = wheels.encoder_m[axis], np.int64(wheels.count[axis]), wheels.seen[0] != 0
    count = counted(k, encoder_m) if k.tachometer == COUNTER else 0
    if k.kind == FIXED_POINT:
        measured = measured_q4(k, encoder_m, count, last_m, last_count) if seen else 0
        reference = nearest(reference_m_s / k.step_m_s, k.reference_limit)
        after, output = act_fixed(k, np.int64(wheels.integral[axis]), reference, measured)
        wheels.integral[axis] = after
        volts = output * k.volts_per_step
        levels = whole_levels(output)
    else:
        speed = measured_m_s(k, encoder_m, count, last_m, last_count) if seen else 0.0
        after_v, volts = act_floating(k, wheels.integral_v[axis], reference_m_s, speed)
        wheels.integral_v[axis] = after_v
        levels = duty_of(k, volts) if k.levels else 0
    if k.levels:
        wheels.duty[axis] = levels
        volts = levels * k.supply_v / k.levels
    if k.tachometer == COUNTER:
        wheels.count[axis] = count
    else:
        wheels.encoder_m[axis] = encoder_m
    return volts
