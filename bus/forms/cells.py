"""The form of one key a cell and link: maps that any tool reads, for cells in processes of their own.

Between map and array the values go as packed bytes. Where every cell is a process, each of these lines runs on
cold caches every tick: hence few calls, and a short way for payloads as this side lays them out.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any, Final, final

import numpy as np

from bus import codec, wire
from bus.fixed import Decode, Fixed, Place, flags
from bus.forms.form import HostForm, MemberForm, Senses, Wiring
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
_Sensed = tuple[bytes, bytes, bytes]
"""Of a cell: presence a byte each, travel and levels packed, empty where there are none."""
_DRIVE: Final[dict[str, Place]] = {"drive": ("d", "d")}

_read_sense = codec.reader("sense", _VALUE, codec.layout("presence", "encoder_m"))
_read_levels = codec.reader("sense", 2 * _VALUE, codec.layout("presence", "encoder_m", "level"))
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
        """A payload a cell: ``{"presence": [bool, ...], "encoder_m": [x, y] | nil}``, and ``"level": [x, ...]``."""
        tick, write, sensors = frame.tick, self._sense.write, self._sensors
        there = frame.presence.tobytes()
        presence = [there[i : i + sensors] for i in range(0, len(there), sensors)]
        if frame.level is not None:
            parts = [frame.level] if frame.encoder_m is None else [frame.encoder_m, frame.level]
            numbers = np.concatenate(parts, axis=1).tolist()
            return write(tick, [(bits, *row) for bits, row in zip(presence, numbers, strict=True)])
        if frame.encoder_m is not None:
            travel = frame.encoder_m.tolist()
            return write(tick, [(bits, x, y) for bits, (x, y) in zip(presence, travel, strict=True)])
        # Without encoders all cells that sense alike get the same bytes: encode each pattern once.
        patterns = list(set(presence))
        made = dict(zip(patterns, write(tick, [(bits,) for bits in patterns]), strict=True))
        return [made[bits] for bits in presence]

    def join_drives(self, values: list[Any]) -> codec.Values:
        """``(n, 2)`` from a packed pair a cell."""
        return np.ndarray((len(values), 2), np.float64, bytearray().join(values))


def _sense_places(wiring: Wiring) -> dict[str, Place]:
    places: dict[str, Place] = {
        "presence": wiring.sensors,
        "encoder_m": ("d", "d") if wiring.encoders else None,
    }
    return places | {"level": ("d",) * wiring.sensors} if wiring.levels else places


def _drive_decoder() -> Decode:
    """From a drive payload to its tick and the drive as a packed pair."""

    def decode(unit: int, payload: bytes) -> tuple[int, bytes]:  # noqa: ARG001 - all cells alike
        tick, fields = _read_drive(payload)
        return tick, _PAIR.pack(*codec.pair("drive", fields["drive"]))

    return Fixed(_DRIVE).decoder(_finite_pair, decode)


def _finite_pair(first: float, second: float) -> bytes | None:
    # Only a finite number minus itself is zero.
    return _PAIR.pack(first, second) if first - first == second - second == 0.0 else None


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
        self._levels = wiring.levels
        self.alive_keys = tuple(cell_key(run, cell, "alive") for cell in names)
        self.ready_keys = tuple(cell_key(run, cell, "ready") for cell in names)
        self.drive_keys = tuple(cell_key(run, cell, "drive") for cell in names)
        self.unit_cells = tuple(np.array([i], dtype=np.int64) for i in mine)
        self.sense_units = {cell_key(run, cell, "sense"): i for i, cell in enumerate(names)}
        self.decode_sense = _sense_decoder(wiring)
        self.blank_senses = [(bytes(wiring.sensors), bytes(_PAIR.size), bytes(8 * wiring.sensors))] * len(
            names
        )
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
        self.blank_links = [b""] * len(heard)
        self._no_message = bytes(message.itemsize)
        self._message = message
        self._fields = _struct(message, "1s").iter_unpack
        self._drive, self._link, self._silence = Fixed(_DRIVE), Fixed(_link_places(message)), Fixed({})
        self.out_keys = tuple(
            cell_link_key(run, cells[int(outgoing.source[i])], int(outgoing.source_side[i])) for i in said
        )
        self.out_sources = tuple(outgoing.source[i : i + 1] for i in said)
        self.out_targets = tuple(outgoing.target[i : i + 1] for i in said)

    def join_senses(self, values: list[Any]) -> Senses:
        """From the presence bytes, the packed travel and the packed levels of each cell."""
        bits, travel, levels = zip(*values, strict=True)
        each = (self._rows, self._sensors)
        presence, encoder_m, level = np.ndarray(each, np.bool_, bytearray().join(bits)), None, None
        if self._encoders:
            encoder_m = np.ndarray((self._rows, 2), np.float64, bytearray().join(travel))
        if self._levels:
            level = np.ndarray(each, np.float64, bytearray().join(levels))
        return Senses(presence, encoder_m, level)

    def join_links(self, values: list[Any]) -> tuple[codec.Mask, codec.Message]:
        """From the packed message of each link, empty where there was none."""
        sent = bytearray(map(bool, values))
        if 0 in sent:
            values = [value or self._no_message for value in values]
        return np.frombuffer(sent, np.bool_), np.frombuffer(bytearray().join(values), self._message)

    def drive_payloads(self, frame: wire.DriveFrame) -> list[bytes]:
        """A payload a cell: ``{"drive": [a, b]}``."""
        pairs = list(_PAIR.iter_unpack(frame.drive.tobytes()))
        for first, second in pairs:
            codec.check_finite("drive", first, second)
        return self._drive.write(frame.tick, pairs)

    def link_payloads(self, frame: wire.LinkFrame) -> list[bytes]:
        """A payload a link: the message's fields by name, none where nothing was sent."""
        sent = frame.sent.tobytes()
        payloads = self._link.write(frame.tick, self._fields(frame.message.tobytes()))
        if 0 in sent:
            (silence,) = self._silence.write(frame.tick, [()])
            payloads = [payload if said else silence for payload, said in zip(payloads, sent, strict=True)]
        return payloads


