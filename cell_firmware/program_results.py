"""Checks of what a program returns: a state and outputs of the right kinds, shapes and types."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell_firmware.firmware import Firmware, Outbox, Outputs, State, can_settle
from cell_firmware.scalar import ScalarFirmware, state_problem


class BadResult(Exception):
    """Firmware returned something of the wrong kind; no row in particular is to blame."""


def checked_result(
    result: Any, before: State, message: np.dtype[Any] | None, n: int
) -> tuple[State, Outputs]:
    """Return the result of a firmware's step if it is of the right kind.

    Args:
        result: The result.
        before: The state before.
        message: Type of the firmware's messages.
        n: How many cells were stepped.

    Raises:
        BadResult: It isn't.
    """
    if not (isinstance(result, tuple) and len(result) == 2):  # pyright: ignore[reportUnknownArgumentType]
        raise BadResult(f"step must return (state, Outputs), not {type(result).__name__}")  # pyright: ignore[reportUnknownArgumentType]
    state, outputs = result  # pyright: ignore[reportUnknownVariableType]
    if not isinstance(outputs, Outputs):
        raise BadResult(f"step must return (state, Outputs), not {type(outputs).__name__} as the second")  # pyright: ignore[reportUnknownArgumentType]
    speed: Any = outputs.speed_m_s
    if not isinstance(speed, np.ndarray) or speed.shape != (n, 2) or speed.dtype.kind not in "fiu":  # pyright: ignore[reportUnknownMemberType]
        raise BadResult(f"speed_m_s must be real numbers of shape ({n}, 2), not {_kind(speed)}")
    if outputs.outbox is not None:
        _check_outbox(outputs.outbox, message, n)
    served: Any = outputs.served
    if served is not None and not _is_flags(served, (n,)):
        raise BadResult(f"served must be None or bool of shape ({n},), not {_kind(served)}")
    return checked_state(state, before, n), outputs


def _check_outbox(outbox: Any, message: np.dtype[Any] | None, n: int) -> None:
    if message is None:
        raise BadResult("the firmware sends messages but declares no message type")
    if not isinstance(outbox, Outbox):
        raise BadResult(f"outbox must be an Outbox, not {type(outbox).__name__}")
    sent: Any = outbox.sent
    if not _is_flags(sent, (n, 4)):
        raise BadResult(f"outbox.sent must be bool of shape ({n}, 4), not {_kind(sent)}")
    found: Any = outbox.message
    if not isinstance(found, np.ndarray) or found.shape != (n, 4) or not can_settle(found.dtype, message):  # pyright: ignore[reportUnknownMemberType, reportUnknownArgumentType]
        raise BadResult(f"outbox.message must be {message} of shape ({n}, 4), not {_kind(found)}")


def checked_state(state: Any, before: State | None, n: int) -> State:
    """Return a state if it is arrays with a row a cell.

    Args:
        state: The state.
        before: That of the tick before, whose names it must have; None: it is the first.
        n: How many cells it is of.

    Raises:
        BadResult: It isn't.
    """
    if not isinstance(state, Mapping):
        raise BadResult(f"state must be a mapping of names to arrays, not {type(state).__name__}")
    if before is not None and state.keys() != before.keys():  # pyright: ignore[reportUnknownMemberType]
        raise BadResult(f"state must hold {sorted(before)} as before, not {sorted(state)}")  # pyright: ignore[reportUnknownArgumentType]
    arrays: Mapping[str, Any] = state  # pyright: ignore[reportUnknownVariableType]
    for name, array in arrays.items():
        if not isinstance(array, np.ndarray) or array.ndim < 1 or len(array) != n:  # pyright: ignore[reportUnknownArgumentType]
            raise BadResult(f"state[{name!r}] must be an array with {n} rows, one a cell, not {_kind(array)}")
    return arrays


def check_observable(firmware: Firmware, state: State) -> None:
    """Check that the state has the variable of `observable`.

    Raises:
        BadResult: It isn't.
    """
    name = firmware.observable
    if name is not None and name not in (found := firmware.observables(state)):
        raise BadResult(
            f"observable is {name!r}: the state has no such variable; it has {', '.join(found) or 'none'}"
        )


def check_fields(firmware: Firmware, state: State) -> None:
    """Check that the first state of a program in scalar form fits its records.

    Raises:
        BadResult: It doesn't.
    """
    if isinstance(firmware, ScalarFirmware) and (
        problem := state_problem(firmware.scalar_kernels().STATE, state)
    ):
        raise BadResult(problem)


def _is_flags(value: Any, shape: tuple[int, ...]) -> bool:
    return isinstance(value, np.ndarray) and value.dtype == np.bool_ and value.shape == shape  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]


def _kind(value: Any) -> str:
    if isinstance(value, np.ndarray):
        array: NDArray[Any] = value  # pyright: ignore[reportUnknownVariableType]
        return f"{array.dtype} of shape {array.shape}"
    return type(value).__name__
