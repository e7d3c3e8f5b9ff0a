"""The format of one key a cell and link: maps that any tool reads, for cells in processes of their own.

Between map and array the values go as packed bytes. Where every cell is a process, each of these lines runs on
cold caches every tick: hence few calls, and a short way for payloads as this side lays them out.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from itertools import chain
from typing import Any, Final, final

import numpy as np

from bus.errors import WireError
from bus.sensors import CameraFrame, SensorSchema
from bus.wire import frames as wire
from bus.wire import msgpack_codec as codec
from bus.wire.fixed_layout import Decode, FieldLayout, FixedLayoutCodec, decode_booleans
from bus.wire.format import CoordinatorCodec, ParticipantCodec, RelayedLinks, RunSchema, Senses
from bus.wire.keys import cell_key, cell_link_key
from bus.wire.message_type import leaves

VALUE: Final = 80
"""Bytes that one named value of a payload may take, its name included up to four fifths of that."""
PAIR: Final = struct.Struct("<2d")
Sensed = tuple[bytes, bytes, bytes, int, CameraFrame | None]
"""Of a cell: presence a byte each; travel and levels packed, empty where there are none; its label; a picture."""


def blank(readings: SensorSchema) -> Sensed:
    """Return blank senses of a cell: no presence, zero travel, zero levels, no label, no camera frame."""
    return bytes(readings.sensors), bytes(PAIR.size), bytes(8 * readings.sensors), 0, None


def _places(readings: SensorSchema) -> dict[str, FieldLayout]:
    """Return the field layout of a sense payload without a camera frame."""
    places: dict[str, FieldLayout] = {
        "presence": readings.sensors,
        "encoder_m": ("d", "d") if readings.encoders else None,
    }
    if readings.levels:
        places["level"] = ("d",) * readings.sensors
    if readings.labels:
        places["label"] = "H"
    if readings.camera:
        places["picture"] = None
    return places


@final
class SenseWriter:
    """Encoder of the cells' sense payloads; for one thread at a time.

    Args:
        readings: Sensors of the cells.
    """

    def __init__(self, readings: SensorSchema) -> None:
        self._readings = readings
        self._fixed = FixedLayoutCodec(_places(readings))
        self._pack = codec.packer()

    def write(self, frame: wire.SenseFrame) -> list[bytes]:
        """``{"presence": [bool, ...], "encoder_m": [x, y] | nil}``, and what else there is to read."""
        if frame.picture is not None:
            return self._write_pictured(frame, frame.picture)
        sensors, write = self._readings.sensors, self._fixed.write
        there = frame.presence.tobytes()
        presence = [there[i : i + sensors] for i in range(0, len(there), sensors)]
        rows: list[tuple[Any, ...]] = [(bits,) for bits in presence]
        numbers = [part for part in (frame.encoder_m, frame.level) if part is not None]
        for part in numbers:
            rows = [(*row, *more) for row, more in zip(rows, part.tolist(), strict=True)]
        if frame.label is not None:
            rows = [(*row, label) for row, label in zip(rows, frame.label.tolist(), strict=True)]
        if numbers:
            return write(frame.tick, rows)
        # Without numbers all cells that sense alike get the same bytes: encode each pattern once.
        patterns = list(set(rows))
        made = dict(zip(patterns, write(frame.tick, patterns), strict=True))
        return [made[row] for row in rows]

    def _write_pictured(self, frame: wire.SenseFrame, picture: CameraFrame) -> list[bytes]:
        """Encode a tick with a camera frame, which has no fixed layout."""
        n, shown = len(frame.presence), codec.picture_rows(picture)
        columns: dict[str, list[Any]] = {
            "presence": frame.presence.tolist(),
            "encoder_m": [None] * n if frame.encoder_m is None else frame.encoder_m.tolist(),
        }
        if frame.level is not None:
            columns["level"] = frame.level.tolist()
        if frame.label is not None:
            columns["label"] = frame.label.tolist()
        envelope = {"v": codec.VERSION, "tick": frame.tick}
        return [
            self._pack(
                {**envelope, **{name: column[i] for name, column in columns.items()}, "picture": shown}
            )
            for i in range(n)
        ]


def joined(readings: SensorSchema, values: list[Sensed]) -> Senses:
    """Join the senses of all cells; the first camera frame found is used, as all cells get the same frame."""
    bits, travel, levels, labels, pictures = zip(*values, strict=True)
    each = (len(values), readings.sensors)
    presence, encoder_m, level, label = np.ndarray(each, np.bool_, bytearray().join(bits)), None, None, None
    if readings.encoders:
        encoder_m = np.ndarray((len(values), 2), np.float64, bytearray().join(travel))
    if readings.levels:
        level = np.ndarray(each, np.float64, bytearray().join(levels))
    if readings.labels:
        label = np.array(labels, dtype=np.int64)
    picture = next((one for one in pictures if one is not None), None) if readings.camera else None
    return Senses(presence, encoder_m, level, label, picture)


def sense_decoder(readings: SensorSchema) -> Decode:
    """Return a decoder of sense payloads: to the tick and the cell's senses."""
    sensors, largest, most = readings.sensors, readings.labels, readings.camera
    names = list(_places(readings))
    limit = (len(names) - 1) * VALUE + most * codec.PICTURED_BYTES
    read, pack = codec.reader("sense", limit, codec.layout(*names)), struct.Struct(f"<{sensors}d").pack

    def decode(unit: int, payload: bytes) -> tuple[int, Sensed]:  # noqa: ARG001 - all cells alike
        tick, fields = read(payload)
        presence = bytes(codec.booleans("sense", fields["presence"], sensors))
        travel, level, label, picture = b"", b"", 0, None
        if readings.encoders:
            travel = PAIR.pack(*codec.finite_pair("sense", fields["encoder_m"]))
        else:
            codec.expect_nil("sense", "encoder_m", fields["encoder_m"])
        if readings.levels:
            level = pack(*codec.fraction_list("sense", fields["level"], sensors))
        if largest:
            label = codec.label("sense", fields["label"], largest)
        if most:
            picture = codec.picture("sense", fields["picture"], most)
        return tick, (presence, travel, level, label, picture)

    return FixedLayoutCodec(_places(readings)).decoder(_short(readings, pack), decode)


