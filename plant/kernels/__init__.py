"""Compiled kernels of the event-driven solver.

Plain functions on arrays, compiled by numba. They hold no state of their own: what a kernel reads and writes is
laid out in ``plant.kernels.layout``. Only the entry points of ``plant.kernels.entry`` are cached on disk; see
``plant.kernels.cache`` for why that cache can't be stale.
"""
