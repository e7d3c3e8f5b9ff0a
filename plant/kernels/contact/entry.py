"""Compiled entry points for parcels that touch, cached on disk; importing this module loads or compiles nothing yet."""

from __future__ import annotations

from numba import njit

from plant.kernels.common import cache
from plant.kernels.contact import ccd as meetings
from plant.kernels.contact import impact, polygons
from plant.kernels.contact import manifold as touch
from plant.kernels.contact import resting as pressing

with cache.kept_here():
    gap = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(polygons.gap.py_func)
    first_unsure = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(
        meetings.first_unsure.py_func
    )
    gather = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(touch.gather.py_func)
    meet = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(impact.meet.py_func)
    collide = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(impact.collide.py_func)
    opening = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(impact.opening.py_func)
    together = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(pressing.together.py_func)
    hold = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(pressing.hold.py_func)