def _short(readings: SensorSchema, pack: Callable[..., bytes]) -> Callable[..., Sensed | None]:
    """Return a converter from decoded values to a cell's senses; the converter returns None for invalid values."""
    encoders, levels, largest = readings.encoders, readings.levels, readings.labels

    def sensed(marks: bytes, *values: float) -> Sensed | None:
        presence, label = decode_booleans(marks), values[-1] if largest else 0
        numbers = values[:-1] if largest else values
        travel, shares = (finite_pair(*numbers[:2]), numbers[2:]) if encoders else (b"", numbers)
        fits = label <= largest and all(0.0 <= share <= 1.0 for share in shares)
        if presence is None or travel is None or not fits:
            return None
        return presence, travel, pack(*shares) if levels else b"", int(label), None

    if levels or largest:
        return sensed
    return _travelled if encoders else _present


def finite_pair(first: float, second: float) -> bytes | None:
    """Two numbers, packed; None if one is not finite."""
    # Only a finite number minus itself is zero.
    return PAIR.pack(first, second) if first - first == second - second == 0.0 else None


def _travelled(marks: bytes, x: float, y: float) -> Sensed | None:
    presence, travel = decode_booleans(marks), finite_pair(x, y)
    return None if presence is None or travel is None else (presence, travel, b"", 0, None)


def _present(marks: bytes) -> Sensed | None:
    presence = decode_booleans(marks)
    return None if presence is None else (presence, b"", b"", 0, None)


_LETTERS: Final = {
    "b1": "?", "i1": "b", "i2": "h", "i4": "i", "i8": "q", "u1": "B", "u2": "H", "u4": "I", "u8": "Q",
    "f2": "e", "f4": "f", "f8": "d",
}  # fmt: skip
"""The struct module's letter for each kind of field and its size."""
_NO_MESSAGE: Final = codec.layout()
_DRIVE: Final[dict[str, FieldLayout]] = {"drive": ("d", "d")}

_read_drive = codec.reader("drive", VALUE, codec.layout("drive"))


