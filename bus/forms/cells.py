"""The form of one key a cell and link: maps that any tool reads, for cells in processes of their own.

Between map and array the values go as packed bytes. Where every cell is a process, each of these lines runs on
cold caches every tick: hence few calls, and a short way for payloads as this side lays them out.
"""

from __future__ import annotations

import struct
from typing import Any, Final, final

import numpy as np

from bus import codec, wire
from bus.fixed import Fixed, Place
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
_DRIVE: Final[dict[str, Place]] = {"drive": ("d", "d")}

_read_sense = codec.reader("sense", _VALUE, codec.layout("presence", "encoder_m"))
_read_drive = codec.reader("drive", _VALUE, codec.layout("drive"))


@final
class CellsHost(HostForm):
    """The plant's side: a unit is a cell."""

    def __init__(self, wiring: Wiring) -> None:
        cells, run = wiring.partition.lattice.cells, wiring.run
        self._sensors = wiring.sensors
        self._sense = Fixed(_sense_places(wiring))
        self.unit_cells = tuple(np.array([i], dtype=np.int64) for i in range(len(cells)))
        self.sense_keys = tuple(cell_key(run, cell, "sense") for cell in cells)
        self.drive_units = {cell_key(run, cell, "drive"): i for i, cell in enumerate(cells)}
        self.alive_units = {cell_key(run, cell, "alive"): i for i, cell in enumerate(cells)}
        self.ready_units = {cell_key(run, cell, "ready"): i for i, cell in enumerate(cells)}
        self.drive_expr = cell_key(run, None, "drive")
        self.alive_expr = cell_key(run, None, "alive")
        self.ready_expr = cell_key(run, None, "ready")
        self.decode_drive = _drive_decoder()
        self.blank_drives = [bytes(_PAIR.size)] * len(cells)

    def sense_payloads(self, frame: wire.SenseFrame) -> list[bytes]:
        """A payload a cell: ``{"presence": [bool, ...], "encoder_m": [x, y] | nil}``."""
        tick, write, sensors = frame.tick, self._sense.write, self._sensors
        flags = frame.presence.tobytes()
        presence = [flags[i : i + sensors] for i in range(0, len(flags), sensors)]
        if frame.encoder_m is not None:
            travel = frame.encoder_m.tolist()
            return [write(tick, there, x, y) for there, (x, y) in zip(presence, travel, strict=True)]
        # Without encoders all cells that sense alike get the same bytes: encode each pattern once.
        made = {there: write(tick, there) for there in set(presence)}
        return [made[there] for there in presence]

    def join_drives(self, values: list[Any]) -> codec.Values:
        """``(n, 2)`` from a packed pair a cell."""
        return np.ndarray((len(values), 2), np.float64, bytearray().join(values))


def _sense_places(wiring: Wiring) -> dict[str, Place]:
    return {"presence": wiring.sensors, "encoder_m": ("d", "d") if wiring.encoders else None}


def _drive_decoder() -> Decode:
    """From a drive payload to its tick and the drive as a packed pair."""
    read, pack = Fixed(_DRIVE).read, _PAIR.pack

    def decode(unit: int, payload: bytes) -> tuple[int, bytes]:  # noqa: ARG001 - all cells alike
        values = read(payload)
        if values is not None:
            tick, first, second = values
            codec.check_finite("drive", first, second)
            return tick, pack(first, second)
        tick, fields = _read_drive(payload)
        return tick, pack(*codec.pair("drive", fields["drive"]))

    return decode


