"""Compiled entry points for parcels that touch, cached on disk; importing this module loads or compiles nothing yet."""

from __future__ import annotations

from numba import njit

from bus.kernel_cache.locator import disk_cached
from plant.kernels.contact import ccd, impact, manifold, polygons, resting

with disk_cached(__name__):
    gap = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(polygons.gap.py_func)
    first_uncertain = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(
        ccd.first_uncertain.py_func
    )
    build_rows = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(manifold.build_rows.py_func)
    meet = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(impact.meet.py_func)
    collide = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(impact.collide.py_func)
    opening = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(impact.opening.py_func)
    together = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(resting.together.py_func)
    hold = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(resting.hold.py_func)
