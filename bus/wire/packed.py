"""The packed format: one little-endian array a shard, and one a border between shards."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, cast, final

import msgpack  # pyright: ignore[reportMissingTypeStubs]
import numpy as np

from bus.errors import WireError
from bus.partition import Index
from bus.sensors import SensorSchema
from bus.wire import frames as wire
from bus.wire import msgpack_codec as codec
from bus.wire.fixed_layout import PayloadLayout
from bus.wire.format import RelayedLinks, RunSchema, Senses, as_slice
from bus.wire.keys import shard_link_key
from bus.wire.per_shard import PerShardCoordinator, PerShardParticipant

# --- payloads of binary fields, written with one copy of the fields and read with none ---------------

FEW: Final = 1 << 15
"""Bytes up to which copying costs less than taking a payload apart here."""
_INTEGER: Final = 9
"""Most bytes of an integer in MessagePack."""
_TICK_ENDS: Final = {1: 1 << 7, 2: 1 << 8, 3: 1 << 16, 5: 1 << 32, 9: codec.TICK_LIMIT}
"""First tick that takes more bytes in MessagePack, by the bytes of those below."""
_NOT_MESSAGEPACK: Final = (ValueError, TypeError, OverflowError, msgpack.UnpackException)
_unpackb = cast("Callable[[bytes], object]", cast("Any", msgpack).unpackb)

Part = bytes | memoryview
"""Contents of a field, or something else whose memory is in one piece."""


@final
class BinaryLayout:
    """Payload of one kind with binary fields of fixed sizes after ``v`` and ``tick``.

    The bytes are those that a MessagePack packer makes of the same map. The tick is the only field of variable length.

    Args:
        sizes: Bytes of each field, in order; None: the field is nil.
        open_map: Number of further fields, which the caller appends to what ``write`` returns.
    """

    def __init__(self, sizes: Mapping[str, int | None], open_map: int = 0) -> None:
        packer = cast("Any", msgpack).Packer()
        self._pack = cast("Callable[[object], bytes]", packer.pack)
        self._head = packer.pack_map_header(2 + len(sizes) + open_map) + packer.pack("v")
        self._head += packer.pack(codec.VERSION) + packer.pack("tick")
        # the constant bytes before each field's contents, and after the last
        names = [b""]
        self._sizes = [size for size in sizes.values() if size is not None]
        for name, size in sizes.items():
            names[-1] += packer.pack(name)
            if size is None:
                names[-1] += packer.pack(None)
            else:
                names[-1] += packer.pack(bytes(size)).removesuffix(bytes(size))
                names.append(b"")
        self._names = names
        self._pieces: list[Part] = [self._head, b""]
        for name in names:
            self._pieces += (name, b"")
        self._pieces.pop()
        self._after_tick = sum(map(len, names)) + sum(self._sizes)
        self._fields = [name for name, size in sizes.items() if size is not None]

    def layout(self, tick: int, bits: Mapping[str, int]) -> PayloadLayout:
        """Return the positions of the values in the payload of a tick.

        Args:
            tick: The tick.
            bits: Number of booleans of each field that has eight in a byte.
        """
        packed = self._pack(tick)
        width = max(len(packed) - 1, 1)
        constant = self._head + packed[:-width] + bytes(width)
        places = {"tick": (len(constant) - width, width)}
        for name, size, text in zip(self._fields, self._sizes, self._names, strict=False):
            constant += text
            places[name] = (len(constant), size)
            constant += bytes(size)
        return PayloadLayout(constant + self._names[-1], places, bits, _TICK_ENDS[len(packed)])

    def write(self, tick: int, parts: Sequence[Part]) -> bytes:
        """Return a payload with these contents of the fields that are not nil."""
        pieces = self._pieces
        pieces[1] = self._pack(tick)
        pieces[3::2] = parts
        payload = b"".join(pieces)
        pieces[3::2] = self._names[1:]  # keep no contents
        return payload

    def read(self, payload: bytes) -> tuple[int, list[memoryview]] | None:
        """Return the tick and the contents of the fields that are not nil.

        None where MessagePack's own unpacker should have the payload: it is in another layout, or small.
        """
        if len(payload) <= FEW:
            return None
        head, at = len(self._head), len(payload) - self._after_tick
        if not head < at <= head + _INTEGER or payload[:head] != self._head:
            return None
        try:
            tick = _unpackb(payload[head:at])
        except _NOT_MESSAGEPACK:
            return None
        if type(tick) is not int or not 0 <= tick < codec.TICK_LIMIT:
            return None
        view, parts = memoryview(payload), list[memoryview]()
        for name, size in zip(self._names, [*self._sizes, 0], strict=True):
            begin = at + len(name)
            if payload[at:begin] != name:
                return None
            at = begin + size
            parts.append(view[begin:at])
        return tick, parts[:-1]


# --- the format ---------------------------------------------------------------------------------------

_DRIVE: Final = codec.layout("drive")
_LINK: Final = codec.layout("sent", "message")
_NAME: Final = 16
"""Most bytes of a value's name and length."""


