"""The compiled entry points for motors, cached on disk; importing this loads or compiles nothing yet."""

from __future__ import annotations

from numba import njit

from bus.kernel_cache.locator import disk_cached
from plant.kernels.wheels import motors

with disk_cached(__name__):
    limited = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(motors.limited.py_func)
    delayed = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(motors.delayed.py_func)
    set_off = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(motors.set_off.py_func)
    stand = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(motors.stand.py_func)
    elapse = njit(cache=True, nogil=True, error_model="numpy", _nrt=False)(motors.elapse.py_func)
