"""The implicit solver's compiled entry point, cached on disk; importing this module loads or compiles nothing yet."""

from __future__ import annotations

from numba import njit

from plant.kernels.common import cache
from plant.kernels.implicit import block as implicit_block

with cache.disk_cached():
    advance_block = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(
        implicit_block.advance_block.py_func
    )
