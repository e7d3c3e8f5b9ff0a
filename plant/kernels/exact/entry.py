"""The compiled entry points, cached on disk; importing this module loads or compiles nothing yet."""

from __future__ import annotations

from numba import njit

from bus.kernel_cache.locator import disk_cached
from plant.kernels.common import footprint
from plant.kernels.exact import block

with disk_cached(__name__):
    advance_block = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(block.advance_block.py_func)
    advance_segmented = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(
        block.advance_segmented.py_func
    )
    cover = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(footprint.cover.py_func)
    any_rest_change = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(
        footprint.any_rest_change.py_func
    )
