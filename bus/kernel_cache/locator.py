"""Entry points' places in the cache, for numba."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

from llvmlite import binding as _llvm  # pyright: ignore[reportMissingTypeStubs]
from numba.core import caching as _caching
from numba.core import config as _config
from numba.core import dispatcher as _dispatcher
from numba.core import runtime as _runtime

from bus.kernel_cache.cache import cache_of

config: Any = _config  # numba's settings have no types
caching: Any = _caching
dispatcher: Any = _dispatcher
llvm: Any = _llvm
runtime: Any = _runtime


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


class KernelFunctionCache(caching.FunctionCache):
    """Cache of an entry point that loads machine code without what only compiling needs.

    Before numba looks for anything, it imports the types and functions that it can compile, and SciPy's linear algebra
    with them. That takes three times as long as loading the kernels of a run.
    """

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled function of a signature; None if it has to be compiled."""
        _add_runtime_symbols()
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled function for later runs, unless the disk is full: this run has it all the same."""
        try:
            super().save_overload(sig, data)  # pyright: ignore[reportUnknownMemberType] - numba has no types
        except OSError as error:
            folder = Path(self.cache_path).parents[1]
            warnings.warn(
                f"compiled kernels can't be kept in {folder}: {error.strerror}", RuntimeWarning, stacklevel=1
            )


def _add_runtime_symbols() -> None:
    """Tell LLVM of the functions of numba's runtime that machine code calls, as compiling does."""
    helpers: dict[str, int] = runtime._nrt_python.c_helpers  # noqa: SLF001 - numba lists them nowhere else
    for name, address in helpers.items():
        llvm.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)


@contextlib.contextmanager
def disk_cached(module: str) -> Generator[None]:
    """Functions of a module that are compiled with ``cache=True`` inside this block are kept in its package's cache.

    Versions of numba without locators of others' keep them there too, by the place and the time of their files: they
    find nothing that came with a wheel.

    A kernel that is in the cache is loaded by `KernelFunctionCache`. One that is not is compiled as ever: numba imports
    what it needs for that when it begins.
    """
    setting, value = "CACHE_LOCATOR_CLASSES", f"{__name__}.{KernelLocator.__name__}"
    if not hasattr(config, setting):
        setting, value = "CACHE_DIR", str(cache_of(module).folder()[0])
    changes: list[tuple[Any, str, Any]] = [(config, setting, value)]
    if hasattr(caching.FunctionCache, "_load_overload"):  # else this numba loads in another way
        changes.append((dispatcher, "FunctionCache", KernelFunctionCache))
    before = [(place, name, getattr(place, name)) for place, name, _ in changes]
    for place, name, value in changes:
        setattr(place, name, value)
    try:
        yield
    finally:
        for place, name, value in before:
            setattr(place, name, value)
