"""Loader of a scene's firmware: bundled names, importable classes and files."""

from __future__ import annotations

import difflib
import importlib
import inspect
import pkgutil
import traceback
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, cast, get_args

import numpy as np
from pydantic import BaseModel, ValidationError

from bus.errors import WireError
from bus.wire.message_type import check_message
from cell_firmware import firmware_files, protocols
from cell_firmware.cell import Cell, CellFirmware, CellInputs, PerCellAdapter
from cell_firmware.errors import FirmwareError, ParametersError, Problem
from cell_firmware.firmware import Firmware
from cell_firmware.firmware_files import import_file
from cell_firmware.hooks import guard, refusals
from cell_firmware.scalar import constants_problem
from cell_firmware.scalar_program import ScalarProgram
from cell_firmware.specs import CellsSpec


def problems(error: ValidationError, model: type[BaseModel], given: Any) -> tuple[Problem, ...]:
    """Every complaint, with paths as written in the scene.

    Args:
        error: What pydantic raised.
        model: What it validated against.
        given: What it validated.
    """
    return tuple(_problem(detail, model, given) for detail in error.errors(include_url=False))


def _problem(detail: Any, model: type[BaseModel], given: Any) -> Problem:
    location: tuple[str | int, ...] = detail["loc"]
    path = _without_tags(location, given)
    if detail["type"] == "extra_forbidden":
        known = sorted({name for found in _models_at(location[:-1], model) for name in found.model_fields})
        nearest = difflib.get_close_matches(str(location[-1]), known, n=1)
        hint = f"; did you mean {nearest[0]}? Known: " if nearest else "; known: "
        return Problem(path, f"unknown key{hint}{', '.join(known) or 'none'}", detail["input"])
    message = detail["msg"].removeprefix("Value error, ").replace("Input should be", "must be")
    if detail["type"] == "missing":
        return Problem(path, "is required")
    value = detail["input"]
    if detail["type"] != "value_error" and not isinstance(value, Mapping | list | tuple):
        message += f", not {value!r}"
    return Problem(path, message, value)


def _without_tags(location: Sequence[str | int], given: Any) -> tuple[str | int, ...]:
    """Return the location without the tags of discriminated unions, which are not part of the scene."""
    path: list[str | int] = []
    here = given
    for i, part in enumerate(location):
        try:
            here = here[part]
        except (LookupError, TypeError):
            if i < len(location) - 1:
                continue
        path.append(part)
    return tuple(path)


def _models_at(location: Sequence[str | int], model: type[BaseModel]) -> list[type[BaseModel]]:
    """The models that may stand at a location: one, or the members of a union."""
    models = [model]
    for part in location:
        if isinstance(part, int):
            continue
        fields = [found.model_fields[part] for found in models if part in found.model_fields]
        if fields:
            models = [inner for field in fields for inner in _models_in(field.annotation)]
        else:  # the tag of a union
            models = [found for found in models if part in _tags(found)]
    return models


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from _models_in(inner)


def _tags(model: type[BaseModel]) -> tuple[Any, ...]:
    return tuple(tag for field in model.model_fields.values() for tag in get_args(field.annotation))


BUNDLED = {
    module.name: f"{protocols.__name__}.{module.name}:{module.name.title().replace('_', '')}"
    for module in pkgutil.iter_modules(protocols.__path__)
}
"""Bundled firmware by name: a new one is a file of that name, with a class of that name."""

FirmwareClass = type[Firmware] | type[CellFirmware]

_GIVEN: dict[str, FirmwareClass] = {}
"""Classes that were given as objects, by the name that scenes have for them."""


def name_of(firmware: object) -> str:
    """Name by which a scene can have a firmware class, or a function in the place of one.

    Worker processes import the module of that name. A class of the main program or of a notebook runs in this process
    alone.

    Args:
        firmware: A class; or a function of a cell's state and its inputs that returns the next state and the outputs,
            whose first state is None.

    Raises:
        FirmwareError: It is neither.
    """
    found = firmware if isinstance(firmware, type) else _class_of(firmware)
    if not issubclass(found, Firmware | CellFirmware):
        raise FirmwareError(f"firmware {found.__qualname__}: must derive from Firmware or CellFirmware")
    name = f"{found.__module__}:{found.__qualname__}"
    _GIVEN[name] = found
    return name


