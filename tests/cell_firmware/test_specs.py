import pytest
from pydantic import ValidationError

from cell_firmware.specs import CellsSpec


def test_the_default_period_is_one_real_time_interrupt_in_nanoseconds():
    assert CellsSpec().period_ns == 4_096_000


@pytest.mark.parametrize(
    ("seconds", "whole"), [(1e-9, 1), (0.1, 100_000_000), (0.008192, 8_192_000), (2, 2 * 10**9)]
)
def test_a_period_is_read_as_the_decimal_number_that_was_written(seconds: float, whole: int):
    assert CellsSpec(period_s=seconds).period_ns == whole


@pytest.mark.parametrize("seconds", [0.0, -1.0, float("nan"), float("inf"), 1e-10, 1.5e-9, 1 / 3])
def test_a_period_must_be_a_positive_whole_number_of_nanoseconds(seconds: float):
    with pytest.raises(ValidationError) as caught:
        CellsSpec(period_s=seconds)
    assert caught.value.errors()[0]["loc"] == ("period_s",)


def test_the_message_about_a_fractional_period_says_how_many_nanoseconds_it_would_be():
    with pytest.raises(ValidationError, match=r"whole number of nanoseconds, at least 1, not 1\.5 ns"):
        CellsSpec(period_s=1.5e-9)


def test_unknown_keys_are_refused():
    with pytest.raises(ValidationError, match="perod_s"):
        CellsSpec.model_validate({"perod_s": 0.004096})
