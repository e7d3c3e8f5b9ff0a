"""Memory of serial lines for kernels: the state of ``SerialLines`` in records and in bytes of one piece."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.components import LinkMemory
from cell_firmware.effects.serial.framing import Frame
from cell_firmware.effects.serial.timing import BITS_A_BYTE, LineSettings, LineTimes
from cell_firmware.firmware import State
from cell_firmware.kernels.memory import entry_address
from cell_firmware.kernels.uarts import BOUNDED, CHECK, FLOAT, RUN, UART, UARTS, idle, receive, send
from cell_firmware.message_values import values_of

_TIMES: Final = ("byte_ns", "come_ns", "idle_ns", "stop_ns")


def uart_memory(
    state: State, frame: Frame, settings: LineSettings, times: LineTimes, shifts: bool, window_ns: int
) -> LinkMemory:
    """Copy a state.

    Args:
        state: Of n cells.
        frame: Of the messages.
        settings: Of the lines.
        times: Of lines whose clocks are equal.
        shifts: Whether every window brings a burst, be it empty.
        window_ns: How long a window of the exchange is.
    """
    bursts = sum(name.startswith("data_") for name in state)
    cells = np.zeros(len(state["gone"]), dtype=UART)
    for name in _TIMES:
        cells[name] = getattr(times, name)
    runs = np.zeros((len(cells), 4, 2 * bursts), dtype=RUN)
    samples = np.tile(np.arange(BITS_A_BYTE, dtype=np.int64), (len(cells), 4, 1))
    views = dict[str, NDArray[Any]](_views(cells, runs))
    data = np.stack([state[f"data_{i}"] for i in range(bursts)], axis=2)
    views.update((f"data_{i}", data[:, :, i]) for i in range(bursts))
    waiting, going, buffer = (state[name].copy() for name in ("waiting", "going", "buffer"))
    views.update(waiting=waiting, going=going, buffer=buffer, samples=samples)
    parts = {name: _like(views[name], array) for name, array in state.items()}
    checks = _checks(frame)
    record = np.zeros(1, dtype=UARTS)
    for name, value in {
        "size": frame.size,
        "width": state["buffer"].shape[2] - frame.length - 1,
        "bursts": bursts,
        "shifts": shifts,
        "polled": settings.polled,
        "polled_bytes": settings.polled_bytes,
        "room": settings.buffer_bytes,
        "dwell": settings.dwell_periods or 0,
        "behind": "ppb" in state,
        "window_ns": window_ns,
        "period_ns": settings.period_ns,
        "byte_ns": settings.byte_ns,
        "late_ns": times.late_ns,
        "fields": len(checks),
    }.items():
        record[name] = value
    arrays = {
        "cells": cells,
        "runs": runs,
        "samples": samples,
        "going": going,
        "waiting": waiting,
        "buffer": buffer,
        "data": data,
        "checks": checks,
    }
    for name, array in arrays.items():
        assert array.flags.c_contiguous, f"this is a bug: {name} in pieces"
        record[name] = array.ctypes.data
    kernels = {"receive": receive, "send": send, "idle": idle}
    addresses = {name: entry_address(function) for name, function in kernels.items()}
    return LinkMemory(parts, record, tuple(arrays.values()), addresses)


def _views(cells: NDArray[Any], runs: NDArray[Any]) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the memory of records by the names that ``SerialLines`` has for it."""
    for name in cells.dtype.names or ():
        yield name, cells[name]
    for r in range(runs.shape[2]):
        yield f"left_{r}", runs["left"][:, :, r]
        yield f"place_{r}", runs["place"][:, :, r]
        yield f"start_{r}_ns", runs["start_ns"][:, :, r]


def _like(view: NDArray[Any], array: NDArray[Any]) -> NDArray[Any]:
    """Return a view with the values of a state's array, and of its type."""
    typed = view.view(np.bool_) if array.dtype == np.bool_ else view
    typed[...] = array
    return typed


def _checks(frame: Frame) -> NDArray[Any]:
    """Return the numbers of a message that some bytes can't be, ``(fields,)`` of ``kernels.uarts.CHECK``."""
    found: list[tuple[int, int, int, int]] = []
    for value in values_of(frame.packed):
        start, size = value.start, value.type.itemsize
        if value.type.kind == "f":
            found.append((FLOAT, start, size, 0))
        elif value.type.kind == "b":
            found.append((BOUNDED, start, size, 1))
        elif value.leaf.most is not None:
            found.append((BOUNDED, start, size, value.leaf.most))
    return np.array(found, dtype=CHECK)
