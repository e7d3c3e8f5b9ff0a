"""The compiled entry points, cached on disk; importing this module loads or compiles nothing yet."""

from __future__ import annotations

from numba import njit

from plant.kernels.common import cache, footprint
from plant.kernels.exact import block

with cache.disk_cached():
    advance_block = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(block.advance_block.py_func)
    advance_segmented = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(
        block.advance_segmented.py_func
    )
    cover = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(footprint.cover.py_func)
    any_slow = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(footprint.any_slow.py_func)
