"""The form of one key a cell and link: maps that any tool reads, for cells in processes of their own."""

from __future__ import annotations

import contextlib
import struct
from typing import Any, Final, final

import numpy as np

from bus import codec, wire
from bus.forms.form import HostForm, MemberForm, Wiring
from bus.keys import cell_key, cell_link_key

_SENSE: Final = codec.layout("presence", "encoder_m")
_DRIVE: Final = codec.layout("drive")
_NO_MESSAGE: Final = codec.layout()
_VALUE: Final = 80
"""Bytes that one named value of a payload may take, its name included up to four fifths of that."""

_read_sense = codec.reader("sense", _VALUE, _SENSE)
_read_drive = codec.reader("drive", _VALUE, _DRIVE)
_PAIR: Final = struct.Struct("<2d")


def _pairs(values: list[bytes]) -> codec.Values:
    """``(n, 2)`` from packed pairs; may be written."""
    return np.frombuffer(bytearray().join(values)).reshape(len(values), 2)


@final
class CellsHost(HostForm):
    """The plant's side: a unit is a cell."""

    def __init__(self, wiring: Wiring) -> None:
        self._pack = codec.packer()
        cells, run = wiring.partition.lattice.cells, wiring.run
        self._sensors = wiring.sensors
        self._weights = 1 << np.arange(wiring.sensors)
        self.unit_cells = tuple(np.array([i], dtype=np.int64) for i in range(len(cells)))
        self.sense_keys = tuple(cell_key(run, cell, "sense") for cell in cells)
        self.drive_units = {cell_key(run, cell, "drive"): i for i, cell in enumerate(cells)}
        self.alive_units = {cell_key(run, cell, "alive"): i for i, cell in enumerate(cells)}
        self.ready_units = {cell_key(run, cell, "ready"): i for i, cell in enumerate(cells)}
        self.drive_expr = cell_key(run, None, "drive")
        self.alive_expr = cell_key(run, None, "alive")
        self.ready_expr = cell_key(run, None, "ready")
        self.blank_drives = [bytes(_PAIR.size)] * len(cells)

    def sense_payloads(self, frame: wire.SenseFrame) -> list[bytes]:
        """A payload a cell: ``{"presence": [bool, ...], "encoder_m": [x, y] | nil}``."""
        tick = frame.tick
        if frame.encoder_m is not None:
            return [
                self._pack(tick, {"presence": presence, "encoder_m": travel})
                for presence, travel in zip(frame.presence.tolist(), frame.encoder_m.tolist(), strict=True)
            ]
        # Without encoders all cells that sense alike get the same bytes: encode each pattern once.
        made: dict[int, bytes] = {}
        payloads: list[bytes] = []
        for code in (frame.presence @ self._weights).tolist():
            payload = made.get(code)
            if payload is None:
                presence = [bool(code >> i & 1) for i in range(self._sensors)]
                payload = made[code] = self._pack(tick, {"presence": presence, "encoder_m": None})
            payloads.append(payload)
        return payloads

    def decode_drive(self, unit: int, payload: bytes) -> tuple[int, Any]:  # noqa: ARG002 - all cells alike
        """Tick and the cell's two drives."""
        tick, fields = _read_drive(payload)
        return tick, _PAIR.pack(*codec.pair("drive", fields["drive"]))

    def join_drives(self, values: list[Any]) -> codec.Values:
        """``(n, 2)`` from a pair a cell."""
        return _pairs(values)


