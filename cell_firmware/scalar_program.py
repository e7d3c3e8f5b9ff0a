"""Programs of users in scalar form: one compiled step of one cell, held to the same source in Python."""

from __future__ import annotations

import ast
import inspect
import os
import sys
import textwrap
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from importlib import import_module
from types import FunctionType, ModuleType
from typing import Any, ClassVar, Final, cast, final

import numpy as np
from numpy.typing import NDArray

from bus.wire.message_type import leaves
from cell_firmware.errors import FirmwareError
from cell_firmware.scalar import ScalarFirmware, ScalarKernels
from cell_firmware.scalar_checks import compile_problem, source_problems

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

    ``cell_step`` reads and writes records, see ``cell_firmware.kernels.program``. It may call functions that are
    decorated with ``scalar_function``, those of ``mdms.kit`` among them, and ``math``. In the first ticks its results
    are compared with those of the same source in Python; a difference is a failure of the cell.

    Attributes:
        constants_type: Type of the record of constants.
        state_type: Type of the record of a cell's state, aligned or packed; truth values are ``u1``.
        compared_ticks: Ticks in which the compiled step is compared with the same source in Python.
        is_brief: Whether a step always returns soon.
    """

    compared_ticks: ClassVar[int] = COMPARED_TICKS
    is_brief: ClassVar[bool] = False  # a program may loop
    constants_type: ClassVar[np.dtype[Any]] = np.dtype([("none", "u1")])
    state_type: ClassVar[np.dtype[Any]]

    @staticmethod
    @abstractmethod
    def cell_step(constants: Any, state: Any, inputs: Any, outputs: Any) -> None:
        """One control period of one cell: changes ``state``, and fills ``outputs``, which are zero before."""

    def __init__(self, parameters: Any) -> None:
        super().__init__(parameters)
        self._compared = 0

    def step_function(self) -> Callable[[Any, Any, Any, Any], None]:
        """Return the step: ``cell_step``, or another function for some parameters."""
        return type(self).cell_step

    def is_compiled(self) -> bool:
        """Whether steps are compiled: unless the environment variable ``MDMS_PYTHON_STEPS`` is set."""
        return not os.environ.get(PYTHON)

    def scalar_kernels(self) -> ScalarKernels:
        """Return the kernels of the program; compiles, or loads them from disk. Steps in Python need the types alone.

        Raises:
            FirmwareError: The step can't be compiled.
        """
        kind = type(self)
        _check(self.step_function(), kind.constants_type, kind.state_type, self.message, self.random)
        if not self.is_compiled():
            return _in_python(kind.constants_type, kind.state_type, self.message)
        return _kernels(
            self.step_function(),
            kind.constants_type,
            kind.state_type,
            self.message,
            self.random,
            kind.compared_ticks,
        )

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
            run_in_python(self.step_function(), constants, records, given, done)
            return
        if self._compared >= self.compared_ticks:
            self.run_compiled(constants, records, given, done)
            return
        count = min(len(records), _COMPARED_CELLS)
        checked = records[:count].copy(), given[:count].copy(), done[:count].copy()
        self.run_compiled(constants, records, given, done)
        run_in_python(self.step_function(), constants, *checked)
        _compare("state", records[:count], checked[0])
        message = self.scalar_kernels().MESSAGE
        _compare("outputs", *(_narrowed(outputs, message) for outputs in (done[:count], checked[2])))
        self._compared += 1  # not where they differ: then cells are stepped again, to find which


def scalar_function(function: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator of a function that ``cell_step`` calls, in any file: compiled with it, and plain Python in Python."""
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
    """Step cells in Python, row by row; see ``ScalarFirmware.run_rows``."""
    views = [_as_fields(array) for array in (records, given, done)]
    own = _as_fields(constants)[0]
    with np.errstate(all="ignore"):  # as compiled code does
        for i in range(len(records)):
            step(own, *(view[i] for view in views))


class FieldsRecord(np.record):  # pyright: ignore[reportIncompatibleVariableOverride] - NumPy says where its record is from
    """Record whose fields come before what NumPy's records have: a field may be called ``sum``, ``max`` or ``size``."""

    def __getattribute__(self, name: str) -> Any:
        if name not in (np.void.__getattribute__(self, "dtype").names or ()):
            return super().__getattribute__(name)
        field = cast("Any", self)[name]
        return field if getattr(field, "dtype", np.dtype("b")).names is None else _as_fields(field)


def _as_fields(records: Any) -> Any:
    """Return records, or an array of them, as ``FieldsRecord``."""
    return records.view(np.dtype((FieldsRecord, records.dtype)))


