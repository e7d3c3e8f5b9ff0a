"""Looks at the cells of a system that runs elsewhere: their registers, as they are now."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

from bus.errors import WireError
from bus.lockstep.registers import decode_registers
from bus.transports.base import Received
from bus.wire.keys import shard_key
from deploy.errors import DeployError, InputError
from deploy.security.session import operator_session

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from bus.transports.base import Endpoint

Cell = tuple[int, int]

KEYS: Final = shard_key("*", None, "registers")
"""On which cells show themselves."""

_MOST_CELLS: Final = 1_000_000
"""Of a shard: what its frames are bounded by."""
_TOGETHER_S: Final = 1.0
"""Wall time after the first frame within which those of the other shards come: they look five times a second."""


@final
@dataclass(slots=True)
class RegisterReadings:
    """What cells showed of themselves.

    Attributes:
        run: Name of the run.
        tick: The last tick that a cell had computed.
        cells: Of each cell its registers by name, one number or several.
    """

    run: str = ""
    tick: int = -1
    cells: dict[Cell, dict[str, Any]] = field(default_factory=dict[Cell, dict[str, Any]])


def read_registers(
    connect: str, wanted: Iterable[Cell], timeout_s: float, keys: Path | None = None
) -> RegisterReadings:
    """What cells show of themselves now.

    Args:
        connect: Where the plant of the run listens, such as ``tcp/127.0.0.1:7447``.
        wanted: Which cells; none: all that answer.
        timeout_s: Wall seconds to wait for them.
        keys: A run's, or an operator's, where the run lets in only who has some.

    Raises:
        InputError: Nobody listens there, or they let nobody in with these keys, or the cells wanted are not those of
            that run.
        DeployError: Nobody showed anything in time.
    """
    begun = time.monotonic()
    endpoint = operator_session(connect, timeout_s, keys)
    try:
        endpoint.subscribe(KEYS)
        return collect(endpoint, set(wanted), begun + timeout_s)
    finally:
        endpoint.close()


def collect(endpoint: Endpoint, wanted: set[Cell], deadline: float) -> RegisterReadings:
    """The same, of an endpoint that has subscribed to ``KEYS``, until a time of ``time.monotonic``."""
    seen = RegisterReadings()
    while (left := deadline - time.monotonic()) > 0 and not (wanted and wanted <= seen.cells.keys()):
        event = endpoint.receive(left)
        if not isinstance(event, Received):
            continue
        if not seen.cells and not wanted:
            deadline = min(deadline, time.monotonic() + _TOGETHER_S)
        _take(seen, event)
    if not seen.cells:
        raise DeployError("no cell showed anything in time: has the run ended, or does it stand still?")
    missing = sorted(wanted - seen.cells.keys())
    if missing:
        names = ", ".join(f"{row},{column}" for row, column in missing)
        raise InputError(f"cell {names}: not in run {seen.run}, or dead")
    return seen


def _take(seen: RegisterReadings, event: Received) -> None:
    """Note what a frame says; a frame that is none is somebody else's."""
    try:
        frame = decode_registers(event.payload, _MOST_CELLS)
    except WireError:
        return
    seen.run = seen.run or event.key.split("/")[1]
    seen.tick = max(seen.tick, frame.tick)
    registers = {name: array.tolist() for name, array in frame.registers.items()}
    for i, (row, column) in enumerate(frame.cells.tolist()):
        seen.cells[row, column] = {name: rows[i] for name, rows in registers.items()}


def ranges(cells: Mapping[Cell, Mapping[str, Any]]) -> dict[str, tuple[float, float, float]]:
    """Of every register that all cells have the least, the mean and the greatest, over them and the numbers in it."""
    import numpy as np

    found: dict[str, tuple[float, float, float]] = {}
    for name, first in next(iter(cells.values())).items():
        if any(name not in own or np.shape(own[name]) != np.shape(first) for own in cells.values()):
            continue  # of another run, or nobody's
        values: NDArray[Any] = np.array([registers[name] for registers in cells.values()], dtype=np.float64)
        if values.size:
            found[name] = (float(values.min()), float(values.mean()), float(values.max()))
    return found
