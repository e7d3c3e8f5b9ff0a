"""The compiled entry point for analogue sensors, cached on disk; importing this loads or compiles nothing yet."""

from __future__ import annotations

from numba import njit

from bus.kernel_cache.locator import disk_cached
from plant.kernels.effects import spots

with disk_cached(__name__):
    cover_spots = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(spots.cover_spots.py_func)
