"""Facts on the selected cell or parcel, as the page lists them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from bus.lattice import OPPOSITE, SIDES
from cell_firmware.shard import MESSAGES
from deploy.view.geometry import outline

if TYPE_CHECKING:
    from deploy.view.geometry import CellGrid
    from deploy.view.source import Floats, Instant, Ints, RunSource

_HEALTH: Final = ("alive", "faulty", "dead or lost")

_INBOX: Final = ("received", "neighbour", "inbox", "heard", "unheard")
_OUTBOX: Final = ("sent", "outbox", "said")
"""Last part of the names of registers that tell of messages received and sent."""
_EXACT: Final = 2**53
"""Greatest integer up to which a browser's numbers are exact."""

Row = dict[str, Any]


def supports(footprint: Floats, state: Floats, centres: Floats) -> Ints:
    """Return the cells whose centre is under a parcel, by index; none for an absent parcel."""
    if not np.isfinite(state).all():
        return np.zeros(0, dtype=np.int64)
    corners = outline(footprint, state)
    low, high = corners.min(axis=0), corners.max(axis=0)
    near = np.flatnonzero(((centres >= low) & (centres <= high)).all(axis=1))
    edges = np.roll(corners, -1, axis=0) - corners
    apart = centres[near, None] - corners[None]
    inside = (edges[None, :, 0] * apart[..., 1] - edges[None, :, 1] * apart[..., 0] >= 0).all(axis=1)
    return near[inside]


def cell_facts(
    source: RunSource, grid: CellGrid, instant: Instant, index: int, cell: int, load_n: float
) -> dict[str, Any]:
    """Return the facts on a cell: state, registers, messages, neighbours, faults.

    Args:
        source: The run.
        grid: Places of its cells.
        instant: The instant.
        index: Number of the instant.
        cell: The cell, by index.
        load_n: Its load, N; NaN if unknown.
    """
    row, column = source.header["cells"][cell]
    speed = instant.wheel_speeds[cell].tolist()
    presence = "".join("●" if bit else "○" for bit in instant.presence[cell].tolist())
    state = [
        _row("place", grid.centres[cell].tolist(), "m"),
        _row("health", _HEALTH[int(instant.health[cell])]),
        _row("wheels", speed, "m/s"),
        _row("sensor", presence),
        _row("load", load_n, "N"),
    ]
    over = _parcels_over(source, grid, instant, cell)
    if over:
        state.append(_row("under", ", ".join(f"parcel {parcel}" for parcel in over)))
    time_s, registers = source.registers(index)
    return {
        "kind": "cell",
        "title": f"Cell {row},{column}",
        "row": row,
        "column": column,
        "sections": [
            {"name": "State", "rows": state},
            *_register_sections(registers, cell, time_s, grid.beside(cell)),
        ],
        "neighbours": [
            {
                "side": side,
                "row": source.header["cells"][other][0],
                "column": source.header["cells"][other][1],
            }
            for side, other in grid.beside(cell).items()
        ],
        "faults": [
            {"number": number, "kind": kind}
            for number, kind in source.fault_state.active_at(instant.time_s, cell)
        ],
    }


def _parcels_over(source: RunSource, grid: CellGrid, instant: Instant, cell: int) -> list[int]:
    centre = grid.centres[cell : cell + 1]
    footprints = [np.array(corners) for corners in source.header["footprints_m"]]
    return [
        parcel
        for parcel, footprint in enumerate(footprints)
        if len(supports(footprint, instant.parcels[parcel], centre))
    ]


