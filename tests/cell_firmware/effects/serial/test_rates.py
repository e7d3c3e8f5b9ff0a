"""Rates of the SCI."""

from __future__ import annotations

import pytest

from cell_firmware.effects.serial.timing import BIT_CLOCKS, E_CLOCK_NS, bit_ns


def test_a_byte_at_9615_baud_takes_2080_e_clocks_and_at_125000_160() -> None:
    assert 10 * bit_ns(9615) == 2080 * E_CLOCK_NS == 1_040_000
    assert 10 * bit_ns(125_000) == 160 * E_CLOCK_NS == 80_000


def test_every_rate_is_the_fastest_over_a_prescaler_and_a_power_of_two() -> None:
    rates = {round(125_000 / prescaler / 2**n) for prescaler in (1, 3, 4, 13) for n in range(8)}
    assert BIT_CLOCKS.keys() == rates
    for baud in rates:
        assert 1e9 / bit_ns(baud) == pytest.approx(baud, abs=0.5)


@pytest.mark.parametrize(("baud", "nearest"), [(9600, 9615), (115_200, 125_000), (19_200, 20_833), (0, 75)])
def test_another_rate_is_refused_with_the_nearest(baud: int, nearest: int) -> None:
    with pytest.raises(ValueError, match=f"the nearest is {nearest}$"):
        bit_ns(baud)
