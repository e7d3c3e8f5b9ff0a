"""The implicit solver's compiled entry point, cached on disk; importing this module loads or compiles nothing yet."""

from __future__ import annotations

from numba import njit

from plant.kernels import cache
from plant.kernels import implicit_advance as _advance

with cache.kept_here():
    implicit_advance = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(_advance.advance.py_func)
