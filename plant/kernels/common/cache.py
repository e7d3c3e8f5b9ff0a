"""Disk cache of the plant's kernels."""

from __future__ import annotations

from bus.kernel_cache.cache import MADE_FOR, RETAINED, TEXTS, cache_of, surroundings

CACHE = cache_of(__name__)
KERNELS, SHIPPED = CACHE.kernels, CACHE.shipped
folder, is_warm, key, mismatch = CACHE.folder, CACHE.is_warm, CACHE.key, CACHE.mismatch

__all__ = [
    "CACHE",
    "KERNELS",
    "MADE_FOR",
    "RETAINED",
    "SHIPPED",
    "TEXTS",
    "folder",
    "is_warm",
    "key",
    "mismatch",
    "surroundings",
]
