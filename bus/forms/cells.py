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
from bus.forms.cell_senses import PAIR, VALUE, SenseWriter, blank, finite_pair, joined, sense_decoder
from bus.forms.form import HostForm, MemberForm, Senses, Wiring
from bus.keys import cell_key, cell_link_key

_LETTERS: Final = {
    "b1": "?", "i1": "b", "i2": "h", "i4": "i", "i8": "q", "u1": "B", "u2": "H", "u4": "I", "u8": "Q",
    "f2": "e", "f4": "f", "f8": "d",
}  # fmt: skip
"""The struct module's letter for each kind of field and its size."""
_NO_MESSAGE: Final = codec.layout()
_DRIVE: Final[dict[str, Place]] = {"drive": ("d", "d")}

_read_drive = codec.reader("drive", VALUE, codec.layout("drive"))


@final
class CellsHost(HostForm):
    """The plant's side: a unit is a cell."""

    def __init__(self, wiring: Wiring) -> None:
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

    def sense_payloads(self, frame: wire.SenseFrame) -> list[bytes]:
        """A payload a cell."""
        return self._sense.write(frame)

    def join_drives(self, values: list[Any]) -> codec.Values:
        """``(n, 2)`` from a packed pair a cell."""
        return np.ndarray((len(values), 2), np.float64, bytearray().join(values))


def _drive_decoder() -> Decode:
    """From a drive payload to its tick and the drive as a packed pair."""

    def decode(unit: int, payload: bytes) -> tuple[int, bytes]:  # noqa: ARG001 - all cells alike
        tick, fields = _read_drive(payload)
        return tick, PAIR.pack(*codec.pair("drive", fields["drive"]))

    return Fixed(_DRIVE).decoder(finite_pair, decode)


@final
class CellsMember(MemberForm):
    """A shard's side: a unit a cell, a part a link."""

    def __init__(self, wiring: Wiring, shard: int) -> None:
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
        """From what each cell senses."""
        return joined(self._readings, values)

    def join_links(self, values: list[Any]) -> tuple[codec.Mask, codec.Message]:
        """From the packed message of each link, empty where there was none."""
        sent = bytearray(map(bool, values))
        if 0 in sent:
            values = [value or self._no_message for value in values]
        return np.frombuffer(sent, np.bool_), np.frombuffer(bytearray().join(values), self._message)

    def drive_payloads(self, frame: wire.DriveFrame) -> list[bytes]:
        """A payload a cell: ``{"drive": [a, b]}``."""
        pairs = list(PAIR.iter_unpack(frame.drive.tobytes()))
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
    limit = sum(VALUE + 4 * len(name) for name in names)
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
