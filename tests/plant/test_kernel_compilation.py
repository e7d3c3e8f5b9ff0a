"""Kernels that only kernels call stay intermediate code, and what comes of them are the bits of numba's own way."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numba
import numpy as np
import pytest

from bus.kernel_cache import callee

FULL = numba.njit(error_model="numpy", _nrt=False)


def _settled(make: Callable[[Any], Any]) -> Callable[[float, int], float]:
    """An entry point over two levels of callees made by ``make``, with branches, a loop and what rounds."""

    def pull(x: float, k: float) -> float:
        return -k * x / (1.0 + x * x) if x > 0.1 else np.sin(k * x)

    pull_kernel = make(pull)

    def step(x: float, k: float) -> float:
        for _ in range(3):
            x += 0.01 * pull_kernel(x, k)
        return x

    step_kernel = make(step)

    @FULL
    def entry(x: float, steps: int) -> float:
        for n in range(steps):
            x = step_kernel(x, 1.0 + 1e-3 * n)
        return x

    return entry


@pytest.mark.parametrize("x", [0.3, -0.7, 1e-9, 5.0])
def test_callees_that_stay_intermediate_code_give_the_bits_of_whole_compilation(x: float) -> None:
    assert _settled(callee.kernel)(x, 500).hex() == _settled(FULL)(x, 500).hex()


def test_a_kernel_has_no_machine_code_of_its_own() -> None:
    made = callee.kernel(lambda x: x + 1.0)

    @FULL
    def call(x: float) -> float:
        return made(x)

    assert call(1.0) == 2.0
    (signature,) = made.signatures
    assert type(made.overloads[signature].library) is callee.CalleeLibrary
    assert type(call.overloads[call.signatures[0]].library) is not callee.CalleeLibrary


def _afresh() -> ModuleType:
    located = importlib.util.spec_from_file_location("callee_afresh", Path(callee.__file__))
    assert located is not None
    assert located.loader is not None
    module = importlib.util.module_from_spec(located)
    located.loader.exec_module(module)
    return module


def test_an_untried_numba_compiles_every_kernel_in_full(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba, "version_info", numba.version_info._replace(minor=callee.TRIED[1][1] + 1))
    made = _afresh().kernel(lambda x: x + 1.0)
    made.compile((numba.float64,))
    assert "CalleeLibrary" not in {
        cls.__name__ for cls in type(made.overloads[made.signatures[0]].library).__mro__
    }
