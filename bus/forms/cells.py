"""The form of one key a cell and link: maps that any tool reads, for cells in processes of their own.

Between map and array the values go as packed bytes. Where every cell is a process, each of these lines runs on
cold caches every tick: hence few calls.
"""

from __future__ import annotations

import struct
from typing import Any, Final, final

import numpy as np

from bus import codec, wire
from bus.forms.form import Decode, HostForm, MemberForm, Wiring
from bus.keys import cell_key, cell_link_key

_VALUE: Final = 80
"""Bytes that one named value of a payload may take, its name included up to four fifths of that."""
_PAIR: Final = struct.Struct("<2d")
_LETTERS: Final = {
    "b1": "?", "i1": "b", "i2": "h", "i4": "i", "i8": "q", "u1": "B", "u2": "H", "u4": "I", "u8": "Q",
    "f2": "e", "f4": "f", "f8": "d",
}  # fmt: skip
"""The struct module's letter for each kind of field and its size."""
_NO_MESSAGE: Final = codec.layout()

_read_sense = codec.reader("sense", _VALUE, codec.layout("presence", "encoder_m"))
_read_drive = codec.reader("drive", _VALUE, codec.layout("drive"))


@final
class CellsHost(HostForm):
    """The plant's side: a unit is a cell."""

    def __init__(self, wiring: Wiring) -> None:
        cells, run = wiring.partition.lattice.cells, wiring.run
        self._pack = codec.packer()
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
        self.decode_drive = _decode_drive
        self.blank_drives = [bytes(_PAIR.size)] * len(cells)

    def sense_payloads(self, frame: wire.SenseFrame) -> list[bytes]:
        """A payload a cell: ``{"presence": [bool, ...], "encoder_m": [x, y] | nil}``."""
        tick, pack = frame.tick, self._pack
        if frame.encoder_m is not None:
            return [
                pack({"v": codec.VERSION, "tick": tick, "presence": presence, "encoder_m": travel})
                for presence, travel in zip(frame.presence.tolist(), frame.encoder_m.tolist(), strict=True)
            ]
        # Without encoders all cells that sense alike get the same bytes: encode each pattern once.
        made: dict[int, bytes] = {}
        payloads: list[bytes] = []
        for code in (frame.presence @ self._weights).tolist():
            payload = made.get(code)
            if payload is None:
                presence = [bool(code >> i & 1) for i in range(self._sensors)]
                payload = pack({"v": codec.VERSION, "tick": tick, "presence": presence, "encoder_m": None})
                made[code] = payload
            payloads.append(payload)
        return payloads

    def join_drives(self, values: list[Any]) -> codec.Values:
        """``(n, 2)`` from a packed pair a cell."""
        return np.ndarray((len(values), 2), np.float64, bytearray().join(values))


def _decode_drive(unit: int, payload: bytes) -> tuple[int, bytes]:  # noqa: ARG001 - all cells alike
    tick, fields = _read_drive(payload)
    return tick, _PAIR.pack(*codec.pair("drive", fields["drive"]))


