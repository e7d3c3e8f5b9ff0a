"""The implicit solver's compiled entry point, cached on disk; importing this module loads or compiles nothing yet."""

from __future__ import annotations

from numba import njit

from bus.kernel_cache.locator import disk_cached
from plant.kernels.implicit import block as implicit_block

with disk_cached(__name__):
    advance_block = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(
        implicit_block.advance_block.py_func
    )
