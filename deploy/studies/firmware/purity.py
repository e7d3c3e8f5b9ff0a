"""Impurities of a program: calls of clocks and generators, and values outside the state that a step changes."""

from __future__ import annotations

import random
import sys
from collections.abc import Generator, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from types import BuiltinFunctionType, FrameType, FunctionType, ModuleType
from typing import Any, Final, cast

import numpy as np

from cell_firmware.firmware_files import modules_beside

_CLOCKS: Final = frozenset(
    ("time", "time_ns", "monotonic", "monotonic_ns", "perf_counter", "perf_counter_ns", "process_time")
)
_DEPTH: Final = 6
"""Depth to which values are looked at."""


def impure_call(function: Any) -> str | None:
    """Return what a built-in function does that no step may do, in words; None if it is harmless."""
    name, module = getattr(function, "__name__", ""), getattr(function, "__module__", None)
    owner = getattr(function, "__self__", None)
    if module == "time" and (name in _CLOCKS or name in ("sleep", "localtime", "gmtime")):
        return f"calls time.{name}"
    if name in ("now", "utcnow", "today") and isinstance(owner, type) and owner.__module__ == "datetime":
        return f"calls datetime.{owner.__name__}.{name}"
    if isinstance(owner, random.Random) or (module == "random"):
        return f"draws by random.{name}"
    if name in ("urandom", "getrandom") and module in ("posix", "nt", "os"):
        return "draws from the operating system"
    if name in ("getpid", "getppid") and module in ("posix", "nt", "os"):
        return f"calls os.{name}"
    if name == "open" and module in ("io", "_io", "posix"):
        return "opens a file"
    return None


@contextmanager
def watching_calls(found: dict[str, str]) -> Generator[None]:
    """Note impure calls that are made in the context, in this thread.

    Args:
        found: By what is done, the file and line; is filled.
    """

    def profile(frame: FrameType, event: str, function: Any) -> None:
        if event == "c_call" and isinstance(function, BuiltinFunctionType):
            what = impure_call(function)
            if what is not None and what not in found:
                found[what] = f"{frame.f_code.co_filename.rpartition('/')[2]}:{frame.f_lineno}"

    before = sys.getprofile()
    sys.setprofile(profile)
    try:
        yield
    finally:
        sys.setprofile(before)


def outside_values(program: Any) -> dict[str, object]:
    """Return fingerprints of everything that a program can change beside its state, by name.

    These are attributes of the program and of its class, globals of its file and of modules beside the file, defaults
    of functions, and the states of the global generators.
    """
    kind = cast("type[Any]", type(program))
    modules = {kind.__module__: sys.modules[kind.__module__]}
    modules |= {module.__name__: module for module in modules_beside(kind.__module__)}
    found: dict[str, object] = {}
    own = cast("dict[str, Any]", vars(program))
    for name, value in own.items():
        if name not in ("step", "parameters", "_compared") and not callable(value):
            found[f"self.{name}"] = _print(value)
    for module in modules.values():
        found |= dict(_of_module(module))
    found["the state of random's generator"] = hash(random.getstate())
    found["the state of numpy.random's generator"] = repr(np.random.get_state())  # noqa: NPY002 - looked at, not drawn from
    return found


def _of_module(module: ModuleType) -> Iterator[tuple[str, object]]:
    own = module.__name__.rpartition(".")[2]
    for name, value in list(vars(module).items()):
        if name.startswith("__"):
            continue
        if isinstance(value, type):
            if value.__module__ == module.__name__:
                for attribute, inner in list(vars(value).items()):
                    plain: Any = getattr(inner, "__func__", inner)  # of static methods, class methods
                    if isinstance(plain, FunctionType):
                        yield from _of_function(f"{name}.{attribute}", plain)
                    elif not attribute.startswith("__") and not attribute.startswith("_abc"):
                        yield f"{name}.{attribute}", _print(inner)
        elif isinstance(value, FunctionType):
            yield from _of_function(name, value)
        elif not isinstance(value, ModuleType):
            yield f"{name} of {own}", _print(value)


def _of_function(name: str, function: FunctionType) -> Iterator[tuple[str, object]]:
    yield f"a default argument of {name}", _print(function.__defaults__)
    cells = tuple(cell.cell_contents for cell in function.__closure__ or () if _is_filled(cell))
    if cells and not any(isinstance(value, type) for value in cells):
        yield f"a variable around {name}", _print(cells)


def _is_filled(cell: Any) -> bool:
    try:
        _ = cell.cell_contents
    except ValueError:
        return False
    return True


def _print(value: Any, depth: int = 0) -> object:
    """Return a value that changes if ``value`` does, without addresses."""
    kind = cast("type[Any]", type(value))
    if value is None or issubclass(kind, bool | int | float | complex | str | bytes | np.generic | np.dtype):
        return (kind.__name__, repr(value))
    if issubclass(kind, np.ndarray):
        items = (
            [_print(item, depth + 1) for item in value.ravel()] if value.dtype == object else value.tobytes()
        )
        return (str(value.dtype), value.shape, items)
    if issubclass(kind, np.random.Generator):
        return repr(value.bit_generator.state)
    if issubclass(kind, random.Random):
        return hash(value.getstate())
    if depth >= _DEPTH or issubclass(kind, type | ModuleType | FunctionType):
        return kind.__name__
    if issubclass(kind, Mapping):
        return (kind.__name__, [(repr(key), _print(inner, depth + 1)) for key, inner in value.items()])
    if issubclass(kind, list | tuple | set | frozenset):
        return (kind.__name__, [_print(inner, depth + 1) for inner in value])
    if kind.__module__ == "itertools":
        return repr(value)
    if is_dataclass(value):
        return (kind.__name__, [_print(getattr(value, one.name), depth + 1) for one in fields(value)])
    return (kind.__name__, _print(dict(getattr(value, "__dict__", {})), depth + 1))


def changed(
    before: Mapping[str, object], middle: Mapping[str, object], after: Mapping[str, object]
) -> list[str]:
    """Return the names of values that steps change; what is made once and stays, as a cache does, is none.

    Args:
        before: Values before the first step.
        middle: Values after some steps.
        after: Values after some more.
    """
    return [
        name
        for name, value in after.items()
        if middle.get(name) != value or (name in before and before[name] != value)
    ]


def same(a: Any, b: Any) -> bool:
    """Whether two values are equal: arrays by their bytes, NaN as itself."""
    return _print(a) == _print(b)