@final
class CellsMember(MemberForm):
    """A shard's side: a unit a cell, a part a link."""

    def __init__(self, wiring: Wiring, shard: int) -> None:
        partition, run = wiring.partition, wiring.run
        cells = partition.lattice.cells
        mine = partition.cells(shard)
        names = [cells[int(i)] for i in mine]
        self._rows = len(names)
        self._sensors = wiring.sensors
        self._encoders = wiring.encoders
        self.alive_keys = tuple(cell_key(run, cell, "alive") for cell in names)
        self.ready_keys = tuple(cell_key(run, cell, "ready") for cell in names)
        self.drive_keys = tuple(cell_key(run, cell, "drive") for cell in names)
        self.unit_cells = tuple(np.array([i], dtype=np.int64) for i in mine)
        self.sense_units = {cell_key(run, cell, "sense"): i for i, cell in enumerate(names)}
        self.decode_sense = _sense_decoder(wiring)
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
        self._fields = _struct(message, "1s").iter_unpack
        self._drive, self._link, self._silence = Fixed(_DRIVE), Fixed(_link_places(message)), Fixed({})
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
        tick, write = frame.tick, self._drive.write
        payloads: list[bytes] = []
        for first, second in _PAIR.iter_unpack(frame.drive.tobytes()):
            codec.check_finite("drive", first, second)
            payloads.append(write(tick, first, second))
        return payloads

    def link_payloads(self, frame: wire.LinkFrame) -> list[bytes]:
        """A payload a link: the message's fields by name, none where nothing was sent."""
        tick, say, hush = frame.tick, self._link.write, self._silence.write
        fields = self._fields(frame.message.tobytes())
        return [
            say(tick, *values) if sent else hush(tick)
            for sent, values in zip(frame.sent.tobytes(), fields, strict=True)
        ]


def _sense_decoder(wiring: Wiring) -> Decode:
    """From a sense payload to its tick, the presence as bytes and the travel as a packed pair."""
    sensors, encoders = wiring.sensors, wiring.encoders
    read, pack = Fixed(_sense_places(wiring)).read, _PAIR.pack

    def decode(unit: int, payload: bytes) -> tuple[int, tuple[bytes, bytes]]:  # noqa: ARG001 - all cells alike
        values = read(payload)
        if values is not None:
            if not encoders:
                return values[0], (values[1], b"")
            tick, presence, x, y = values
            codec.check_finite("sense", x, y)
            return tick, (presence, pack(x, y))
        tick, fields = _read_sense(payload)
        presence = bytes(codec.booleans("sense", fields["presence"], sensors))
        if encoders:
            return tick, (presence, pack(*codec.pair("sense", fields["encoder_m"])))
        codec.nothing("sense", "encoder_m", fields["encoder_m"])
        return tick, (presence, b"")

    return decode


def _link_decoder(message: np.dtype[Any]) -> Decode:
    """From a link payload to its tick, 1 or 0 for sent or not, and the message's packed fields."""
    read, silence = Fixed(_link_places(message)).read, Fixed({}).read
    pack, decode_any = _struct(message, "1s").pack, _any_link_decoder(message)
    nothing = (0, bytes(message.itemsize))

    def decode(part: int, payload: bytes) -> tuple[int, tuple[int, bytes]]:
        values = read(payload)
        if values is not None:
            try:
                return values[0], (1, pack(*values[1:]))
            except OverflowError:
                pass  # Half a float does not hold it; the other way says so.
        elif (values := silence(payload)) is not None:
            return values[0], nothing
        return decode_any(part, payload)

    return decode


def _any_link_decoder(message: np.dtype[Any]) -> Decode:
    """As ``_link_decoder``, whatever the layout."""
    names = message.names or ()
    pack = _struct(message, "?").pack
    readers = [codec.scalar_reader("link", name, message[name]) for name in names]
    limit = sum(_VALUE + 4 * len(name) for name in names)
    read = codec.reader("link", limit, codec.layout(*names), _NO_MESSAGE)
    nothing = (0, bytes(message.itemsize))

    def decode(part: int, payload: bytes) -> tuple[int, tuple[int, bytes]]:  # noqa: ARG001 - all links alike
        tick, fields = read(payload)
        if len(fields) == len(_NO_MESSAGE):
            return tick, nothing
        return tick, (1, pack(*[reader(fields[name]) for name, reader in zip(names, readers, strict=True)]))

    return decode


def _letters(message: np.dtype[Any]) -> dict[str, str]:
    """The struct module's letter for each field of a message; they mean other sizes than NumPy's."""
    fields = ((name, message[name]) for name in message.names or ())
    return {name: _LETTERS[field.kind + str(field.itemsize)] for name, field in fields}


def _link_places(message: np.dtype[Any]) -> dict[str, Place]:
    """A message in MessagePack, which has no half floats."""
    return {name: "f" if letter == "e" else letter for name, letter in _letters(message).items()}


def _struct(message: np.dtype[Any], boolean: str) -> struct.Struct:
    """The layout of a message, with booleans as Python's (``"?"``) or as a byte each (``"1s"``)."""
    return struct.Struct("<" + "".join(_letters(message).values()).replace("?", boolean))