@final
class CellsMember(MemberForm):
    """A shard's side: a unit a cell, a part a link."""

    def __init__(self, wiring: Wiring, shard: int) -> None:
        self._pack = codec.packer()
        partition, run = wiring.partition, wiring.run
        cells = partition.lattice.cells
        mine = partition.cells(shard)
        names = [cells[int(i)] for i in mine]
        self._sensors = wiring.sensors
        self._encoders = wiring.encoders
        self.alive_keys = tuple(cell_key(run, cell, "alive") for cell in names)
        self.ready_keys = tuple(cell_key(run, cell, "ready") for cell in names)
        self.drive_keys = tuple(cell_key(run, cell, "drive") for cell in names)
        self.unit_cells = tuple(np.array([i], dtype=np.int64) for i in mine)
        self.sense_units = {cell_key(run, cell, "sense"): i for i, cell in enumerate(names)}
        self.blank_senses = [(bytes(wiring.sensors), bytes(_PAIR.size))] * len(names)
        self._message = _MessageMap(wiring.message)
        incoming, outgoing = partition.incoming(shard), partition.outgoing(shard)
        heard = range(0 if wiring.message is None else len(incoming))
        said = range(0 if wiring.message is None else len(outgoing))
        self.in_parts = {
            cell_link_key(run, cells[int(incoming.source[i])], int(incoming.source_side[i])): i for i in heard
        }
        self.in_sources = tuple(incoming.source[i : i + 1] for i in heard)
        self.in_targets = tuple(incoming.target[i : i + 1] for i in heard)
        self.blank_links = [self._message.nothing] * len(heard)
        self.out_keys = tuple(
            cell_link_key(run, cells[int(outgoing.source[i])], int(outgoing.source_side[i])) for i in said
        )
        self.out_sources = tuple(outgoing.source[i : i + 1] for i in said)
        self.out_targets = tuple(outgoing.target[i : i + 1] for i in said)

    def decode_sense(self, unit: int, payload: bytes) -> tuple[int, Any]:  # noqa: ARG002 - all cells alike
        """Tick, and the cell's presence bits with its encoder travel or None."""
        tick, fields = _read_sense(payload)
        presence = bytes(codec.booleans("sense", fields["presence"], self._sensors))
        if self._encoders:
            return tick, (presence, _PAIR.pack(*codec.pair("sense", fields["encoder_m"])))
        codec.nothing("sense", "encoder_m", fields["encoder_m"])
        return tick, (presence, None)

    def join_senses(self, values: list[Any]) -> tuple[codec.Mask, codec.Values | None]:
        """From a pair a cell."""
        bits = bytearray().join([presence for presence, _ in values])
        presence = np.frombuffer(bits, np.bool_).reshape(len(values), self._sensors)
        return presence, _pairs([pair for _, pair in values]) if self._encoders else None

    def decode_link(self, part: int, payload: bytes) -> tuple[int, Any]:
        """Tick, and whether there is a message with its values."""
        return self._message.decode(part, payload)

    def join_links(self, values: list[Any]) -> tuple[codec.Mask, codec.Message]:
        """From a pair a link."""
        return self._message.join(values)

    def drive_payloads(self, frame: wire.DriveFrame) -> list[bytes]:
        """A payload a cell: ``{"drive": [a, b]}``."""
        tick, pack = frame.tick, self._pack
        return [pack(tick, {"drive": pair}) for pair in _PAIR.iter_unpack(frame.drive.tobytes())]

    def link_payloads(self, frame: wire.LinkFrame) -> list[bytes]:
        """A payload a link: the message's fields by name, none where nothing was sent."""
        return self._message.encode(frame)


@final
class _MessageMap:
    """A protocol's messages as maps of their fields; between map and array they go as packed bytes.

    Attributes:
        nothing: What stands for no message: not sent, and zero.
    """

    def __init__(self, dtype: np.dtype[Any] | None) -> None:
        self._pack_map = codec.packer()
        self._dtype = np.dtype([]) if dtype is None else dtype
        names = self._dtype.names or ()
        self._names = names
        fields = [self._dtype[name] for name in names]
        self._struct = struct.Struct(
            "<" + "".join("?" if field.kind == "b" else field.char for field in fields)
        )
        self._types = [{"b": bool, "f": float}.get(field.kind, int) for field in fields]
        self._readers = [codec.scalar_reader("link", *pair) for pair in zip(names, fields, strict=True)]
        limit = sum(_VALUE + 4 * len(name) for name in names)
        self._read = codec.reader("link", limit, codec.layout(*names), _NO_MESSAGE)
        self.nothing: tuple[bool, bytes] = (False, bytes(self._dtype.itemsize))

    def encode(self, frame: wire.LinkFrame) -> list[bytes]:
        tick, names, pack = frame.tick, self._names, self._pack_map
        if not names:
            return []
        return [
            pack(tick, dict(zip(names, values, strict=True)) if sent else {})
            for sent, values in zip(
                frame.sent.tobytes(), self._struct.iter_unpack(frame.message.tobytes()), strict=True
            )
        ]

    def decode(self, part: int, payload: bytes) -> tuple[int, tuple[bool, bytes]]:  # noqa: ARG002 - all links alike
        tick, fields = self._read(payload)
        if len(fields) == len(_NO_MESSAGE):
            return tick, self.nothing
        values = [fields[name] for name in self._names]
        if [type(value) for value in values] == self._types:
            with contextlib.suppress(struct.error, OverflowError):  # The readers know what is wrong.
                return tick, (True, self._struct.pack(*values))
        read = [reader(value) for reader, value in zip(self._readers, values, strict=True)]
        return tick, (True, self._struct.pack(*read))

    def join(self, values: list[tuple[bool, bytes]]) -> tuple[codec.Mask, codec.Message]:
        sent = np.frombuffer(bytearray([there for there, _ in values]), np.bool_)
        message = bytearray().join([message for _, message in values])
        return sent, np.frombuffer(message, self._dtype)
