"""How kernels that only other kernels call are compiled."""

from __future__ import annotations

from numba import njit

kernel = njit(error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True, _nrt=False)
"""No fused multiply-add, no reordering (``fastmath`` off): the same bits on every run. No wrappers for calls from
Python: they would double the compiling time. No reference counts (``_nrt``): kernels allocate nothing, and counting
cost a fifth of the time."""
