"""The compiled entry points, cached on disk; importing this module loads or compiles nothing yet."""

from __future__ import annotations

from numba import njit

from plant.kernels import advance as _advance
from plant.kernels import cache, footprint

with cache.kept_here():
    advance = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(_advance.advance.py_func)
    cover = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(footprint.cover.py_func)