def check_importable(name: str) -> None:
    """Check that another process finds the firmware of a scene by its name.

    Raises:
        FirmwareError: The firmware was given as an object of the main program, of a notebook, or of a function.
    """
    if name in _GIVEN and (name.startswith("__main__:") or "<locals>" in name):
        raise FirmwareError(
            f"firmware {name}: worker processes can't import it: define it at the top of a module of its own, "
            "or run the cells in this process: InProcess()"
        )


def _class_of(step: Any) -> type:
    """Class of cells whose program is one function."""
    if not callable(step):
        raise FirmwareError(f"firmware {step!r}: must be a name, a class or a function")

    def init(self: CellFirmware, cell: Cell) -> None:
        del self, cell

    def run(self: CellFirmware, state: Any, inputs: CellInputs) -> Any:
        del self
        return step(state, inputs)

    name = getattr(step, "__name__", "firmware")
    module = getattr(step, "__module__", "__main__")
    return type(name, (CellFirmware,), {"__module__": module, "init": init, "step": run})


def load(spec: CellsSpec, folder: Path | None = None) -> Firmware:
    """Load the firmware of a scene, with its parameters and guarded hooks; see `cell_firmware.hooks`.

    Args:
        spec: The scene's settings of cells.
        folder: Where relative paths to ``.py`` files start; default: the working directory.

    Raises:
        ParametersError: The firmware refuses its parameters; all problems at once.
        FirmwareError: There is no such firmware, its file can't be loaded, or its step can't be compiled.
    """
    found = find(spec.firmware, folder)
    with refusals(spec.firmware, "Parameters"):
        try:
            own = found.Parameters.model_config.get("extra")  # else pydantic would ignore what is misspelt
            parameters = found.Parameters.model_validate(spec.parameters, extra=own or "forbid")
        except ValidationError as error:
            raise ParametersError(spec.firmware, problems(error, found.Parameters, spec.parameters)) from None
    with refusals(spec.firmware, "__init__()"):
        firmware = found(parameters)
    program = PerCellAdapter(firmware) if isinstance(firmware, CellFirmware) else firmware
    if isinstance(program, ScalarProgram) and program.is_compiled() and spec.firmware not in BUNDLED:
        program.scalar_kernels()  # before anything starts: a step that can't be compiled is bad input
    if isinstance(program, ScalarProgram):
        _check_constants(program, spec.firmware)
    guard(program, spec.firmware)
    if spec.initial_registers:
        from cell_firmware.program_variables import set_initial

        set_initial(program, spec.initial_registers)
    return program


def _check_constants(program: ScalarProgram, name: str) -> None:
    """Refuse constants that are no record of their type: the step would read zeros, or numbers that were cut."""
    with refusals(name, "constants()"):
        constants = program.constants()
    kind = program.constants_type
    if constants == {} and kind == ScalarProgram.constants_type:
        return
    if problem := constants_problem(kind, constants):
        raise FirmwareError(f"firmware {name!r}: constants() {problem}")


def find(name: str, folder: Path | None = None) -> FirmwareClass:
    """The class that a name stands for.

    Args:
        name: A bundled name, ``package.module:Class``, or a path to a ``.py`` file, ``:Class`` optional.
        folder: Where relative paths start; default: the working directory.

    Raises:
        FirmwareError: There is none.
    """
    if name in _GIVEN:
        return _GIVEN[name]
    place, _, class_name = BUNDLED.get(name, name).partition(":")
    if place.endswith(".py"):
        module = _from_file(name, (folder or Path.cwd()) / place)
        found = getattr(module, class_name, None) if class_name else _only_firmware(name, module)
    elif class_name:
        module = _imported(name, place)
        found = getattr(module, class_name, None)
    else:
        nearest = difflib.get_close_matches(name, BUNDLED, n=1)
        hint = f"; did you mean {nearest[0]!r}? Known: " if nearest else "; known: "
        raise FirmwareError(
            f"unknown firmware {name!r}{hint}{', '.join(sorted(BUNDLED))}; "
            "or package.module:Class, or a path to a .py file"
        )
    if found is None:
        raise FirmwareError(f"firmware {name!r}: {place} has no {class_name}{_offer(module)}")
    return _checked(name, found)