@final
class PerCellCoordinator(CoordinatorCodec):
    """The plant's side: a unit is a cell."""

    def __init__(self, wiring: RunSchema) -> None:
        cells, run = wiring.partition.lattice.cells, wiring.run
        self._sense = SenseWriter(wiring.readings)
        self.unit_cells = tuple(np.array([i], dtype=np.int64) for i in range(len(cells)))
        self.sense_keys = tuple(cell_key(run, cell, "sense") for cell in cells)
        self.drive_units = {cell_key(run, cell, "drive"): i for i, cell in enumerate(cells)}
        self.alive_units = {cell_key(run, cell, "alive"): i for i, cell in enumerate(cells)}
        self.ready_units = {cell_key(run, cell, "ready"): i for i, cell in enumerate(cells)}
        self.drive_expr = cell_key(run, None, "drive")
        self.alive_expr = cell_key(run, None, "alive")
        self.ready_expr = cell_key(run, None, "ready")
        self.decode_drive = _drive_decoder()
        self.blank_drives = [bytes(PAIR.size)] * len(cells)

    def sense_payloads(self, frame: wire.SenseFrame, relayed: RelayedLinks | None = None) -> list[bytes]:
        """A payload a cell."""
        del relayed
        return self._sense.write(frame)

    def join_drives(self, values: list[Any]) -> codec.Values:
        """``(n, 2)`` from a packed pair a cell."""
        return np.ndarray((len(values), 2), np.float64, bytearray().join(values))


def _drive_decoder() -> Decode:
    """Return a decoder of drive payloads: to the tick and the drive as a packed pair."""

    def decode(unit: int, payload: bytes) -> tuple[int, bytes]:  # noqa: ARG001 - all cells alike
        tick, fields = _read_drive(payload)
        return tick, PAIR.pack(*codec.finite_pair("drive", fields["drive"]))

    return FixedLayoutCodec(_DRIVE).decoder(finite_pair, decode)


@final
class PerCellParticipant(ParticipantCodec):
    """A shard's side: a unit a cell, a part a link."""

    def __init__(self, wiring: RunSchema, shard: int) -> None:
        partition, run = wiring.partition, wiring.run
        cells = partition.lattice.cells
        mine = partition.cells(shard)
        names = [cells[int(i)] for i in mine]
        self._readings = wiring.readings
        self.alive_keys = tuple(cell_key(run, cell, "alive") for cell in names)
        self.ready_keys = tuple(cell_key(run, cell, "ready") for cell in names)
        self.drive_keys = tuple(cell_key(run, cell, "drive") for cell in names)
        self.unit_cells = tuple(np.array([i], dtype=np.int64) for i in mine)
        self.sense_units = {cell_key(run, cell, "sense"): i for i, cell in enumerate(names)}
        self.decode_sense = sense_decoder(wiring.readings)
        self.blank_senses = [blank(wiring.readings)] * len(names)
        message = np.dtype([]) if wiring.message is None else wiring.message
        incoming, outgoing = partition.incoming(shard), partition.outgoing(shard)
        received = range(0 if wiring.message is None else len(incoming))
        said = range(0 if wiring.message is None else len(outgoing))
        self.in_parts = {
            cell_link_key(run, cells[int(incoming.source[i])], int(incoming.source_side[i])): i
            for i in received
        }
        self.in_sources = tuple(incoming.source[i : i + 1] for i in received)
        self.in_targets = tuple(incoming.target[i : i + 1] for i in received)
        self.decode_link = _link_decoder(message)
        self.blank_links = [b""] * len(received)
        self._no_message = bytes(message.itemsize)
        self._message = message
        self._fields = _struct(message).iter_unpack
        self._drive, self._link, self._silence = (
            FixedLayoutCodec(_DRIVE),
            FixedLayoutCodec(_link_places(message)),
            FixedLayoutCodec({}),
        )
        self.out_keys = tuple(
            cell_link_key(run, cells[int(outgoing.source[i])], int(outgoing.source_side[i])) for i in said
        )
        self.out_sources = tuple(outgoing.source[i : i + 1] for i in said)
        self.out_targets = tuple(outgoing.target[i : i + 1] for i in said)

    def join_senses(self, values: list[Any]) -> Senses:
        """Join the senses of all cells."""
        return joined(self._readings, values)

    def join_links(self, values: list[Any], sensed: list[Any]) -> tuple[codec.Mask, codec.Message]:
        """Join the packed messages of all links, empty where nothing was sent."""
        del sensed
        sent = bytearray(map(bool, values))
        if 0 in sent:
            values = [value or self._no_message for value in values]
        return np.frombuffer(sent, np.bool_), np.frombuffer(bytearray().join(values), self._message)

    def drive_payloads(self, frame: wire.DriveFrame, links: wire.LinkFrame | None = None) -> list[bytes]:
        """A payload a cell: ``{"drive": [a, b]}``."""
        del links
        pairs = list(PAIR.iter_unpack(frame.drive.tobytes()))
        for first, second in pairs:
            # Only a finite number minus itself is zero.
            if first - first != 0.0 or second - second != 0.0:
                raise WireError("drive", "finite", "every value must be finite")
        return self._drive.write(frame.tick, pairs)

    def link_payloads(self, frame: wire.LinkFrame) -> list[bytes]:
        """A payload a link: the message's fields by name, none where nothing was sent."""
        sent = frame.sent.tobytes()
        payloads = self._link.write(frame.tick, self._fields(frame.message.tobytes()))
        if 0 in sent:
            (silence,) = self._silence.write(frame.tick, [()])
            payloads = [payload if said else silence for payload, said in zip(payloads, sent, strict=True)]
        return payloads


