"""Variables of programs by name: replaced in the state of cells, whatever form the program has."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from cell_firmware.errors import FirmwareError
from cell_firmware.firmware import Cells, Firmware, State
from cell_firmware.message_values import bounds
from cell_firmware.plain_registers import WHOLE

PER_CELL: Final = "cell"
"""Array in which a program in plain Python has the states of its cells."""


def replaced(state: State, name: str, rows: NDArray[np.int64], values: NDArray[Any]) -> State:
    """Return a state in which a variable of some cells has other values.

    Args:
        state: State of n cells' programs.
        name: The variable.
        rows: ``(m,)``, rows of the cells.
        values: ``(m, ...)``, a value for each.

    Raises:
        FirmwareError: There is no such variable, or a value doesn't fit.
    """
    if set(state) == {PER_CELL} and state[PER_CELL].dtype == object:
        states = state[PER_CELL].copy()
        for row, value in zip(rows.tolist(), values, strict=True):
            states[row] = _with(states[row], name, value)
        return {PER_CELL: states}
    if name not in state:
        raise FirmwareError(
            f"register {name}: the program has no such variable; it has {', '.join(sorted(state))}"
        )
    array = state[name].copy()
    if values.shape[1:] != array.shape[1:]:
        raise FirmwareError(
            f"register {name}: a cell's value must have the shape {array.shape[1:]}, not {values.shape[1:]}"
        )
    _check(name, values, array.dtype)
    array[rows] = values
    return {**state, name: array}


def set_initial(program: Firmware, table: Mapping[str, Any]) -> None:
    """Have a program's ``init`` return other values of some variables, after each power-on.

    Args:
        program: The program; ``init`` is replaced on the instance.
        table: By variable, the value of every cell, or a table of values by ``"row,column"``.
    """
    init = program.init

    def begun(cells: Cells) -> State:
        state = init(cells)
        place = {
            f"{row},{column}": i
            for i, (row, column) in enumerate(zip(cells.row.tolist(), cells.column.tolist(), strict=True))
        }
        for name, given in table.items():
            by_cell = (
                cast("Mapping[str, Any]", given)
                if isinstance(given, Mapping)
                else dict.fromkeys(place, given)
            )
            for cell, value in by_cell.items():
                if cell in place:
                    state = replaced(state, name, np.array([place[cell]]), np.asarray(value)[None])
        return state

    vars(program)["init"] = begun


def _check(name: str, values: NDArray[Any], dtype: np.dtype[Any]) -> None:
    if values.dtype.kind not in "biuf":
        raise FirmwareError(f"register {name}: must be numbers, not {values.dtype}")
    if dtype.kind not in "iu":
        return
    low, high = bounds(dtype)
    if not np.all((values >= low) & (values <= high) & (values == np.floor(values))):
        raise FirmwareError(
            f"register {name} = {values.tolist()}: must be whole numbers from {low} to {high} ({dtype})"
        )


def _with(state: Any, name: str, value: Any) -> Any:
    """Return a cell's state with another value of a variable, of the type that it had."""
    if is_dataclass(state) and name in {one.name for one in fields(state)}:
        return replace(cast("Any", state), **{name: _alike(getattr(state, name), value)})
    if name in getattr(state, "_fields", ()):
        return cast("Any", state)._replace(**{name: _alike(getattr(state, name), value)})
    if isinstance(state, Mapping) and name in state:
        table = cast("Mapping[str, Any]", state)
        return {**table, name: _alike(table[name], value)}
    if name == WHOLE and isinstance(state, bool | int | float):
        return _alike(state, value)
    kind = type(cast("object", state)).__name__
    raise FirmwareError(
        f"register {name}: a cell's state has no such variable: it is a {kind}; variables of dataclasses, named tuples "
        f"and dicts can be set, and a state that is a number, by the name {WHOLE}"
    )


def _alike(before: Any, value: Any) -> Any:
    """Return a value in the type of the earlier value."""
    plain: Any = np.asarray(value).tolist()
    if isinstance(before, bool | int | float):
        return type(before)(plain)
    return tuple(cast("list[Any]", plain)) if isinstance(before, tuple) and isinstance(plain, list) else plain
