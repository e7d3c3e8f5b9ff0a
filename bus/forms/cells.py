"""The form of one key a cell and link: maps that any tool reads, for cells in processes of their own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, final

import numpy as np

from bus import wire
from bus.errors import WireError
from bus.forms.form import HostForm, MemberForm, Wiring
from bus.keys import cell_key, cell_link_key

_SENSE: Final = frozenset(("presence", "encoder_m"))
_DRIVE: Final = frozenset(("drive",))
_NOTHING: Final = frozenset[str]()
_VALUE: Final = 80
"""Bytes that one named value may take, its name (beyond that counted apart) and msgpack's marks included."""


@final
class CellsHost(HostForm):
    """The plant's side: a unit is a cell."""

    def __init__(self, wiring: Wiring) -> None:
        cells, run = wiring.partition.lattice.cells, wiring.run
        self._sensors = wiring.sensors
        self._weights = 1 << np.arange(wiring.sensors)
        self.unit_cells = tuple(np.array([i], dtype=np.int64) for i in range(len(cells)))
        self.unit_rows = tuple(range(len(cells)))
        self.sense_keys = tuple(cell_key(run, cell, "sense") for cell in cells)
        self.drive_units = {cell_key(run, cell, "drive"): i for i, cell in enumerate(cells)}
        self.alive_units = {cell_key(run, cell, "alive"): i for i, cell in enumerate(cells)}
        self.ready_units = {cell_key(run, cell, "ready"): i for i, cell in enumerate(cells)}
        self.drive_expr = cell_key(run, None, "drive")
        self.alive_expr = cell_key(run, None, "alive")
        self.ready_expr = cell_key(run, None, "ready")

    def sense_payloads(self, frame: wire.SenseFrame) -> list[bytes]:
        """A payload a cell: ``{"presence": [bool, ...], "encoder_m": [x, y] | nil}``."""
        tick = frame.tick
        if frame.encoder_m is not None:
            return [
                wire.pack(tick, {"presence": presence, "encoder_m": travel})
                for presence, travel in zip(frame.presence.tolist(), frame.encoder_m.tolist(), strict=True)
            ]
        # Without encoders all cells that sense alike get the same bytes: encode each pattern once.
        made: dict[int, bytes] = {}
        payloads: list[bytes] = []
        for code in (frame.presence @ self._weights).tolist():
            payload = made.get(code)
            if payload is None:
                presence = [bool(code >> i & 1) for i in range(self._sensors)]
                payload = made[code] = wire.pack(tick, {"presence": presence, "encoder_m": None})
            payloads.append(payload)
        return payloads

    def decode_drive(self, unit: int, payload: bytes) -> tuple[int, Any]:  # noqa: ARG002 - all cells alike
        """Tick and the cell's two drives."""
        tick, fields = wire.unpack("drive", payload, _VALUE, _DRIVE)
        return tick, wire.pair("drive", fields["drive"])


@final
class CellsMember(MemberForm):
    """A shard's side: a unit a cell, a part a link."""

    def __init__(self, wiring: Wiring, shard: int) -> None:
        partition, run = wiring.partition, wiring.run
        lattice = partition.lattice
        mine = partition.cells(shard)
        names = [lattice.cells[int(i)] for i in mine]
        self._sensors = wiring.sensors
        self._encoders = wiring.encoders
        self.alive_keys = tuple(cell_key(run, cell, "alive") for cell in names)
        self.ready_keys = tuple(cell_key(run, cell, "ready") for cell in names)
        self.drive_keys = tuple(cell_key(run, cell, "drive") for cell in names)
        self.unit_cells = tuple(np.array([i], dtype=np.int64) for i in mine)
        self.unit_rows = tuple(range(len(mine)))
        self.sense_units = {cell_key(run, cell, "sense"): i for i, cell in enumerate(names)}
        self._message = _MessageMap(wiring.message)
        incoming, outgoing = partition.incoming(shard), partition.outgoing(shard)
        heard = range(0 if wiring.message is None else len(incoming))
        said = range(0 if wiring.message is None else len(outgoing))
        self.in_parts = {
            cell_link_key(run, lattice.cells[int(incoming.source[i])], int(incoming.source_side[i])): i
            for i in heard
        }
        self.in_links = tuple(heard)
        self.in_sources = tuple(incoming.source[i : i + 1] for i in heard)
        self.out_keys = tuple(
            cell_link_key(run, lattice.cells[int(outgoing.source[i])], int(outgoing.source_side[i]))
            for i in said
        )
        self.out_links = tuple(said)
        self.out_sources = tuple(outgoing.source[i : i + 1] for i in said)
        self.out_targets = tuple(outgoing.target[i : i + 1] for i in said)

    def decode_sense(self, unit: int, payload: bytes) -> tuple[int, Any, Any]:  # noqa: ARG002 - all cells alike
        """Tick, the cell's presence bits, its encoder travel or None."""
        tick, fields = wire.unpack("sense", payload, _VALUE, _SENSE)
        presence = wire.booleans("sense", fields["presence"], self._sensors)
        travel = fields["encoder_m"]
        if self._encoders:
            return tick, presence, wire.pair("sense", travel)
        if travel is not None:
            raise WireError("sense", "type", "encoder_m must be nil: there are no encoders")
        return tick, presence, None

    def decode_link(self, part: int, payload: bytes) -> tuple[int, Any, Any]:  # noqa: ARG002 - all links alike
        """Tick, whether there is a message, and its values."""
        return self._message.decode(payload)

    def drive_payloads(self, frame: wire.DriveFrame) -> list[bytes]:
        """A payload a cell: ``{"drive": [a, b]}``."""
        return [wire.pack(frame.tick, {"drive": pair}) for pair in frame.drive.tolist()]

    def link_payloads(self, frame: wire.LinkFrame) -> list[bytes]:
        """A payload a link: the message's fields by name, none where nothing was sent."""
        return self._message.encode(frame)


@final
class _MessageMap:
    """A protocol's messages as maps of their fields."""

    def __init__(self, dtype: np.dtype[Any] | None) -> None:
        names = () if dtype is None or dtype.names is None else dtype.names
        self._order = names
        self._names = frozenset(names)
        self._limit = sum(_VALUE + 4 * len(name) for name in names)
        self._readers: tuple[Callable[[object], Any], ...] = (
            () if dtype is None else tuple(wire.scalar_reader("link", name, dtype[name]) for name in names)
        )
        self._zero: tuple[Any, ...] = () if dtype is None else np.zeros((), dtype=dtype).item()

    def encode(self, frame: wire.LinkFrame) -> list[bytes]:
        tick, order = frame.tick, self._order
        return [
            wire.pack(tick, dict(zip(order, values, strict=True)) if sent else {})
            for sent, values in zip(frame.sent.tolist(), frame.message.tolist(), strict=True)
        ]

    def decode(self, payload: bytes) -> tuple[int, bool, tuple[Any, ...]]:
        tick, fields = wire.unpack("link", payload, self._limit, self._names, _NOTHING)
        if not fields:
            return tick, False, self._zero
        return (
            tick,
            True,
            tuple(read(fields[name]) for name, read in zip(self._order, self._readers, strict=True)),
        )