def _checked(name: str, found: object) -> FirmwareClass:
    if not (isinstance(found, type) and issubclass(found, Firmware | CellFirmware)):
        raise FirmwareError(f"firmware {name!r} is not a subclass of Firmware or CellFirmware")
    missing = sorted(getattr(found, "__abstractmethods__", ()))
    if missing:
        raise FirmwareError(
            f"firmware {name!r} does not define {' and '.join(missing)}{_nearest(found, missing)}"
        )
    if isinstance(getattr(found, "parameters", None), type):
        raise FirmwareError(
            f"firmware {name!r}: the class of its parameters must be called Parameters, not parameters"
        )
    parameters = cast("object", found.Parameters)
    if not (isinstance(parameters, type) and issubclass(parameters, BaseModel)):
        raise FirmwareError(
            f"firmware {name!r}: Parameters must be a pydantic model, as a class derived from mdms.Spec is"
        )
    if found.message is not None:
        _check_message(name, found.message)
    _check_random(name, found.random)
    return found


def _check_random(name: str, random: object) -> None:
    """Refuse names of random numbers that are no tuple of different identifiers."""
    names: Any = random
    if not (
        isinstance(random, tuple)
        and all(isinstance(one, str) and one.isidentifier() for one in names)
        and len(set(names)) == len(names)
    ):
        raise FirmwareError(
            f"firmware {name!r}: random must be a tuple of different names, such as ('backoff',), not {random!r}"
        )


def _check_message(name: str, message: object) -> None:
    if not isinstance(message, np.dtype):
        raise FirmwareError(f"firmware {name!r}: message must be an np.dtype, not {type(message).__name__}")
    try:
        packed = check_message(message)  # pyright: ignore[reportUnknownArgumentType]
    except WireError as error:
        raise FirmwareError(f"firmware {name!r}: {error}") from None
    if message != packed:
        raise FirmwareError(
            f"firmware {name!r}: message must be little-endian and packed: {packed.descr}, not {message}"
        )


def _imported(name: str, module: str) -> ModuleType:
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is not None and (module == error.name or module.startswith(f"{error.name}.")):
            file = Path(*module.split(".")).with_suffix(".py")
            path = f"its path: {file}:{name.partition(':')[2]}" if file.is_file() else "its path"
            raise FirmwareError(
                f"firmware {name!r}: there is no module {error.name!r} to import (a file can be given by {path})"
            ) from None
        raise _import_failed(name, error) from error
    except (Exception, SystemExit) as error:
        raise _import_failed(name, error) from error


def _from_file(name: str, path: Path) -> ModuleType:
    if not path.is_file():
        raise FirmwareError(f"firmware {name!r}: there is no file {path}")
    try:
        return import_file(path)
    except (Exception, SystemExit) as error:
        raise _import_failed(name, error) from error


def _import_failed(name: str, error: Exception | SystemExit) -> FirmwareError:
    """Return the error of a failed import, with a traceback of the firmware's frames only."""
    shortened = traceback.TracebackException.from_exception(error)
    shortened.stack = traceback.StackSummary.from_list(
        [frame for frame in shortened.stack if not _imports(frame.filename)]
    )
    trace = "".join(shortened.format()).rstrip()
    return FirmwareError(f"firmware {name!r} can't be loaded: {type(error).__name__}: {error}\n{trace}")


def _imports(file: str) -> bool:
    """Whether a frame's file is of what imports, not of the firmware."""
    return "importlib" in file or file in (__file__, firmware_files.__file__)


def _nearest(found: type, missing: Sequence[str]) -> str:
    """Return the methods that are perhaps the missing ones, misspelt."""
    others = [one for one in vars(found) if not one.startswith("_") and one not in missing]
    near = [
        (nearest[0], one)
        for one in missing
        if (nearest := difflib.get_close_matches(one, others, n=1, cutoff=0.8))
    ]
    return "".join(f"; is {spelt} meant to be {one}?" for spelt, one in near)


def _defined(module: ModuleType, *, abstract: bool = False) -> list[str]:
    """Return the names of the firmware classes that a module defines itself; abstract ones lack a method."""
    return sorted(
        name
        for name, value in vars(module).items()
        if isinstance(value, type)
        and issubclass(value, Firmware | CellFirmware)
        and value.__module__ == module.__name__
        and inspect.isabstract(value) is abstract
    )


def _offer(module: ModuleType) -> str:
    names = _defined(module)
    return f"; it has {', '.join(names)}" if names else ""


def _only_firmware(name: str, module: ModuleType) -> object:
    names = _defined(module) or _defined(module, abstract=True)
    if len(names) != 1:
        found = f"{len(names)} ({', '.join(names)}): name one, as in {name}:{names[0]}" if names else "none"
        raise FirmwareError(f"firmware {name!r}: expected one Firmware or CellFirmware class, found {found}")
    return getattr(module, names[0])