def _sense_decoder(wiring: Wiring) -> Decode:
    """From a sense payload to its tick, the presence as bytes, and travel and levels packed."""
    sensors, encoders, levels = wiring.sensors, wiring.encoders, wiring.levels
    read, pack = _read_levels if levels else _read_sense, struct.Struct(f"<{sensors}d").pack

    def decode(unit: int, payload: bytes) -> tuple[int, _Sensed]:  # noqa: ARG001 - all cells alike
        tick, fields = read(payload)
        presence, travel, level = bytes(codec.booleans("sense", fields["presence"], sensors)), b"", b""
        if encoders:
            travel = _PAIR.pack(*codec.pair("sense", fields["encoder_m"]))
        else:
            codec.nothing("sense", "encoder_m", fields["encoder_m"])
        if levels:
            level = pack(*codec.share_list("sense", fields["level"], sensors))
        return tick, (presence, travel, level)

    def with_levels(marks: bytes, *numbers: float) -> _Sensed | None:
        presence, level = flags(marks), numbers[-sensors:]
        travel = _finite_pair(*numbers[:2]) if encoders else b""
        if presence is None or travel is None or not all(0.0 <= one <= 1.0 for one in level):
            return None
        return presence, travel, pack(*level)

    short = with_levels if levels else _sensed if encoders else _present
    return Fixed(_sense_places(wiring)).decoder(short, decode)


def _sensed(marks: bytes, x: float, y: float) -> _Sensed | None:
    presence, travel = flags(marks), _finite_pair(x, y)
    return None if presence is None or travel is None else (presence, travel, b"")


def _present(marks: bytes) -> _Sensed | None:
    presence = flags(marks)
    return None if presence is None else (presence, b"", b"")


def _link_decoder(message: np.dtype[Any]) -> Decode:
    """From a link payload to its tick and the message's packed fields, empty where nothing was sent."""
    silence = Fixed({}).decoder(bytes, _any_link_decoder(message))
    return Fixed(_link_places(message)).decoder(_message_packer(message), silence)


def _message_packer(message: np.dtype[Any]) -> Callable[..., bytes | None]:
    """From a message's values as they come to its packed fields."""
    letters = _letters(message).values()
    packed = _struct(message, "1s")
    if not {"?", "e"} & set(letters):
        return packed.pack
    booleans = [letter == "?" for letter in letters]

    def pack(*values: Any) -> bytes | None:
        made = [flags(value) if is_flag else value for value, is_flag in zip(values, booleans, strict=True)]
        try:
            return None if None in made else packed.pack(*made)
        except OverflowError:  # Half a float does not hold it.
            return None

    return pack


def _any_link_decoder(message: np.dtype[Any]) -> Decode:
    """As ``_link_decoder``, whatever the layout."""
    names = message.names or ()
    pack = _struct(message, "?").pack
    readers = [codec.scalar_reader("link", name, message[name]) for name in names]
    limit = sum(_VALUE + 4 * len(name) for name in names)
    read = codec.reader("link", limit, codec.layout(*names), _NO_MESSAGE)

    def decode(part: int, payload: bytes) -> tuple[int, bytes]:  # noqa: ARG001 - all links alike
        tick, fields = read(payload)
        if len(fields) == len(_NO_MESSAGE):
            return tick, b""
        return tick, pack(*[reader(fields[name]) for name, reader in zip(names, readers, strict=True)])

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
