"""Elementary functions of arrays, by one engine: the C library, element by element.

NumPy has its own ``exp``, ``log1p``, ``sin`` and ``cos``, several of each, and takes one by the processor's features.
Their last bits differ. Whatever a run's digest depends on uses these functions instead, or kernels, which call the C
library too.

The C library takes one of several by the processor as well (``exp`` with fused multiply-add or without). `fingerprint`
tells whether two hosts have the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

_FUNCTIONS: Final[tuple[Callable[[float], float], ...]] = (
    math.exp,
    math.expm1,
    math.log,
    math.log1p,
    math.sin,
    math.cos,
    math.tan,
    math.tanh,
    math.atan,
)
_PROBES: Final = 2_000
"""Arguments of each function for a fingerprint."""


def exp(x: ArrayLike) -> Floats:
    """Return e to the power of each element, in the shape of ``x``; overflow is infinite."""
    return _each(_exp, x)


def expm1(x: ArrayLike) -> Floats:
    """Return ``exp(x) - 1`` of each element, exact for small ones, in the shape of ``x``."""
    return _each(math.expm1, x)


def sin(x: ArrayLike) -> Floats:
    """Return the sine of each element, rad, in the shape of ``x``."""
    return _each(math.sin, x)


def cos(x: ArrayLike) -> Floats:
    """Return the cosine of each element, rad, in the shape of ``x``."""
    return _each(math.cos, x)


def _exp(x: float) -> float:
    try:
        return math.exp(x)
    except OverflowError:
        return math.inf


def _each(function: Callable[[float], float], x: ArrayLike) -> Floats:
    values = np.asarray(x, dtype=np.float64)
    return np.array(list(map(function, values.ravel().tolist())), dtype=np.float64).reshape(values.shape)


@cache
def fingerprint() -> str:
    """Return a hash of the C library's results: equal on hosts whose functions have equal bits at all probes."""
    # a sequence that fills the interval evenly, by additions and multiplications alone
    golden = 0.6180339887498949
    probes = [(k * golden) % 1.0 for k in range(1, _PROBES + 1)]
    found = sha256()
    for function in _FUNCTIONS:
        found.update(np.array([function(20.0 * one) for one in probes]).tobytes())
        found.update(np.array([function(one) for one in probes]).tobytes())
    return found.hexdigest()[:16]
