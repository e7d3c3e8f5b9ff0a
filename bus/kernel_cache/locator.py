"""Entry points' places in the cache, for numba."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator
from typing import Any

from numba.core import caching as _caching
from numba.core import config as _config

from bus.kernel_cache.cache import cache_of

config: Any = _config  # numba's settings have no types
caching: Any = _caching


class KernelLocator(caching._CacheLocator):  # noqa: SLF001 - numba names it as what its setting takes
    """Place of an entry point's files, for numba: under its name in `folder`, whose name has the hash of all inputs.

    Args:
        function: the entry point's.
        file: its module's.
    """

    def __init__(self, function: Callable[..., Any], file: str) -> None:
        self._py_file = file  # named in a warning of numba's
        self._cache = cache_of(function.__module__)
        self._package = function.__module__.partition(".kernels.")[2].rpartition(".")[0] or "entry"

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> KernelLocator:
        """Return the locator of a function."""
        return cls(py_func, py_file)

    def get_cache_path(self) -> str:
        """Return the folder of a function's files."""
        return str(self._cache.folder()[0] / self._package)

    def get_source_stamp(self) -> str:
        """Return what changes as the source does: nothing, for the folder does."""
        return ""

    def get_disambiguator(self) -> str:
        """Return what tells functions of a name and a module's name apart: no package has two."""
        return "entry"


@contextlib.contextmanager
def disk_cached(module: str) -> Generator[None]:
    """Functions of a module that are compiled with ``cache=True`` inside this block are kept in its package's cache.

    Versions of numba without locators of others' keep them there too, by the place and the time of their files: they
    find nothing that came with a wheel.
    """
    setting, value = "CACHE_LOCATOR_CLASSES", f"{__name__}.{KernelLocator.__name__}"
    if not hasattr(config, setting):
        setting, value = "CACHE_DIR", str(cache_of(module).folder()[0])
    before = getattr(config, setting)
    setattr(config, setting, value)
    try:
        yield
    finally:
        setattr(config, setting, before)