@final
class PackedCoordinator(PerShardCoordinator):
    """The plant's side: a unit is a shard."""

    def __init__(self, wiring: RunSchema) -> None:
        super().__init__(wiring)
        self._pack = codec.packer()
        self._cells = len(wiring.partition.lattice)
        self._pictures = wiring.readings.camera > 0
        self._rows = tuple(as_slice(cells) for cells in self.unit_cells)
        self.decode_drive = self._decode_drive
        self.blank_drives = [0.0] * wiring.partition.count
        counts = [len(cells) for cells in self.unit_cells]
        self._read_drive = [codec.reader("drive", count * 16, _DRIVE) for count in counts]
        self._drives = [BinaryLayout(_drive_sizes(count)) for count in counts]
        self._senses = [
            BinaryLayout(_sense_sizes(count, wiring.readings), self._pictures) for count in counts
        ]

    def sense_payloads(self, frame: wire.SenseFrame, relayed: RelayedLinks | None = None) -> list[bytes]:
        """A payload a shard."""
        del relayed
        payloads = [
            layout.write(frame.tick, _sense_parts(frame, rows))
            for layout, rows in zip(self._senses, self._rows, strict=True)
        ]
        if self._pictures:
            picture = self._pack({"picture": codec.picture_rows(frame.picture)})[1:]
            payloads = [payload + picture for payload in payloads]
        return payloads

    def _decode_drive(self, unit: int, payload: bytes) -> tuple[int, Any]:
        """Tick and ``(cells, 2)`` drives of a shard."""
        rows = len(self.unit_cells[unit])
        read = self._drives[unit].read(payload)
        if read is None:
            tick, fields = self._read_drive[unit](payload)
            return tick, codec.floats("drive", fields["drive"], rows)
        tick, (drive,) = read
        return tick, codec.floats("drive", drive, rows)

    def join_drives(self, values: list[Any]) -> codec.Values:
        """``(n, 2)`` from an array a shard."""
        if len(values) == 1 and isinstance(values[0], np.ndarray):
            return cast("codec.Values", values[0])
        drives = np.empty((self._cells, 2))
        for rows, value in zip(self._rows, values, strict=True):
            drives[rows] = value
        return drives


def _drive_sizes(cells: int) -> dict[str, int | None]:
    """Return the bytes of each field of a shard's drives."""
    return {"drive": cells * 16}


def _sense_sizes(cells: int, readings: SensorSchema) -> dict[str, int | None]:
    """Return the bytes of each field of a shard's senses but the picture; levels and labels only in runs with them."""
    sizes: dict[str, int | None] = {
        "presence": (cells * readings.sensors + 7) // 8,
        "encoder_m": cells * 16 if readings.encoders else None,
    }
    if readings.levels:
        sizes["level"] = cells * readings.sensors * 8
    if readings.labels:
        sizes["label"] = cells * 2
    return sizes


def _sense_parts(frame: wire.SenseFrame, rows: slice | Index) -> list[Part]:
    """Return the contents of these fields."""
    parts: list[Part] = [codec.bits_bytes(frame.presence[rows])]
    parts += [_bytes_of(field[rows]) for field in (frame.encoder_m, frame.level) if field is not None]
    if frame.label is not None:
        parts.append(codec.label_bytes(frame.label[rows]))
    return parts


def _bytes_of(array: codec.Values) -> Part:
    """Return the bytes of an array, of a large one without a copy where they are in one piece."""
    return array.data.cast("B") if array.nbytes > FEW and array.flags.c_contiguous else array.tobytes()


def _sense_reader(readings: SensorSchema, rows: int) -> codec.Read:
    """Return a decoder of the senses of ``rows`` cells."""
    names, limit = ["presence", "encoder_m"], rows * (readings.sensors + 16)
    if readings.levels:
        names.append("level")
        limit += rows * 8 * readings.sensors
    if readings.labels:
        names.append("label")
        limit += rows * 2 + _NAME
    if readings.camera:
        names.append("picture")
        limit += readings.camera * codec.PICTURED_BYTES + _NAME
    return codec.reader("sense", limit, codec.layout(*names))


