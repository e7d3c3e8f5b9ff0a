"""Settings of the effects on a wheel's drive: ``encoder``, ``pwm``, ``fixed_point``."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pydantic import ValidationError

from cell_firmware.effects.encoder import EncoderSpec
from cell_firmware.effects.pwm import PwmSpec


@pytest.mark.parametrize(
    ("settings", "counts"),
    [
        ({}, 2000),
        ({"levels": 255}, 255),
        ({"frequency_hz": 1000.0}, 2000),
        ({"frequency_hz": 7800.0}, 256),
        ({"frequency_hz": 31.0}, 64_516),
    ],
)
def test_levels_are_the_timer_s_counts_of_a_pulse_period(settings: dict[str, Any], counts: int) -> None:
    assert PwmSpec.model_validate(settings).counts == counts


@pytest.mark.parametrize(
    ("settings", "rule"),
    [
        ({"levels": 2000, "frequency_hz": 1000.0}, "give levels or frequency_hz, not both"),
        ({"levels": 0}, "greater than or equal to 1"),
        ({"levels": 65_536}, "less than or equal to 65535"),
        ({"frequency_hz": 30.0}, "greater than or equal to 31"),
    ],
)
def test_pulses_that_the_timer_can_t_make_are_refused(settings: dict[str, Any], rule: str) -> None:
    with pytest.raises(ValidationError, match=rule):
        PwmSpec.model_validate(settings)


@pytest.mark.parametrize(
    ("own", "motors", "radius"),
    [(None, None, 0.03), (0.02, None, 0.02), (None, 0.05, 0.05), (0.05, 0.05, 0.05)],
)
def test_a_count_is_a_share_of_the_wheel_s_circumference(
    own: float | None, motors: float | None, radius: float
) -> None:
    spec = EncoderSpec(counts_per_revolution=100, wheel_radius_m=own)
    assert spec.m_per_count(motors) == pytest.approx(math.tau * radius / 100, rel=1e-15)
