"""Compilation of cell kernels: the same bits as NumPy's, no fused multiply-add, no reordering."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import from_dtype, njit, types

from bus.kernel_cache.callee import inlined, kernel
from bus.kernel_cache.locator import disk_cached
from cell_firmware.kernels import wide  # noqa: F401 - tells the compiler how drafts are written

__all__ = ["BOOLEAN", "INTEGER", "REAL", "entry", "inlined", "kernel", "read", "written"]


def entry(*arguments: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorator of functions that Python calls: compiled, or loaded from disk, when their module is imported.

    Processes of cells are forked from one that has imported the kernels.

    Args:
        *arguments: Types of the arguments.
    """

    def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
        with disk_cached(function.__module__):
            return njit(arguments, cache=True, nogil=True, error_model="numpy", _nrt=False)(function)

    return compiled


def read(kind, dimensions):
    """Type of an array that a kernel reads, in one piece (``arguments.readable``)."""
    return types.Array(_element(kind), dimensions, "C", readonly=True)


def written(kind, dimensions):
    """Type of an array that a kernel fills or changes, in one piece."""
    return types.Array(_element(kind), dimensions, "C")


def _element(kind):
    return from_dtype(np.dtype(kind))


INTEGER = types.int64
REAL = types.float64
BOOLEAN = types.boolean
