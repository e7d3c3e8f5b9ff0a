"""Programs of users in scalar form: one compiled step of one cell, held to the same source in Python."""

from __future__ import annotations

import ast
import inspect
import os
import sys
import textwrap
from abc import abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from importlib import import_module
from types import FunctionType, ModuleType
from typing import Any, ClassVar, Final, cast, final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.errors import FirmwareError
from cell_firmware.scalar import ScalarFirmware, ScalarKernels

COMPARED_TICKS: Final = 8
"""Ticks in which the compiled step is compared with the same source in Python."""
_COMPARED_CELLS: Final = 1_000
"""Most cells of a process that are compared in a tick: the first ones."""
PYTHON: Final = "MDMS_PYTHON_STEPS"
"""Environment variable that has steps run as Python: for debuggers, and where nothing can be compiled."""


class FormsDiffer(Exception):
    """A compiled step and the same source in Python came to different results."""

    __module__ = "builtins"  # shown by its name alone


class ScalarProgram(ScalarFirmware):
    """Program of one cell in scalar form: plain numbers in records, compiled for all cells of a process.

    ::

        class Count(ScalarProgram):
            constants_type = np.dtype([("speed_m_s", "<f8")])
            state_type = np.dtype([("ticks", "<i8")])

            def constants(self):
                return {"speed_m_s": 0.1}

            def init(self, cells):
                return {"ticks": np.zeros(len(cells), dtype=np.int64)}

            @staticmethod
            def cell_step(constants, state, inputs, outputs):
                state.ticks += 1
                outputs.speed_m_s[0] = constants.speed_m_s

    ``cell_step`` reads and writes records, see ``cell_firmware.kernels.program``. It may call functions of its own file
    that are decorated with ``scalar_function``, and ``math``. In the first ticks its results are compared with those of
    the same source in Python; a difference is a failure of the cell.

    Attributes:
        constants_type: Type of the record of constants.
        state_type: Type of the record of a cell's state, aligned or packed; truth values are ``u1``.
    """

    constants_type: ClassVar[np.dtype[Any]] = np.dtype([("none", "u1")])
    state_type: ClassVar[np.dtype[Any]]

    @staticmethod
    @abstractmethod
    def cell_step(constants: Any, state: Any, inputs: Any, outputs: Any) -> None:
        """One control period of one cell: changes ``state``, and fills ``outputs``, which are zero before."""

    def __init__(self, parameters: Any) -> None:
        super().__init__(parameters)
        self._compared = 0

    def is_compiled(self) -> bool:
        """Whether steps are compiled: unless the environment variable ``MDMS_PYTHON_STEPS`` is set."""
        return not os.environ.get(PYTHON)

    def scalar_kernels(self) -> ScalarKernels:
        """Return the kernels of the program; compiles, or loads them from disk.

        Raises:
            FirmwareError: The step can't be compiled.
        """
        kind = type(self)
        return _kernels(kind.cell_step, kind.constants_type, kind.state_type, self.message, self.random)

    def run_rows(
        self,
        constants: NDArray[Any],
        records: NDArray[Any],
        given: NDArray[Any],
        done: NDArray[Any],
    ) -> None:
        """Step cells, row by row, compiled or in Python; compare in the first steps.

        Raises:
            FormsDiffer: The two forms came to different results.
        """
        if not self.is_compiled():
            run_in_python(type(self).cell_step, constants, records, given, done)
            return
        if self._compared >= COMPARED_TICKS:
            self.scalar_kernels().rows(constants, records, given, done)
            return
        count = min(len(records), _COMPARED_CELLS)
        checked = records[:count].copy(), given[:count].copy(), done[:count].copy()
        self.scalar_kernels().rows(constants, records, given, done)
        run_in_python(type(self).cell_step, constants, *checked)
        _compare("state", records[:count], checked[0])
        _compare("outputs", done[:count], checked[2])
        self._compared += 1  # not where they differ: then cells are stepped again, to find which


