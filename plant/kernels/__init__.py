"""Compiled kernels of the event-driven solver.

Plain functions on arrays, compiled by numba. They hold no state of their own: what a kernel reads and writes is
laid out in ``plant.kernels.common.layout``. Only the entry points of ``plant.kernels.exact.entry`` are cached on
disk; see ``plant.kernels.common.cache`` for why that cache can't be stale.
"""