@final
class PackedParticipant(PerShardParticipant):
    """A shard's side: one unit, a part a border."""

    def __init__(self, wiring: RunSchema, shard: int) -> None:
        super().__init__(wiring, shard)
        self._pack = codec.packer()
        partition, run = wiring.partition, wiring.run
        cells = partition.cells(shard)
        self._rows = len(cells)
        self._readings = readings = wiring.readings
        self.decode_sense = self._decode_sense
        self.decode_link = self._decode_link
        self.blank_senses = [None]
        self._last_bits = bytes((self._rows * readings.sensors + 7) // 8)
        self._last_presence = np.zeros((self._rows, readings.sensors), dtype=np.bool_)
        self._read_sense = _sense_reader(readings, self._rows)
        self._drive = BinaryLayout(_drive_sizes(self._rows))
        sizes = _sense_sizes(self._rows, readings)
        self._senses = BinaryLayout(sizes)
        self._sense_names = tuple(name for name, size in sizes.items() if size is not None)
        self._message = np.dtype([]) if wiring.message is None else wiring.message
        self._zero = np.zeros((), dtype=self._message)
        incoming = () if wiring.message is None else partition.incoming_borders(shard)
        outgoing = () if wiring.message is None else partition.outgoing_borders(shard)
        self._no_links = (np.zeros(0, dtype=np.bool_), np.zeros(0, dtype=self._message))
        self._in_counts = tuple(b.stop - b.start for b in incoming)
        self.in_parts = {shard_link_key(run, b.shard, shard): i for i, b in enumerate(incoming)}
        self.in_sources = tuple(partition.cells(b.shard) for b in incoming)
        self.in_targets = tuple(cells for _ in incoming)
        self.blank_links = [
            (np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=self._message))
            for count in self._in_counts
        ]
        self._read_link = [
            codec.reader("link", count * (1 + self._message.itemsize), _LINK) for count in self._in_counts
        ]
        self._out_links = tuple(slice(b.start, b.stop) for b in outgoing)
        self.out_keys = tuple(shard_link_key(run, shard, b.shard) for b in outgoing)
        self.out_sources = tuple(cells for _ in outgoing)
        self.out_targets = tuple(partition.cells(b.shard) for b in outgoing)
        self._single = not (incoming or outgoing or readings.levels or readings.labels or readings.camera)

    def layouts(self, tick: int) -> tuple[PayloadLayout, PayloadLayout] | None:
        """Return the layouts of a tick's senses and drives; None with borders, or other senses than kernels read."""
        if not self._single:
            return None
        bits = {"presence": self._rows * self._readings.sensors}
        return self._senses.layout(tick, bits), self._drive.layout(tick, {})

    def _decode_sense(self, unit: int, payload: bytes) -> tuple[int, Any]:  # noqa: ARG002 - one unit only
        """Tick, and what the cells sense."""
        fields: dict[str, Any]
        read = self._senses.read(payload)
        if read is None:
            tick, fields = self._read_sense(payload)
        else:
            tick, parts = read
            fields = {"encoder_m": None, **dict(zip(self._sense_names, parts, strict=True))}
        rows, readings = self._rows, self._readings
        # Sensors change rarely: bytes that are the same as in the tick before need no reading.
        if fields["presence"] != self._last_bits:
            bits = codec.bits("sense", fields["presence"], rows * readings.sensors)
            self._last_bits, self._last_presence = bytes(fields["presence"]), bits.reshape(rows, -1)
        presence, encoder_m, level, label, picture = self._last_presence.copy(), None, None, None, None
        if readings.encoders:
            encoder_m = codec.floats("sense", fields["encoder_m"], rows)
        else:
            codec.expect_nil("sense", "encoder_m", fields["encoder_m"])
        if readings.levels:
            level = codec.fractions("sense", fields["level"], rows, readings.sensors)
        if readings.labels:
            label = codec.labels("sense", fields["label"], rows, readings.labels)
        if readings.camera:
            picture = codec.picture("sense", fields["picture"], readings.camera)
        return tick, Senses(presence, encoder_m, level, label, picture)

    def join_senses(self, values: list[Any]) -> Senses:
        """Return the senses of the single unit."""
        return values[0]

    def _decode_link(self, part: int, payload: bytes) -> tuple[int, Any]:
        """Tick, and ``(m,)`` mask with ``(m,)`` messages, zero where none was sent."""
        count = self._in_counts[part]
        tick, fields = self._read_link[part](payload)
        sent = codec.bits("link", fields["sent"], count)
        message = codec.messages("link", fields["message"], count, self._message)
        if not sent.all():
            message[~sent] = self._zero
        return tick, (sent, message)

    def join_links(self, values: list[Any], sensed: list[Any]) -> tuple[codec.Mask, codec.Message]:
        """The borders' stretches in their order."""
        del sensed
        if len(values) < 2:
            return values[0] if values else self._no_links
        return np.concatenate([sent for sent, _ in values]), np.concatenate(
            [message for _, message in values]
        )

    def drive_payloads(self, frame: wire.DriveFrame, links: wire.LinkFrame | None = None) -> list[bytes]:
        """One payload."""
        del links
        if not codec.all_finite(frame.drive):
            raise WireError("drive", "finite", "every value must be finite")
        return [self._drive.write(frame.tick, (_bytes_of(frame.drive),))]

    def link_payloads(self, frame: wire.LinkFrame) -> list[bytes]:
        """A payload a border."""
        return [
            self._pack(
                {
                    "v": codec.VERSION,
                    "tick": frame.tick,
                    "sent": codec.bits_bytes(frame.sent[links]),
                    "message": frame.message[links].tobytes(),
                }
            )
            for links in self._out_links
        ]
