"""The compiled entry point for analogue sensors, cached on disk; importing this loads or compiles nothing yet."""

from __future__ import annotations

from numba import njit

from plant.kernels.common import cache
from plant.kernels.effects import spots

with cache.disk_cached():
    cover_spots = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(spots.cover_spots.py_func)
