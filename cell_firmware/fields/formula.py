"""Formulas of x and y in a scene's text: read by a closed grammar, with the same bits for one cell and for many."""

from __future__ import annotations

import ast
import re
import warnings
from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Any, Final, final

import numpy as np

from cell_firmware.fields.base import Array

LONGEST: Final = 1_000
"""Characters of a formula, at most."""
DEEPEST: Final = 100
"""How deeply its parts may be nested; each further term of a sum nests the ones before it."""
HIGHEST_POWER: Final = 16

_PI: Final = 3.141592653589793
_Places = tuple[Array, Array]
_Value = Callable[[_Places], Array]
"""Of the places' coordinates."""
_Truth = Callable[[_Places], Any]
"""A bool for each place."""


class FormulaError(ValueError):
    """A formula that is refused: which rule, and where in the text."""


def _alone(function: Callable[..., Array]) -> Callable[..., Array]:
    """A function that sees one number at a time: NumPy's vector loops may round otherwise than for a single number."""

    def applied(*arguments: Array) -> Array:
        found = np.empty_like(arguments[0])
        for i in range(len(found)):
            found[i : i + 1] = function(*(np.array([argument[i]]) for argument in arguments))
        return found

    return applied


def _least(a: Array, b: Array) -> Array:
    return np.where(
        (a <= b) | np.isnan(a), a, b
    )  # not np.minimum: which of -0 and 0 it gives depends on the place


def _greatest(a: Array, b: Array) -> Array:
    return np.where((a >= b) | np.isnan(a), a, b)


_FUNCTIONS: Final[Mapping[str, tuple[int, Callable[..., Array]]]] = {
    "abs": (1, np.abs),
    "atan2": (2, _alone(np.arctan2)),
    "cos": (1, _alone(np.cos)),
    "exp": (1, _alone(np.exp)),
    "hypot": (2, _alone(np.hypot)),
    "log": (1, _alone(np.log)),
    "sign": (1, np.sign),
    "sin": (1, _alone(np.sin)),
    "sqrt": (1, np.sqrt),
    "tan": (1, _alone(np.tan)),
    "tanh": (1, _alone(np.tanh)),
}
"""How many arguments each takes, and what it is. What NumPy rounds correctly works on whole arrays."""
_OF_SEVERAL: Final[Mapping[str, Callable[[Array, Array], Array]]] = {"max": _greatest, "min": _least}
_FUNCTION_NAMES: Final = (*_FUNCTIONS, *_OF_SEVERAL, "where")
RESERVED: Final = frozenset((*_FUNCTION_NAMES, "x", "y", "pi"))
"""Names that have a meaning, which no constant may take."""

_SUMS: Final[Mapping[type[ast.operator], Callable[[Array, Array], Array]]] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
}
_ORDERS: Final[Mapping[type[ast.cmpop], Callable[[Array, Array], Any]]] = {
    ast.Lt: np.less,
    ast.LtE: np.less_equal,
    ast.Gt: np.greater,
    ast.GtE: np.greater_equal,
    ast.Eq: np.equal,
    ast.NotEq: np.not_equal,
}
_NO_CHARACTER: Final = re.compile(r"[^A-Za-z0-9_+\-*/()<>=!,. \t\r\n]")


@final
class Formula:
    """A number for each place: ``+ - * /``, whole powers, some functions, and ``where(condition, then, else)``.

    The text is read as Python reads an expression, and every part of it that is not on the list above is
    refused. Nothing of it is ever run: its numbers and functions are put together from those here.

    Args:
        text: At most ``LONGEST`` characters.
        constants: Numbers by the names that stand for them.

    Raises:
        FormulaError: The text is refused, with the column and the rule.
    """

    def __init__(self, text: str, constants: Mapping[str, float]) -> None:
        self._value = _Reader(text, constants).read()

    def __call__(self, x: Array, y: Array) -> Array:
        """Evaluate the formula at places ``(n,)``; values may be infinite or NaN."""
        with np.errstate(all="ignore"):
            return self._value((x, y))