@final
class CellsMember(MemberForm):
    """A shard's side: a unit a cell, a part a link."""

    def __init__(self, wiring: Wiring, shard: int) -> None:
        partition, run = wiring.partition, wiring.run
        cells = partition.lattice.cells
        mine = partition.cells(shard)
        names = [cells[int(i)] for i in mine]
        self._pack = codec.packer()
        self._rows = len(names)
        self._sensors = wiring.sensors
        self._encoders = wiring.encoders
        self.alive_keys = tuple(cell_key(run, cell, "alive") for cell in names)
        self.ready_keys = tuple(cell_key(run, cell, "ready") for cell in names)
        self.drive_keys = tuple(cell_key(run, cell, "drive") for cell in names)
        self.unit_cells = tuple(np.array([i], dtype=np.int64) for i in mine)
        self.sense_units = {cell_key(run, cell, "sense"): i for i, cell in enumerate(names)}
        self.decode_sense = _sense_decoder(wiring.sensors, wiring.encoders)
        self.blank_senses = [(bytes(wiring.sensors), bytes(_PAIR.size))] * len(names)
        message = np.dtype([]) if wiring.message is None else wiring.message
        incoming, outgoing = partition.incoming(shard), partition.outgoing(shard)
        heard = range(0 if wiring.message is None else len(incoming))
        said = range(0 if wiring.message is None else len(outgoing))
        self.in_parts = {
            cell_link_key(run, cells[int(incoming.source[i])], int(incoming.source_side[i])): i for i in heard
        }
        self.in_sources = tuple(incoming.source[i : i + 1] for i in heard)
        self.in_targets = tuple(incoming.target[i : i + 1] for i in heard)
        self.decode_link = _link_decoder(message)
        self.blank_links = [(0, bytes(message.itemsize))] * len(heard)
        self._message = message
        self._names = message.names or ()
        self._struct = _struct(message)
        self.out_keys = tuple(
            cell_link_key(run, cells[int(outgoing.source[i])], int(outgoing.source_side[i])) for i in said
        )
        self.out_sources = tuple(outgoing.source[i : i + 1] for i in said)
        self.out_targets = tuple(outgoing.target[i : i + 1] for i in said)

    def join_senses(self, values: list[Any]) -> tuple[codec.Mask, codec.Values | None]:
        """From the presence bytes and the packed travel of each cell."""
        bits, travel = zip(*values, strict=True)
        presence = np.ndarray((self._rows, self._sensors), np.bool_, bytearray().join(bits))
        if not self._encoders:
            return presence, None
        return presence, np.ndarray((self._rows, 2), np.float64, bytearray().join(travel))

    def join_links(self, values: list[Any]) -> tuple[codec.Mask, codec.Message]:
        """From whether there was a message, and its packed fields, of each link."""
        sent, message = zip(*values, strict=True) if values else ((), ())
        return np.frombuffer(bytearray(sent), np.bool_), np.frombuffer(
            bytearray().join(message), self._message
        )

    def drive_payloads(self, frame: wire.DriveFrame) -> list[bytes]:
        """A payload a cell: ``{"drive": [a, b]}``."""
        tick, pack = frame.tick, self._pack
        payloads: list[bytes] = []
        for pair in _PAIR.iter_unpack(frame.drive.tobytes()):
            codec.check_finite("drive", *pair)
            payloads.append(pack({"v": codec.VERSION, "tick": tick, "drive": pair}))
        return payloads

    def link_payloads(self, frame: wire.LinkFrame) -> list[bytes]:
        """A payload a link: the message's fields by name, none where nothing was sent."""
        tick, names, pack = frame.tick, self._names, self._pack
        fields = self._struct.iter_unpack(frame.message.tobytes())
        return [
            pack(
                {"v": codec.VERSION, "tick": tick, **(dict(zip(names, values, strict=True)) if sent else {})}
            )
            for sent, values in zip(frame.sent.tobytes(), fields, strict=True)
        ]


def _sense_decoder(sensors: int, encoders: bool) -> Decode:
    """From a sense payload to its tick, the presence as bytes and the travel as a packed pair."""

    def decode(unit: int, payload: bytes) -> tuple[int, tuple[bytes, bytes]]:  # noqa: ARG001 - all cells alike
        tick, fields = _read_sense(payload)
        presence = bytes(codec.booleans("sense", fields["presence"], sensors))
        if encoders:
            return tick, (presence, _PAIR.pack(*codec.pair("sense", fields["encoder_m"])))
        codec.nothing("sense", "encoder_m", fields["encoder_m"])
        return tick, (presence, b"")

    return decode


def _link_decoder(message: np.dtype[Any]) -> Decode:
    """From a link payload to its tick, 1 or 0 for sent or not, and the message's packed fields."""
    names = message.names or ()
    packed = _struct(message)
    kinds = tuple({"b": bool, "f": float}.get(message[name].kind, int) for name in names)
    readers = [codec.scalar_reader("link", name, message[name]) for name in names]
    limit = sum(_VALUE + 4 * len(name) for name in names)
    read = codec.reader("link", limit, codec.layout(*names), _NO_MESSAGE)
    nothing = (0, bytes(message.itemsize))

    def decode(part: int, payload: bytes) -> tuple[int, tuple[int, bytes]]:  # noqa: ARG001 - all links alike
        tick, fields = read(payload)
        if len(fields) == len(_NO_MESSAGE):
            return tick, nothing
        values = tuple(map(fields.__getitem__, names))
        if tuple(map(type, values)) == kinds:
            try:
                return tick, (1, packed.pack(*values))
            except (struct.error, OverflowError):
                pass  # The readers say what is wrong.
        return tick, (1, packed.pack(*[reader(value) for reader, value in zip(readers, values, strict=True)]))

    return decode


def _struct(message: np.dtype[Any]) -> struct.Struct:
    """The layout of a message, for the struct module, whose letters mean other sizes than NumPy's."""
    fields = [message[name] for name in message.names or ()]
    return struct.Struct("<" + "".join(_LETTERS[field.kind + str(field.itemsize)] for field in fields))
