"""Registers of plain firmware: the numbers in its cells' states, by name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from bus.lockstep.registers import COLUMNS_LIMIT

WHOLE: Final = "state"
"""Register of a state that is itself a number or a list of numbers."""


def registers_of(states: Iterable[Any], observed: str | None) -> dict[str, NDArray[np.float64]]:
    """Return registers of cells: float64 arrays by name, with a row a cell, NaN where a cell has no such numbers.

    Args:
        states: The cells' states. Recorded are the fields of a dataclass, a named tuple, a mapping or a record of
            NumPy's, and a state that is itself a number or a list of numbers.
        observed: The variable that the program names, a key or any attribute of its state; it is there in any case.
    """
    everyone = list(states)
    names = list(dict.fromkeys(name for state in everyone for name in _names(state)))
    if observed is not None and observed not in names and any(_has(state, observed) for state in everyone):
        names.append(observed)
    found: dict[str, NDArray[np.float64]] = {}
    for name in names:
        values = [_numbers(_value(state, name)) for state in everyone]
        shape = next((value.shape for value in values if value is not None), None)
        if shape is None and name != observed:
            continue
        blank = np.full(shape or (), np.nan)
        found[name] = np.stack(
            [blank if value is None or value.shape != blank.shape else value for value in values]
        )
    return found


def unrecorded(state: Any) -> str | None:
    """Reason why a state's registers aren't recorded, or not all of them; None if all are.

    Args:
        state: Of one cell, as the program's ``init`` made it. A field that is None may have numbers later.
    """
    names = _names(state)
    if not names:
        return (
            f"its state is {_kind(state)}, which has no numbers by name; a dataclass, a NamedTuple, a dict or a NumPy "
            "record of numbers is recorded"
        )
    reasons: list[str] = []
    for name in names:
        value = _value(state, name)
        numbers = _numbers(value)
        if numbers is None and value is not None:
            reasons.append(f"{name} is {_kind(value)}, not numbers")
        elif numbers is not None and not 0 < numbers.size <= COLUMNS_LIMIT:
            reasons.append(f"{name} has {numbers.size} numbers, not 1 to {COLUMNS_LIMIT}")
    return f"parts of its state are not recorded: {', '.join(reasons)}" if reasons else None


def _names(state: Any) -> tuple[str, ...]:
    found: Any = ()
    if isinstance(state, Mapping):
        found = (key for key in cast("Mapping[Any, Any]", state) if isinstance(key, str))
    elif is_dataclass(state):
        found = (field.name for field in fields(state))
    elif hasattr(state, "_fields"):
        found = state._fields
    elif _is_record(state):
        found = state.dtype.names
    elif state is not None and _numbers(state) is not None:
        found = (WHOLE,)
    return tuple(found)


def _is_record(state: Any) -> bool:
    """Whether a state is a record of NumPy's."""
    return isinstance(state, np.generic | np.ndarray) and cast("Any", state).dtype.names is not None


def _has(state: Any, name: str) -> bool:
    return name in state if isinstance(state, Mapping) else hasattr(state, name)


def _value(state: Any, name: str) -> Any:
    """A variable of a state; None where it has none of that name."""
    if _is_record(state) and name in state.dtype.names:
        return state[name]
    if _has(state, name):
        return cast("Any", state)[name] if isinstance(state, Mapping) else getattr(state, name)
    return state if _names(state) == (name,) else None


def _numbers(value: Any) -> NDArray[np.float64] | None:
    """A value as numbers; None where it is none."""
    try:
        if value is None or np.asarray(value).dtype.kind not in "biufO":
            return None
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return None


def _kind(value: Any) -> str:
    return "None" if value is None else f"a {type(value).__name__}"