def _register_sections(
    registers: Mapping[str, NDArray[Any]], cell: int, time_s: float, beside: Mapping[str, int]
) -> list[dict[str, Any]]:
    """Return the registers of a cell in three sections: messages received, messages sent, all others.

    Messages are those of the last tick: the cell's own are its outbox, the neighbours' to this cell its inbox. The
    program reads the inbox in the next tick, unless a fault or an effect of links acts.
    """
    sections: dict[str, list[Row]] = {"Inbox": [], "Outbox": [], "Registers": []}
    for number, side in enumerate(SIDES):
        if side in beside:
            sections["Outbox"] += _message_rows(registers, cell, number, f"to {side}")
            sections["Inbox"] += _message_rows(registers, beside[side], OPPOSITE[number], f"from {side}")
    for name, values in registers.items():
        if name.startswith(MESSAGES):
            continue
        last = name.rpartition(".")[2]
        section = "Inbox" if last in _INBOX else "Outbox" if last in _OUTBOX else "Registers"
        numbers = np.atleast_1d(values[cell]).ravel().tolist()
        if section != "Registers" and len(numbers) == len(SIDES):
            rows = [_row(f"{name} {side}", number) for side, number in zip(SIDES, numbers, strict=True)]
            sections[section] += rows
        else:
            sections[section].append(_row(name, numbers if len(numbers) > 1 else numbers[0]))
    note = f"after {time_s:.3f} s"
    return [{"name": name, "note": note, "rows": rows} for name, rows in sections.items() if rows]


def _message_rows(registers: Mapping[str, NDArray[Any]], sender: int, side: int, label: str) -> list[Row]:
    """Return a row for each field of the message that a cell sent to a side; one row if it sent none."""
    sent = registers.get(f"{MESSAGES}sent")
    if sent is None:
        return []
    if not sent[sender, side] > 0:  # or not a number, of a dead cell
        return [_row(label, "none")]
    rows: list[Row] = []
    for name, values in registers.items():
        if name.startswith(MESSAGES) and name != f"{MESSAGES}sent":
            numbers = values[sender].reshape(len(SIDES), -1)[side].tolist()
            field = name.removeprefix(MESSAGES)
            rows.append(_row(f"{label} {field}", numbers if len(numbers) > 1 else numbers[0]))
    return rows


def parcel_facts(
    source: RunSource,
    grid: CellGrid,
    instant: Instant,
    parcel: int,
    loads_n: Sequence[float],
    outcome: str | None = None,
) -> dict[str, Any]:
    """Return the facts on a parcel: pose, velocity, supports and their loads.

    Args:
        source: The run.
        grid: Places of its cells.
        instant: The instant.
        parcel: Number of the parcel.
        loads_n: ``(n,)`` load of every cell, N; NaN where it is unknown.
        outcome: Outcome of the parcel, after which it has no supports; None: it has none yet.
    """
    pose = instant.parcels[parcel].tolist()
    footprint = np.array(source.header["footprints_m"][parcel])
    under = supports(footprint, instant.parcels[parcel], grid.centres)[: None if outcome is None else 0]
    there = outcome or ("" if np.isfinite(pose).all() else "not on the array")
    names = [source.header["cells"][int(cell)] for cell in under]
    rows = [
        _row("x", pose[0], "m"),
        _row("y", pose[1], "m"),
        _row("angle", pose[2], "rad"),
    ]
    moving = [_row("velocity", pose[3:5], "m/s"), _row("spin", pose[5], "rad/s")]
    held = [
        _row(f"{row},{column}", float(loads_n[int(cell)]), "N")
        for cell, (row, column) in zip(under, names, strict=True)
    ]
    return {
        "kind": "parcel",
        "title": f"Parcel {parcel}, {there}" if there else f"Parcel {parcel}",
        "number": parcel,
        "sections": [
            {"name": "Pose", "rows": rows},
            {"name": "Velocity", "rows": moving},
            {"name": f"Supports ({len(names)})", "rows": held},
        ],
        "neighbours": [],
        "faults": [],
    }


def _row(name: str, value: object, unit: str = "") -> Row:
    """Return a line of the inspector; numbers that are not finite become None, long integers their digits."""
    if isinstance(value, list):
        value = [_number(part) for part in cast("list[object]", value)]
    return {"name": name, "value": _number(value), "unit": unit}


def _number(value: object) -> object:
    if isinstance(value, int) and abs(value) > _EXACT:
        return str(value)
    return None if isinstance(value, float) and not np.isfinite(value) else value
