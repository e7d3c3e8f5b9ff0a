"""Elementary functions of arrays: the C library's, in the shape of their argument."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from bus import elementary

WITHOUT_FMA = "glibc.cpu.hwcaps=-AVX2_Usable,-FMA_Usable,-AVX2,-FMA,-AVX,-FMA4"


@pytest.mark.parametrize("name", ["exp", "expm1", "sin", "cos"])
def test_every_element_is_that_of_the_c_library(name: str) -> None:
    x = np.linspace(-30.0, 30.0, 600).reshape(20, 30)
    found = getattr(elementary, name)(x)
    assert found.shape == x.shape
    assert found.ravel().tolist() == [getattr(math, name)(one) for one in x.ravel().tolist()]
    # an engine of its own agrees to the last bits
    np.testing.assert_allclose(found, getattr(np, name)(x), rtol=4e-16, atol=4e-16)


def test_an_exponential_beyond_all_numbers_is_infinite() -> None:
    assert elementary.exp([1e3, -1e3]).tolist() == [math.inf, 0.0]


def test_compiled_kernels_call_the_same_library() -> None:
    from plant.kernels.wheels import entry

    kernels: Any = entry
    x = np.linspace(-40.0, 5.0, 3_000)
    found = np.empty_like(x)
    kernels.exp_of_each(x, found)
    assert found.tolist() == elementary.exp(x).tolist()
    # the way of wheels that slow down from -1 m/s at 1/s
    still, changes, way = np.zeros((len(x), 2)), np.empty((0, len(x), 2)), np.empty((3, len(x), 2))
    kernels.pass_changes(still, still - 1.0, 1.0, changes, changes, changes, -x, 0.0, *way)
    assert way[0, :, 0].tolist() == elementary.expm1(x).tolist()


def test_hosts_with_other_functions_have_another_fingerprint() -> None:
    code = (
        "from bus.elementary import fingerprint; import math; "
        "print(fingerprint(), [math.exp(k / 997) for k in range(20_000)])"
    )
    outputs = [
        subprocess.run(
            [sys.executable, "-c", code],
            env={**os.environ, **more},
            capture_output=True,
            text=True,
            check=True,
        ).stdout.split(maxsplit=1)
        for more in ({}, {}, {"GLIBC_TUNABLES": WITHOUT_FMA})
    ]
    assert outputs[0] == outputs[1]
    if outputs[2][1] == outputs[0][1]:
        pytest.skip("this C library has one exponential alone")
    assert outputs[2][0] != outputs[0][0]
