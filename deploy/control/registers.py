"""Reading of the current registers of a running system's cells, from outside."""

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
from deploy.control.client import ANY_RUN, absence, ask_at, only_run
from deploy.errors import DeployError, InputError, RequestError
from deploy.security.session import operator_session

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from bus.transports.base import Endpoint
    from bus.transports.zenoh import ZenohEndpoint

Cell = tuple[int, int]

_DEAF: Final = (
    "With keys, mdms plant --listen takes no listeners: use --run DIR on the plant's host, or a router"
)
_MOST_CELLS: Final = 1_000_000
"""Most cells of a shard, which bounds the size of a frame."""
_ATTEMPT_S: Final = 1.0
"""Wall time after which the request for registers is repeated."""
_TOGETHER_S: Final = 1.0
"""Wall time after the first frame in which the other shards' frames arrive; shards publish five times a second."""


@final
@dataclass(slots=True)
class RegisterReadings:
    """Registers read from the cells of a run.

    Attributes:
        run: Name of the run.
        tick: The last tick that a cell had computed.
        cells: Registers of each cell by name, one number or several.
    """

    run: str = ""
    tick: int = -1
    cells: dict[Cell, dict[str, Any]] = field(default_factory=dict[Cell, dict[str, Any]])


def registers_key(run: str) -> str:
    """Return the keys on which a run's cells publish registers."""
    return shard_key(run, None, "registers")


def read_registers(
    connect: str, wanted: Iterable[Cell], timeout_s: float, keys: Path | None = None, run: str = ANY_RUN
) -> RegisterReadings:
    """Read the current registers of cells.

    Args:
        connect: Endpoint on which the run's plant listens, such as ``tcp/127.0.0.1:7447``.
        wanted: Cells to read; empty: all cells that answer.
        timeout_s: Wall time to wait for the cells, s.
        keys: Folder of the run's or the operator's keys; None if the run has none.
        run: Name of the run; ``ANY_RUN``: the only one there.

    Raises:
        InputError: No plant listens there, the plant doesn't accept the keys, there are several runs and none is
            named, or wanted cells are missing or dead.
        RequestError: The run still waits for its cells.
        DeployError: No registers arrived in time.
    """
    deadline = time.monotonic() + timeout_s
    endpoint = operator_session(connect, timeout_s, keys)
    try:
        name = only_run(endpoint, connect, run)
        endpoint.subscribe(registers_key(name))
        try:
            return request_registers(endpoint, connect, set(wanted), deadline, run=name)
        except DeployError as error:
            if absent := absence(endpoint, name):
                raise InputError(f"{connect}: {absent}") from None
            if keys is not None and not isinstance(error, InputError | RequestError):
                raise DeployError(f"{error} {_DEAF}") from None
            raise error from None
    finally:
        endpoint.close()


def request_registers(
    endpoint: ZenohEndpoint,
    connect: str,
    wanted: set[Cell],
    deadline: float,
    most: int = _MOST_CELLS,
    run: str = ANY_RUN,
) -> RegisterReadings:
    """Request and collect registers over a session subscribed to them; a paused run publishes on request alone.

    The subscription takes a moment to reach the cells, so that the request is repeated.

    Args:
        endpoint: The session.
        connect: Its endpoint, named in errors.
        wanted: Cells to read; empty: all cells that answer.
        deadline: A time of ``time.monotonic``, s.
        most: Number of the run's cells, as far as it is known.
        run: Name of the run.

    Raises:
        InputError: Wanted cells are missing or dead.
        RequestError: The run still waits for its cells.
        DeployError: No registers arrived in time.
    """
    while True:
        attempt = min(deadline, time.monotonic() + _ATTEMPT_S)
        try:
            ask_at(endpoint, connect, {"op": "show"}, max(attempt - time.monotonic(), 0.01), run)
        except RequestError:
            raise
        except DeployError:  # a plant that waits for a cell in a tick doesn't answer, but other cells publish
            pass
        try:
            return collect(endpoint, wanted, attempt, most)
        except (DeployError, InputError):
            if attempt >= deadline:
                raise


def collect(
    endpoint: Endpoint, wanted: set[Cell], deadline: float, most: int = _MOST_CELLS
) -> RegisterReadings:
    """Collect registers from an endpoint subscribed to them.

    Args:
        endpoint: The endpoint.
        wanted: Cells to read; empty: all cells that answer.
        deadline: A time of ``time.monotonic``, s.
        most: Number of cells beyond which there are no others to wait for.
    """
    seen = RegisterReadings()
    while (left := deadline - time.monotonic()) > 0 and not (wanted and wanted <= seen.cells.keys()):
        if len(seen.cells) >= most:
            break
        event = endpoint.receive(left)
        if not isinstance(event, Received):
            continue
        if not seen.cells and not wanted:
            deadline = min(deadline, time.monotonic() + _TOGETHER_S)
        _take(seen, event)
    if not seen.cells:
        raise DeployError("no cell published registers in time: has the run ended, or has it not begun?")
    missing = sorted(wanted - seen.cells.keys())
    if missing:
        names = ", ".join(f"{row},{column}" for row, column in missing)
        raise InputError(f"cell {names}: not in run {seen.run}, or dead")
    return seen


def _take(seen: RegisterReadings, event: Received) -> None:
    """Add the registers of a frame; ignore a payload that is no frame."""
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
    """Return minimum, mean and maximum of every register that all cells have, over cells and numbers."""
    import numpy as np

    found: dict[str, tuple[float, float, float]] = {}
    for name, first in next(iter(cells.values())).items():
        if any(name not in own or np.shape(own[name]) != np.shape(first) for own in cells.values()):
            continue  # of another run
        values: NDArray[Any] = np.array([registers[name] for registers in cells.values()], dtype=np.float64)
        if values.size:
            found[name] = (float(values.min()), float(values.mean()), float(values.max()))
    return found
