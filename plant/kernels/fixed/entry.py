"""The explicit solver's compiled entry point, cached on disk; importing this module compiles nothing yet."""

from __future__ import annotations

from numba import njit

from plant.kernels.common import cache
from plant.kernels.fixed import block as fixed_block

with cache.disk_cached():
    advance_block = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(
        fixed_block.advance_block.py_func
    )