@final
class _Reader:
    """Turns a text into a function, part by part."""

    def __init__(self, text: str, constants: Mapping[str, float]) -> None:
        if len(text) > LONGEST:
            raise FormulaError(f"must have at most {LONGEST} characters, not {len(text)}")
        if not text.strip():
            raise FormulaError("must not be empty")
        self._text = re.sub(r"\s", " ", text)
        self._begins = len(self._text) - len(self._text.lstrip())
        self._constants = constants
        self._depth = 0

    def read(self) -> _Value:
        if strange := _NO_CHARACTER.search(self._text):
            raise self._error(strange.start(), f"no formula has the character {strange.group()!r}")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # a number that runs into a name, which Python only warns of
                tree = ast.parse(self._text.lstrip(), mode="eval")
        except SyntaxError as error:
            place = self._begins + error.offset - 1 if error.offset else len(self._text)  # 0: at the end
            raise self._error(place, f"can't be read: {error.msg}") from None
        except (RecursionError, MemoryError):
            raise self._too_deep(self._begins) from None
        return self._read_value(tree.body)

    def _read_value(self, node: ast.expr) -> _Value:
        self._deeper(node)
        match node:
            case ast.Constant(value=number):
                value = self._number(node, number)
            case ast.Name(id=name):
                value = self._name(node, name)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                value = _combined(np.negative, self._read_value(operand))
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                value = self._read_value(operand)
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                value = _power(self._read_value(left), self._exponent(right))
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _SUMS:
                value = _combined(_SUMS[type(op)], self._read_value(left), self._read_value(right))
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
                value = self._call(node, name, arguments)
            case ast.Compare() | ast.BoolOp() | ast.UnaryOp(op=ast.Not()):
                raise self._error_at(node, "a condition stands only at the first place of where(...)")
            case _:
                raise self._error_at(
                    node, "must be a number, a name, + - * / **, or one of the functions with its arguments"
                )
        self._depth -= 1
        return value

    def _read_truth(self, node: ast.expr) -> _Truth:
        self._deeper(node)
        match node:
            case ast.Compare(left=left, ops=ops, comparators=others) if all(type(o) in _ORDERS for o in ops):
                values = [self._read_value(part) for part in (left, *others)]
                truth = _joined(
                    np.logical_and,
                    [
                        _combined(_ORDERS[type(op)], *pair)
                        for op, pair in zip(ops, pairwise(values), strict=True)
                    ],
                )
            case ast.BoolOp(op=op, values=parts):
                both = np.logical_and if isinstance(op, ast.And) else np.logical_or
                truth = _joined(both, [self._read_truth(part) for part in parts])
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                truth = _combined(np.logical_not, self._read_truth(operand))
            case _:
                raise self._error_at(node, "must be a condition: < <= > >= == !=, and, or, not")
        self._depth -= 1
        return truth

    def _number(self, node: ast.expr, number: object) -> _Value:
        if isinstance(number, bool) or not isinstance(number, int | float):
            raise self._error_at(node, f"must be a real number, not {number!r}")
        try:
            value = float(number)
        except OverflowError:
            value = float("inf")
        if value == float("inf"):
            raise self._error_at(node, "must be a finite number")
        return lambda places: np.full_like(places[0], value)

    def _name(self, node: ast.expr, name: str) -> _Value:
        if name in ("x", "y"):
            axis = "xy".index(name)
            return lambda places: places[axis]
        if name in _FUNCTION_NAMES:
            raise self._error_at(node, f"{name} is a function: its arguments are missing")
        value = _PI if name == "pi" else self._constants.get(name)
        if value is None:
            known = ", ".join(("x", "y", "pi", *sorted(self._constants)))
            raise self._error_at(node, f"unknown name {name!r}; known: {known}")
        return lambda places: np.full_like(places[0], value)

    def _call(self, node: ast.expr, name: str, arguments: list[ast.expr]) -> _Value:
        if name == "where" and len(arguments) == 3:
            truth = self._read_truth(arguments[0])
            return _combined(np.where, truth, *(self._read_value(argument) for argument in arguments[1:]))
        if name in _OF_SEVERAL and len(arguments) >= 2:
            return _joined(_OF_SEVERAL[name], [self._read_value(argument) for argument in arguments])
        if name in _FUNCTIONS and len(arguments) == _FUNCTIONS[name][0]:
            return _combined(_FUNCTIONS[name][1], *(self._read_value(argument) for argument in arguments))
        if name not in _FUNCTION_NAMES:
            raise self._error_at(
                node, f"unknown function {name!r}; known: {', '.join(sorted(_FUNCTION_NAMES))}"
            )
        wanted = {"where": "3", "min": "2 or more", "max": "2 or more"}.get(name) or _FUNCTIONS[name][0]
        raise self._error_at(node, f"arguments of {name}: must be {wanted}, not {len(arguments)}")

    def _exponent(self, node: ast.expr) -> int:
        match node:
            case ast.Constant(value=int(number)) if not isinstance(number, bool) and number <= HIGHEST_POWER:
                return number
            case _:
                raise self._error_at(node, f"an exponent must be a whole number, 0 to {HIGHEST_POWER}")

    def _deeper(self, node: ast.expr) -> None:
        self._depth += 1
        if self._depth > DEEPEST:
            raise self._too_deep(self._begins + node.col_offset)

    def _too_deep(self, place: int) -> FormulaError:
        return self._error(place, f"must not be nested deeper than {DEEPEST} parts")

    def _error_at(self, node: ast.expr, rule: str) -> FormulaError:
        return self._error(self._begins + node.col_offset, rule)

    def _error(self, place: int, rule: str) -> FormulaError:
        first = max(0, place - 40)
        shown = self._text[first : place + 30]
        return FormulaError(f"column {place + 1}: {rule}\n  {shown}\n  {' ' * (place - first)}^")


def _combined(function: Callable[..., Any], *parts: Callable[[_Places], Any]) -> Callable[[_Places], Any]:
    def value(places: _Places) -> Any:
        return function(*(part(places) for part in parts))

    return value


def _joined(function: Callable[[Any, Any], Any], parts: list[Callable[[_Places], Any]]) -> Any:
    """Of several parts, from the left."""

    def value(places: _Places) -> Any:
        found = parts[0](places)
        for part in parts[1:]:
            found = function(found, part(places))
        return found

    return value


def _power(base: _Value, exponent: int) -> _Value:
    """By multiplication, one factor after the other."""

    def value(places: _Places) -> Array:
        factor = base(places)
        found = np.ones_like(factor)
        for _ in range(exponent):
            found = found * factor
        return found

    return value