def scalar_function(function: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator of a function that ``cell_step`` calls: compiled with it, and plain Python in Python."""
    setattr(function, _MARK, True)
    return function


_MARK: Final = "_mdms_scalar"


def run_in_python(
    step: Callable[..., None],
    constants: NDArray[Any],
    records: NDArray[Any],
    given: NDArray[Any],
    done: NDArray[Any],
) -> None:
    """Step cells in Python, row by row; see ``cell_firmware.kernels.shard.run_rows``."""
    views = [cast("Any", array).view(np.recarray) for array in (records, given, done)]
    own = cast("Any", constants).view(np.recarray)[0]
    with np.errstate(all="ignore"):  # as compiled code does
        for i in range(len(records)):
            step(own, *(view[i] for view in views))


def _compare(what: str, compiled: NDArray[Any], python: NDArray[Any]) -> None:
    for path, ours, theirs in _fields(what, compiled, python):
        same = ours == theirs
        if ours.dtype.kind == "f":
            same |= np.isnan(ours) & np.isnan(theirs)
        if not same.all():
            at = tuple(int(i) for i in np.argwhere(~same)[0])
            index = "".join(f"[{i}]" for i in at[1:])
            raise FormsDiffer(
                f"{path}{index} is {ours[at]} compiled, and {theirs[at]} in Python: numbers that "
                "overflow, float32 and division differ between the two forms; write what you mean"
            )


def _fields(what: str, a: NDArray[Any], b: NDArray[Any]) -> Iterator[tuple[str, NDArray[Any], NDArray[Any]]]:
    """Yield the plain fields of two arrays of records."""
    if a.dtype.names is None:
        yield what, a, b
        return
    for name in a.dtype.names:
        yield from _fields(f"{what}.{name}", a[name], b[name])


# --- compiling ------------------------------------------------------------------------------------


@final
@dataclass(frozen=True)
class _Kernels:
    """Kernels of a program; see ``ScalarKernels``."""

    PARAMETERS: np.dtype[Any]
    STATE: np.dtype[Any]
    MESSAGE: np.dtype[Any]
    tick: Any
    rows: Any
    compared_ticks: int = COMPARED_TICKS


@cache
def _kernels(
    step: Callable[..., None],
    constants: np.dtype[Any],
    state: np.dtype[Any],
    message: np.dtype[Any] | None,
    random: tuple[str, ...],
) -> ScalarKernels:
    from cell_firmware.kernels.program import NO_MESSAGE
    from cell_firmware.kernels.shard import compiled_program

    compiled = cast("Callable[..., Any]", import_module("cell_firmware.kernels.jit").kernel)
    sent = NO_MESSAGE if message is None else message
    text = _text(step)
    kinds = (constants.descr, state.descr, sent.descr, random)
    key = sha256("\0".join((text, *map(str, kinds))).encode())
    # a module of the package of kernels, whose cache on disk it shares
    module = ModuleType(f"cell_firmware.kernels.users.p{key.hexdigest()[:16]}")
    sys.modules[module.__name__] = module
    names = {name: value for name, value in _globals(step).items() if not isinstance(value, FunctionType)}
    for name, function in _helpers(step).items():
        names[name] = compiled(_copy(function, module.__name__, names))
    try:
        tick, rows = compiled_program(
            module.__name__, compiled(_copy(step, module.__name__, names)), constants, state, sent, random
        )
    except Exception as error:  # noqa: BLE001 - a compiler's errors are of many types
        raise FirmwareError(
            f"{step.__qualname__} can't be compiled: {_said(error)}; to run it as Python, set {PYTHON}=1"
        ) from None
    return cast("ScalarKernels", _Kernels(constants, state, sent, tick, rows))


def _copy(function: Callable[..., Any], module: str, names: dict[str, Any]) -> Callable[..., Any]:
    """Return a function as one of another module, with globals of its own."""
    plain = cast("FunctionType", function)
    made = FunctionType(plain.__code__, names, plain.__name__, plain.__defaults__)
    made.__module__, made.__qualname__ = module, f"{module.rpartition('.')[2]}.{plain.__name__}"
    return made


def _globals(function: Callable[..., Any]) -> dict[str, Any]:
    return dict(cast("FunctionType", function).__globals__)


def _helpers(step: Callable[..., Any]) -> dict[str, FunctionType]:
    """Return the functions that a step calls, by name, called ones first.

    Raises:
        FirmwareError: The step, or one of them, calls another Python function.
    """
    found: dict[str, FunctionType] = {}

    def visit(function: FunctionType) -> None:
        for name in function.__code__.co_names:
            value = function.__globals__.get(name)
            if not isinstance(value, FunctionType) or name in found:
                continue
            if (
                not getattr(value, _MARK, False)
                or value.__code__.co_filename != function.__code__.co_filename
            ):
                raise FirmwareError(
                    f"{step.__qualname__} calls {name}: it may call functions of its own file that are decorated with "
                    "scalar_function"
                )
            visit(value)
            found[name] = value

    visit(cast("FunctionType", step))
    return found


def _text(step: Callable[..., Any]) -> str:
    """Return the source of a step and of its helpers, and the file's constants that occur in them."""
    functions = [cast("FunctionType", step), *_helpers(step).values()]
    used = {name for function in functions for name in function.__code__.co_names}
    constants: dict[str, str] = {
        name: repr(cast("object", value))
        for name, value in sorted(_globals(step).items())
        if name in used and isinstance(value, (int, float, str, bool, tuple, np.generic))
    }
    try:
        sources = [
            ast.dump(ast.parse(textwrap.dedent(inspect.getsource(function)))) for function in functions
        ]
    except (OSError, TypeError, SyntaxError):
        raise FirmwareError(f"{step.__qualname__} can't be compiled: its source is not in a file") from None
    return "\0".join((*sources, repr(constants)))


def _said(error: Exception) -> str:
    """Return the lines of numba's message that say what is wrong and where."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    telling = [
        line for line in lines if not line.startswith(("-", "Failed in", "During:", "There are", "-", "*"))
    ]
    return f"{type(error).__name__}: {'; '.join(telling[:4])}"
