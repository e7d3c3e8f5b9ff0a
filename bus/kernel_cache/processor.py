"""The processor level that kernels are compiled for: a named one, so that compiled kernels can be passed on.

numba by default compiles for this very processor, and finds what it compiled only on one with the same name and
features. A level of x86-64 is what all processors of its years can do. Kernels have no fused multiply-add and nothing
reordered, so their results don't depend on the level.
"""

from __future__ import annotations

import os
from functools import cache
from typing import Any, cast

LEVELS = {
    "x86-64-v3": (
        "avx",
        "avx2",
        "bmi",
        "bmi2",
        "cx16",
        "f16c",
        "fma",
        "lzcnt",
        "movbe",
        "popcnt",
        "sahf",
        "xsave",
    ),
    "x86-64-v2": ("cx16", "popcnt", "sahf", "sse3", "sse4.1", "sse4.2", "ssse3"),
    "x86-64": ("sse2",),
}
"""Features that a processor of each level has, as LLVM names them, the highest first."""
GENERIC = "generic"
"""Of all other processors: what each of their architecture has."""


@cache
def level() -> tuple[str, str]:
    """Name and features of the level that kernels are compiled for: the highest that this processor has.

    ``NUMBA_CPU_NAME`` and ``NUMBA_CPU_FEATURES`` come first.
    """
    if os.environ.get("NUMBA_CPU_NAME"):
        return os.environ["NUMBA_CPU_NAME"], os.environ.get("NUMBA_CPU_FEATURES", "")
    import llvmlite.binding  # pyright: ignore[reportMissingTypeStubs]  # half of what numba takes to import

    features: dict[str, bool] = cast("Any", llvmlite.binding).get_host_cpu_features()
    return next((name for name, needed in LEVELS.items() if all(map(features.get, needed))), GENERIC), ""


def set_level() -> None:
    """Have numba compile for `level`, unless the environment names a processor.

    numba reads this when a process first compiles: one that has compiled functions of its own before it imports the
    kernels compiles them for its processor too, and caches them apart.
    """
    from numba.core import config as known

    config: Any = known  # its settings have no types
    if not os.environ.get("NUMBA_CPU_NAME"):
        config.CPU_NAME, config.CPU_FEATURES = level()
