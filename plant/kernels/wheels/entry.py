"""The compiled entry points for motors: compiled, or loaded from disk, when this is imported."""

from __future__ import annotations

from numba import njit, types

from bus.kernel_cache.locator import disk_cached
from plant.kernels.wheels import motors

REAL = types.float64
LAW = types.Array(REAL, 1, "C", readonly=True)
CELLS = types.Array(REAL, 1, "C", readonly=True)
READ = types.Array(REAL, 2, "C", readonly=True)
VECTOR = types.Array(REAL, 1, "C", readonly=True)
OUT = types.Array(REAL, 1, "C")
FILLED = types.Array(REAL, 2, "C")
ROWS = types.Array(REAL, 3, "C", readonly=True)
FILLED_ROWS = types.Array(REAL, 3, "C")

with disk_cached(__name__):
    options = {"cache": True, "nogil": True, "error_model": "numpy", "_nrt": False}
    limited = njit((READ, REAL, FILLED), **options)(motors.limited.py_func)
    delayed = njit((READ, READ, CELLS, FILLED, FILLED), **options)(motors.delayed.py_func)
    set_off = njit((READ, READ, LAW, FILLED, FILLED, FILLED), **options)(motors.set_off.py_func)
    stand = njit((READ, LAW, FILLED, FILLED), **options)(motors.stand.py_func)
    go_over = njit(
        (READ, READ, READ, READ, REAL, LAW, REAL, FILLED, FILLED, FILLED_ROWS, FILLED_ROWS, FILLED_ROWS),
        **options,
    )(motors.go_over.py_func)
    pass_changes = njit((READ, READ, REAL, ROWS, ROWS, ROWS, CELLS, REAL, FILLED, FILLED, FILLED), **options)(
        motors.pass_changes.py_func
    )
    exp_of_each = njit((VECTOR, OUT), **options)(motors.exp_of_each.py_func)
    elapse = njit((READ, READ, READ, REAL, REAL, REAL, FILLED, FILLED), **options)(motors.elapse.py_func)
