"""The integer speed loop as a program of the MC68HC11: the same bits, in the time that warnings count with."""

from __future__ import annotations

import numpy as np
import pytest

from cell_firmware.processor_time import LOOP_E
from tests.cell_firmware.speed_loop.hc11_cases import compared


@pytest.mark.parametrize("near", [False, True], ids=["anywhere", "near the loop"])
def test_the_unrolled_program_has_the_loops_bits_and_takes_the_time_that_is_counted(near: bool) -> None:
    found = compared(150, near=near, seed=4)
    np.testing.assert_array_equal(found.integral, found.expected_integral)
    np.testing.assert_array_equal(found.duty, found.expected_duty)
    least, most = LOOP_E
    assert least <= found.cycles.min() <= found.cycles.max() <= most
    assert set(found.saturated) == {0, 1, 2} if not near else 0 in found.saturated
