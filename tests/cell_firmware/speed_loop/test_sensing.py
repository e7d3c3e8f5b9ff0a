"""What speed loops read of their wheels."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from cell_firmware.errors import FirmwareError
from cell_firmware.speed_loop.sensing import (
    Encoder,
    FixedPointTachometer,
    IntegerTachometer,
    Tachometer,
    Travel,
)
from tests.cell_firmware.speed_loop.wheels import PERIOD_S, TURN_M

M_PER_COUNT = 2.0**-10  # exact, so that travel on the border of a count is


def readings(tachometer: Tachometer, travel: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of a wheel, ``(ticks,)``; the other one goes backwards."""
    state = tachometer.init(1)
    found: list[NDArray[np.float64]] = []
    for at in travel:
        state, reading = tachometer.read(state, np.array([[at, -at]]))
        found.append(reading[0])
    return np.array(found)


@pytest.mark.parametrize(("counts", "revolutions_per_s"), [(256, 0.954), (1920, 0.127)])
def test_velocity_resolution_is_that_of_a_count_a_period(counts: int, revolutions_per_s: float) -> None:
    encoder = Encoder(PERIOD_S, TURN_M / counts)
    assert encoder.unit_m_s / TURN_M == pytest.approx(revolutions_per_s, abs=5e-4)
    assert encoder.unit_m_s / TURN_M == pytest.approx(1.0 / (counts * PERIOD_S), rel=1e-14)


def test_the_encoder_counts_whole_counts_downwards_from_the_travel() -> None:
    travel = np.array([0.0, 0.999, 1.0, 1.001, 3.5]) * M_PER_COUNT
    found = readings(Encoder(PERIOD_S, M_PER_COUNT), travel)
    assert found[:, 0].tolist() == [0, 0, 1, 0, 2]
    assert found[:, 1].tolist() == [0, -1, 0, -1, -2]


def test_the_counter_wraps_at_256_and_its_differences_do_not() -> None:
    encoder = Encoder(PERIOD_S, M_PER_COUNT)
    state = encoder.init(1)
    forwards: list[int] = []
    backwards: list[int] = []
    for tick in range(20):
        state, reading = encoder.read(state, np.array([[127.0, -127.0]]) * tick * M_PER_COUNT)
        assert state["count"].dtype == np.uint8
        assert state["count"].tolist() == [[127 * tick % 256, -127 * tick % 256]]
        forwards.append(int(reading[0, 0]))
        backwards.append(int(reading[0, 1]))
    assert forwards == [0] + [127] * 19
    assert backwards == [0] + [-127] * 19


def test_more_than_127_counts_a_period_alias() -> None:
    found = readings(Encoder(PERIOD_S, M_PER_COUNT), np.array([0.0, 128.0, 257.0]) * M_PER_COUNT)
    assert found[:, 0].tolist() == [0, -128, -127]


@given(st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=6), st.floats(1e-6, 1.0))
def test_counts_are_those_of_exact_arithmetic_modulo_256(travel: list[float], m_per_count: float) -> None:
    encoder = Encoder(PERIOD_S, m_per_count)
    exact = [int(Fraction(at / m_per_count) // 1) for at in travel]
    expected = [(b - a + 128) % 256 - 128 for a, b in pairwise(exact)]
    assert readings(encoder, np.array(travel))[1:, 0].tolist() == expected


@pytest.mark.parametrize(
    "tachometer", [Travel(PERIOD_S), FixedPointTachometer(PERIOD_S, 1e-3), Encoder(PERIOD_S, M_PER_COUNT)]
)
def test_the_first_reading_is_0_wherever_the_wheel_stands(tachometer: Tachometer) -> None:
    assert readings(tachometer, np.array([123.4, 123.4])).tolist() == [[0, 0], [0, 0]]


def test_words_are_sixteenths_of_their_unit_and_saturate() -> None:
    words = FixedPointTachometer(PERIOD_S, 1e-3)
    assert words.step_m_s == pytest.approx(1e-3 / 16)
    travel = np.cumsum([0.0, 0.3, 1e3, 2.0001e-3 / 16]) * PERIOD_S
    assert readings(words, travel).tolist() == [[0, 0], [4800, -4800], [32767, -32767], [2, -2]]


@pytest.mark.parametrize("tachometer", [FixedPointTachometer(PERIOD_S, 1e-2), Encoder(PERIOD_S, M_PER_COUNT)])
def test_integers_in_q4_stand_for_the_speed_that_they_are_read_from(tachometer: IntegerTachometer) -> None:
    speed = 20 * M_PER_COUNT / PERIOD_S
    reading = int(readings(tachometer, np.array([0.0, speed * PERIOD_S]))[1, 0])
    in_q4 = reading << (4 - tachometer.fraction_bits)
    assert in_q4 * tachometer.step_m_s == pytest.approx(speed, abs=tachometer.step_m_s / 2)


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_a_count_without_length_is_refused(value: float) -> None:
    with pytest.raises(FirmwareError, match="m_per_count must be positive and finite"):
        Encoder(PERIOD_S, value)
