"""Checks of a scalar program's source before it is compiled, and a compiler's errors in the author's terms."""

from __future__ import annotations

import ast
import builtins
import difflib
import dis
import inspect
import linecache
import re
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FunctionType
from typing import Any, Final, cast

import numpy as np

PARAMETERS: Final = ("constants", "state", "inputs", "outputs")
"""Parameters of a step, in this order; their names are free."""
_FRAME: Final = re.compile(r"During: .* at (.+) \((\d+)\)")
"""Line of numba's message that names a place in a file, the innermost first."""
_CALL: Final = re.compile(r">>> (.+)")
"""Line of numba's message that names what there is no compiled form of."""
_KERNELS: Final = Path(__file__).resolve().parent / "kernels"


def source_problems(step: Callable[..., Any], records: tuple[np.dtype[Any], ...]) -> list[str]:
    """Return the mistakes in the source of a step: unknown fields of records, undefined names, wrong parameters.

    Args:
        step: The step.
        records: Types of its arguments, as ``PARAMETERS``.
    """
    function = cast("FunctionType", step)
    names = list(inspect.signature(function).parameters)
    if len(names) != len(PARAMETERS):
        return [f"has parameters {', '.join(names)}: must be a static method of {', '.join(PARAMETERS)}"]
    try:
        lines, first = inspect.getsourcelines(function)
    except (OSError, TypeError):
        return []  # compiling says so
    tree = ast.parse(textwrap.dedent("".join(lines)))
    fields = _Fields(dict(zip(names, records, strict=True)))
    fields.visit(tree)
    found = [(first + line - 1, problem) for line, problem in [*fields.problems]] + [
        *_unknown_names(function)
    ]
    file = Path(function.__code__.co_filename).name
    return [f"line {line} of {file}: {problem}" for line, problem in sorted(set(found))]


def compile_problem(error: Exception) -> str:
    """Return a compiler's error in a line: what can't be compiled, and the line of the program."""
    text = str(error)
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    telling = [
        line for line in lines if not line.startswith(("Failed in", "During:", "There are", "-", "*", "File"))
    ]
    call = _CALL.search(text)
    what = f"there is no {call[1]}" if call else f"{type(error).__name__}: {telling[0] if telling else text}"
    for file, line in _FRAME.findall(text):
        path = Path(file).resolve()
        if not path.is_relative_to(_KERNELS) and "numba" not in path.parts:
            source = linecache.getline(file, int(line)).strip()
            return f"line {line} of {Path(file).name}: {what} (in: {source})"
    return what


class _Fields(ast.NodeVisitor):
    """Fields that a step reads and writes, held against the types of its records.

    Attributes:
        problems: Line in the source, and what is wrong.
    """

    def __init__(self, records: dict[str, np.dtype[Any]]) -> None:
        self._types: dict[str, np.dtype[Any] | None] = {**records}
        self.problems: list[tuple[int, str]] = []

    def visit_Assign(self, node: ast.Assign) -> None:
        self.generic_visit(node)
        for target in node.targets:
            self._assign(target, node.value)

    def _assign(self, target: ast.expr, value: ast.expr) -> None:
        if (
            isinstance(target, ast.Tuple)
            and isinstance(value, ast.Tuple)
            and len(target.elts) == len(value.elts)
        ):
            for one, its in zip(target.elts, value.elts, strict=True):
                self._assign(one, its)
        elif isinstance(target, ast.Name):
            found = self._type(value)
            before = self._types.get(target.id, found)
            self._types[target.id] = found if found == before else None  # of two types: not followed

    def visit_Attribute(self, node: ast.Attribute) -> None:
        self.generic_visit(node)
        record = self._type(node.value)
        if record is None or record.names is None or node.attr in record.names:
            return
        close = difflib.get_close_matches(node.attr, record.names, n=1)
        hint = f"nearest: {close[0]}" if close else f"fields: {', '.join(record.names)}"
        self.problems.append((node.lineno, f"{ast.unparse(node.value)} has no field {node.attr}; {hint}"))

    def _type(self, node: ast.expr) -> np.dtype[Any] | None:
        """Return the type of a record or an array of records; None where it is not known."""
        if isinstance(node, ast.Name):
            return self._types.get(node.id)
        if isinstance(node, ast.Attribute):
            record = self._type(node.value)
            if record is None or record.names is None or node.attr not in record.names:
                return None
            return record[node.attr]
        if isinstance(node, ast.Subscript) and not isinstance(node.slice, ast.Slice):
            array = self._type(node.value)
            if array is None or array.subdtype is None:
                return None
            taken = len(node.slice.elts) if isinstance(node.slice, ast.Tuple) else 1
            base, shape = array.subdtype
            return np.dtype((base, shape[taken:])) if taken < len(shape) else base
        return None


def _unknown_names(function: FunctionType) -> Iterator[tuple[int, str]]:
    """Yield line and problem of each name that neither the file nor Python has."""
    line = function.__code__.co_firstlineno
    for instruction in dis.get_instructions(function):
        line = (instruction.positions and instruction.positions.lineno) or line
        name = instruction.argval
        if instruction.opname != "LOAD_GLOBAL" or name in function.__globals__ or hasattr(builtins, name):
            continue
        yield line, f"name {name} is not defined"
