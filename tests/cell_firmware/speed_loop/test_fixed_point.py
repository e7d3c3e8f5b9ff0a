"""The loop in integers against exact rational arithmetic, and against the loop in floating point."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from numpy.typing import NDArray

from cell_firmware.components import WheelDriver
from cell_firmware.errors import SettingError
from cell_firmware.firmware import State
from cell_firmware.specs import SpeedLoopSpec
from cell_firmware.speed_loop.fixed_point import FixedPointLoop
from cell_firmware.speed_loop.scaling import Gain, Scaling
from cell_firmware.speed_loop.sensing import Encoder, FixedPointTachometer
from tests.cell_firmware.speed_loop.wheels import PERIOD_S, SUPPLY_V, TURN_M, Wheel, cells, drive, follow

SPEEDS = st.integers(-(2**15), 2**15 - 1)
SHARES = st.integers(-(2**20), 2**20)


def loop(levels: int, counts: int, *gains: float) -> FixedPointLoop:
    tachometer = Encoder(PERIOD_S, TURN_M / counts) if counts else FixedPointTachometer(PERIOD_S, 1e-3)
    kp, ki, ahead = gains
    spec = SpeedLoopSpec(kp_v_per_m_s=kp, ki_v_per_m=ki, feed_forward_v_per_m_s=ahead)
    try:
        return FixedPointLoop(Scaling(spec, PERIOD_S, SUPPLY_V, levels, tachometer), tachometer)
    except SettingError:
        assume(False)
        raise


LOOPS = st.builds(
    loop,
    st.sampled_from([1, 255, 2000, 2048, 65_535]),
    st.sampled_from([0, 16, 256, 1920]),
    st.just(0.0) | st.floats(1e-3, 1e3),
    st.just(0.0) | st.floats(1e-2, 1e5),
    st.just(0.0) | st.floats(1e-3, 30.0),
)


def acted(loop: FixedPointLoop, integral: int, reference: int, measured: int) -> tuple[int, int]:
    """The law, of one wheel."""
    after, output = loop.act(
        *(np.array([[value]], dtype=np.int32) for value in (integral, reference, measured))
    )
    assert after.dtype == output.dtype == np.int32
    return int(after[0, 0]), int(output[0, 0])


def exactly(gain: Gain) -> Fraction:
    return gain.word * Fraction(2) ** -gain.shift


@given(LOOPS, SHARES, SPEEDS, SPEEDS)
@example(loop(2000, 0, 12.0, 200.0, 0.0), 0, 0, -(2**15))
@example(loop(2000, 0, 12.0, 200.0, 0.0), 2**20, 2**15 - 1, -(2**15))
@example(
    loop(2000, 0, 1.0, 200.0, 10.0), 2**20, -1000, -2000
)  # the integral grows though the sum is within the supply
@example(loop(255, 16, 5.0, 50.0, 1.0), -(2**20), -2032, 2032)
@example(loop(2000, 1920, 5.0, 50.0, 30.0), -(2**20), 2000, 1000)  # feed-forward alone is beyond the supply
def test_a_step_is_within_its_stated_rounding_of_exact_arithmetic(
    loop: FixedPointLoop, share: int, reference: int, measured: int
) -> None:
    """Errors are limited only where that changes nothing, or to 16 bits; no sum wraps, and no sign is lost."""
    made = loop.scaling
    limit = made.output_limit
    integral = share * limit // 2**20
    reference = max(-made.reference_limit, min(made.reference_limit, reference))
    measured = max(-made.reference_limit, min(made.reference_limit, measured))
    after, output = acted(loop, integral, reference, measured)

    error = max(-(2**15 - 1), min(2**15 - 1, reference - measured))
    grown = integral + exactly(made.ki) * error
    wanted = exactly(made.feed_forward) * reference + exactly(made.kp) * error + grown
    rounding = Fraction(made.rounding_v / made.volts_per_step).limit_denominator(2)
    assert rounding <= Fraction(3, 2)
    assert abs(output - max(-limit, min(limit, wanted))) <= rounding

    assert abs(after) <= limit
    if abs(abs(wanted) - limit) <= rounding:
        return  # whether it saturates is a matter of rounding
    if abs(wanted) > limit:
        ahead = exactly(made.feed_forward) * measured
        change = max(-limit, min(limit, output - ahead)) - integral
        assert abs(after - (integral + exactly(made.share) * change)) < Fraction(3, 2)
        assert min(0, change) - Fraction(1, 2) <= after - integral <= max(0, change) + Fraction(1, 2)
    else:
        assert abs(after - max(-limit, min(limit, grown))) <= Fraction(1, 2)


@given(LOOPS, SPEEDS)
def test_no_error_is_answered_with_the_other_sign(loop: FixedPointLoop, measured: int) -> None:
    measured = max(-loop.scaling.reference_limit, min(loop.scaling.reference_limit, measured))
    after, output = acted(loop, 0, 0, measured)
    assert output * measured <= 0
    assert after * measured <= 0


def test_the_least_16_bit_number_is_negated_without_a_wrap() -> None:
    one = loop(2000, 0, 12.0, 200.0, 0.0)
    limit = one.scaling.output_limit
    moved = math.ceil(exactly(one.scaling.share) * limit)
    assert acted(one, 0, 0, -(2**15)) == (moved, limit)
    assert acted(one, 0, 0, 2**15 - 1) == (-moved, -limit)


def test_the_integral_saturates_at_the_supply() -> None:
    one = loop(2000, 0, 0.0, 200.0, 0.0)
    integral = 0
    for _ in range(3000):
        integral, output = acted(one, integral, 1000, 0)
    assert integral <= one.scaling.output_limit
    assert integral > 0.98 * one.scaling.output_limit
    assert output == one.scaling.output_limit


def test_a_reading_of_128_counts_back_does_not_wrap_what_holds_the_limit() -> None:
    """The largest feed-forward that is not refused, by 127 counts: one more and the sum would take 33 bits."""
    per_volt = loop(1, 16, 0.0, 0.01, 1.0).scaling.feed_forward.factor
    one = loop(1, 16, 0.0, 0.01, 0.9999 * (2**31 - 1) / (127 * 16) / per_volt)
    limit = one.scaling.output_limit
    assert one.scaling.feed_forward.times(128 * 16) + limit > 2**31 - 1
    after, output = acted(one, 0, 127 * 16, -128 * 16)
    assert output == limit
    assert after > 0


@pytest.mark.parametrize(("supply", "error"), [(1, 20_000), (-1, -20_000)])
def test_rounding_leaves_no_gap_to_the_supply(supply: int, error: int) -> None:
    """By the nearest, a share of 1 in 2,930 would stop 1,464 steps before."""
    one = loop(2000, 0, 12.0, 1.0, 0.0)
    assert exactly(one.scaling.share) == pytest.approx(Fraction(1, 2930), rel=1e-3)
    limit = supply * one.scaling.output_limit
    integral = limit - supply * 1000
    for _ in range(1000):
        after, output = acted(one, integral, error, 0)
        assert output == limit
        assert supply * (after - integral) > 0
        integral = after
        if integral == limit:
            break
    assert integral == limit
    assert acted(one, integral, error, 0) == (limit, limit)


@pytest.mark.parametrize(
    "gains", [SpeedLoopSpec(), SpeedLoopSpec(kp_v_per_m_s=6.0, feed_forward_v_per_m_s=9.0)]
)
def test_in_fine_units_it_moves_a_wheel_as_floating_point_does(gains: SpeedLoopSpec) -> None:
    references = [0.3] * 150 + [-0.2] * 150
    floating, _ = follow(drive(gains), references, Wheel())
    integers, _ = follow(drive(gains, fixed_point={}), references, Wheel())
    assert 0.0 < np.abs(integers - floating).max() < 5e-5  # speeds are in steps of 6.3e-5 m/s


def test_registers_are_integers() -> None:
    part = drive(fixed_point={}, encoder={}, pwm={})
    state: State = part.init(cells(2))
    state, _ = part.step(state, np.full((2, 2), 0.1), np.zeros((2, 2)))
    registers = part.registers(state)
    assert {name: (array.dtype, array.shape) for name, array in registers.items()} == {
        "integral": (np.int32, (2, 2)),
        "count": (np.uint8, (2, 2)),
        "duty": (np.int32, (2, 2)),
    }
    assert registers["integral"].min() > 0


VALUE = st.floats(-100, 100)
PAIR = st.tuples(VALUE, VALUE)
EFFECTS = ("encoder", "pwm", "fixed_point")


@given(
    st.lists(st.tuples(PAIR, PAIR, PAIR), min_size=1, max_size=12),
    st.sets(st.sampled_from(EFFECTS), min_size=1),
)
def test_a_cell_alone_gets_the_same_bits_as_among_many_with_any_of_the_effects(
    rows: list[tuple[tuple[float, float], ...]], effects: set[str]
) -> None:
    reference, first, second = (np.array(part) for part in zip(*rows, strict=True))
    part = drive(**{name: {} for name in effects})

    def run(chosen: slice) -> dict[str, NDArray[np.float64]]:
        state = part.init(cells(len(reference[chosen])))
        state, before = part.step(state, reference[chosen], first[chosen])
        state, after = part.step(state, reference[chosen], second[chosen])
        return {"before": before, "after": after, **state}

    alone = [run(slice(i, i + 1)) for i in range(len(rows))]
    for name, array in run(slice(None)).items():
        assert array.tobytes() == b"".join(one[name].tobytes() for one in alone)


@pytest.mark.parametrize(
    "effects", [["encoder"], ["pwm"], ["fixed_point"], ["encoder", "pwm"], list(EFFECTS)]
)
def test_each_effect_works_by_itself_and_with_others(effects: list[str]) -> None:
    part: WheelDriver = drive(**{name: {} for name in effects})
    speeds, _ = follow(part, [0.4] * 600, Wheel())
    assert abs(speeds[300:].mean() / 0.4 - 1.0) < 0.03
