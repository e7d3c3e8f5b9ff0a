"""The quasi-static solver's compiled entry point, cached on disk; importing this module compiles nothing yet."""

from __future__ import annotations

from numba import njit

from plant.kernels.common import cache
from plant.kernels.quasi import block as quasi_block

with cache.disk_cached():
    advance_block = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(
        quasi_block.advance_block.py_func
    )