def _narrowed(outputs: NDArray[Any], message: np.dtype[Any]) -> NDArray[Any]:
    """Return outputs in whose drafts of messages floats are rounded to their fields' width."""
    found = outputs.copy()
    with np.errstate(all="ignore"):
        for leaf in leaves(message):
            if leaf.type.kind == "f":
                drafts = leaf.of(found["message"])
                drafts[...] = drafts.astype(leaf.type)
    return found


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
                "overflow, float32, division and NumPy's generators differ between the two forms; write what you mean"
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
    compared_ticks: int


@cache
def _check(
    step: Callable[..., None],
    constants: np.dtype[Any],
    state: np.dtype[Any],
    message: np.dtype[Any] | None,
    random: tuple[str, ...],
) -> None:
    """Refuse a step with mistakes in its source."""
    from cell_firmware.kernels.program import NO_MESSAGE, inputs_type, outputs_type

    sent = NO_MESSAGE if message is None else message
    records = (constants, state, inputs_type(sent, random), outputs_type(sent, compiled=False))
    if problems := source_problems(step, records):
        raise FirmwareError(f"{step.__qualname__}: {'; '.join(problems)}")


def _in_python(
    constants: np.dtype[Any], state: np.dtype[Any], message: np.dtype[Any] | None
) -> ScalarKernels:
    from cell_firmware.kernels.program import NO_MESSAGE

    sent = NO_MESSAGE if message is None else message
    return cast("ScalarKernels", _Kernels(constants, state, sent, None, None, compared_ticks=0))


@cache
def _kernels(
    step: Callable[..., None],
    constants: np.dtype[Any],
    state: np.dtype[Any],
    message: np.dtype[Any] | None,
    random: tuple[str, ...],
    compared_ticks: int,
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
    made: dict[FunctionType, Any] = {}
    for function in _helpers(step):
        made[function] = compiled(_copy(function, module.__name__, made))
    try:
        tick, rows = compiled_program(
            module.__name__, compiled(_copy(step, module.__name__, made)), constants, state, sent, random
        )
    except Exception as error:  # noqa: BLE001 - a compiler's errors are of many types
        raise FirmwareError(
            f"{step.__qualname__} can't be compiled: {compile_problem(error)}; to run it as Python, set {PYTHON}=1"
        ) from None
    return cast("ScalarKernels", _Kernels(constants, state, sent, tick, rows, compared_ticks))


def _copy(function: Callable[..., Any], module: str, made: Mapping[FunctionType, Any]) -> Any:
    """Return a function as one of another module, with globals of its own.

    Args:
        function: The function.
        module: Name of the module.
        made: Compiled functions, by the functions that they replace.
    """
    plain = cast("FunctionType", function)
    names: dict[str, Any] = {
        name: made.get(value) if isinstance(value, FunctionType) else value
        for name, value in plain.__globals__.items()
    }
    copy = FunctionType(plain.__code__, names, plain.__name__, plain.__defaults__)
    copy.__module__ = module
    # functions of two files may have one name
    place = plain.__module__.replace(".", "_")
    copy.__qualname__ = f"{module.rpartition('.')[2]}.{place}.{plain.__name__}"
    return copy


def _helpers(step: Callable[..., Any]) -> tuple[FunctionType, ...]:
    """Return the functions that a step calls, called ones first.

    Raises:
        FirmwareError: The step, or one of them, calls another Python function.
    """
    found: dict[FunctionType, None] = {}

    def visit(function: FunctionType) -> None:
        for name in function.__code__.co_names:
            value = function.__globals__.get(name)
            if not isinstance(value, FunctionType) or value in found:
                continue
            if not getattr(value, _MARK, False):
                raise FirmwareError(
                    f"{step.__qualname__} calls {name}: it may call functions that are decorated with scalar_function"
                )
            visit(value)
            found[value] = None

    visit(cast("FunctionType", step))
    return tuple(found)


def _text(step: Callable[..., Any]) -> str:
    """Return the source of a step and its helpers, and the constants of their files that occur in the source."""
    texts: list[str] = []
    for function in (cast("FunctionType", step), *_helpers(step)):
        constants: dict[str, str] = {
            name: repr(cast("object", value))
            for name, value in sorted(function.__globals__.items())
            if name in function.__code__.co_names
            and isinstance(value, (int, float, str, bool, tuple, np.generic))
        }
        try:
            source = ast.dump(ast.parse(textwrap.dedent(inspect.getsource(function))))
        except (OSError, TypeError, SyntaxError):
            raise FirmwareError(
                f"{step.__qualname__} can't be compiled: its source is not in a file"
            ) from None
        texts += [source, repr(constants)]
    return "\0".join(texts)
