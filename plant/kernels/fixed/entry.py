"""The explicit solver's compiled entry point, cached on disk; importing this module compiles nothing yet."""

from __future__ import annotations

from numba import njit

from bus.kernel_cache.locator import disk_cached
from plant.kernels.fixed import block as fixed_block

with disk_cached(__name__):
    advance_block = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(
        fixed_block.advance_block.py_func
    )