def _link_decoder(message: np.dtype[Any]) -> Decode:
    """Return a decoder of link payloads: to the tick and the message's packed fields, empty where nothing was sent."""
    silence = FixedLayoutCodec({}).decoder(bytes, _any_link_decoder(message))
    return FixedLayoutCodec(_link_places(message)).decoder(_message_packer(message), silence)


def _message_packer(message: np.dtype[Any]) -> Callable[..., bytes | None]:
    """Return a converter from a message's decoded values to its packed fields."""
    # booleans of a vector are one value, its other numbers a value each
    letters = [
        (letter, leaf.most)
        for leaf, letter in zip(leaves(message), _letters(message), strict=True)
        for _ in range(1 if letter == "?" else leaf.size)
    ]
    packed = _struct(message)
    if all(letter not in "?e" and most is None for letter, most in letters):
        return packed.pack

    def pack(*values: Any) -> bytes | None:
        made = [
            decode_booleans(value) if letter == "?" else value if most is None or value <= most else None
            for value, (letter, most) in zip(values, letters, strict=True)
        ]
        try:
            return None if None in made else packed.pack(*made)
        except OverflowError:  # Half a float does not hold it.
            return None

    return pack


def _any_link_decoder(message: np.dtype[Any]) -> Decode:
    """Return a decoder of link payloads in any layout."""
    names = [leaf.name for leaf in leaves(message)]
    pack = _struct(message, truth_values=True).pack
    readers = [codec.leaf_reader("link", leaf) for leaf in leaves(message)]
    limit = sum(VALUE * leaf.size + 4 * len(leaf.name) for leaf in leaves(message))
    read = codec.reader("link", limit, codec.layout(*names), _NO_MESSAGE)

    def decode(part: int, payload: bytes) -> tuple[int, bytes]:  # noqa: ARG001 - all links alike
        tick, fields = read(payload)
        if len(fields) == len(_NO_MESSAGE):
            return tick, b""
        values = [reader(fields[name]) for name, reader in zip(names, readers, strict=True)]
        return tick, pack(*chain.from_iterable(values))

    return decode


def _letters(message: np.dtype[Any]) -> list[str]:
    """The struct module's letter for each leaf of a message; they mean other sizes than NumPy's."""
    return [_LETTERS[leaf.type.kind + str(leaf.type.itemsize)] for leaf in leaves(message)]


def _link_places(message: np.dtype[Any]) -> dict[str, FieldLayout]:
    """A message in MessagePack, which has no half floats: leaves by name, vectors as lists."""
    places: dict[str, FieldLayout] = {}
    for leaf, letter in zip(leaves(message), _letters(message), strict=True):
        number = "f" if letter == "e" else letter
        if not leaf.shape:
            places[leaf.name] = number
        else:
            places[leaf.name] = leaf.size if number == "?" else (number,) * leaf.size
    return places


def _struct(message: np.dtype[Any], *, truth_values: bool = False) -> struct.Struct:
    """The layout of a message, with booleans as Python's (``truth_values``) or as bytes, one string a leaf."""
    words = [
        f"{leaf.size}{'s' if letter == '?' and not truth_values else letter}"
        for leaf, letter in zip(leaves(message), _letters(message), strict=True)
    ]
    return struct.Struct("<" + "".join(words))
