"""The relayed format: one payload a shard each way in a tick, with its cells' messages in it.

A drive brings the messages of the shard's cells to cells of other shards. The coordinator has the drives of all shards
before it sends the next senses, and passes the messages on in these: a shard waits for its senses alone. All values
are packed bytes, booleans a byte each: a payload is its parts put together, and messages are passed on without being
decoded.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import accumulate, pairwise
from math import isfinite
from struct import Struct
from typing import Any, Final, NamedTuple, final

import numpy as np

from bus.errors import WireError
from bus.lattice import SIDES
from bus.partition import Index, Links
from bus.sensors import CameraFrame, SensorSchema
from bus.wire import frames as wire
from bus.wire import msgpack_codec as codec
from bus.wire.fixed_layout import Binary, Decode, FieldLayout, FixedLayoutCodec, PayloadLayout
from bus.wire.format import DriveBatch, RelayedLinks, RunSchema, Senses
from bus.wire.message_type import boolean_places, bounded_lists, overlong
from bus.wire.payload_batch import PayloadBatch
from bus.wire.per_shard import PerShardCoordinator, PerShardParticipant

_NAMES: Final = 128
"""Most bytes of the names and lengths of a payload's values."""
_PAIR: Final = 16
"""Bytes of a cell's drive, or of its wheels' travel."""
_NO_MESSAGE: Final = np.dtype([])
_FLAG: Final = np.dtype(np.bool_)
_NUMBER: Final = np.dtype(np.float64)
_FEW: Final = 16
"""Number of cells up to which numbers are checked faster one by one than as an array."""
_BOOLEANS: Final = b"\x00\x01"


def _sense_sizes(cells: int, links: int, readings: SensorSchema, message: np.dtype[Any]) -> dict[str, int]:
    """Return the bytes of each field of a shard's senses but the camera frame; 0 for what the run has not."""
    return {
        "presence": cells * readings.sensors,
        "encoder_m": cells * _PAIR if readings.encoders else 0,
        "level": cells * readings.sensors * 8 if readings.levels else 0,
        "label": cells * 2 if readings.labels else 0,
        "sent": links if message.itemsize else 0,
        "message": links * message.itemsize,
    }


def _drive_sizes(cells: int, links: int, message: np.dtype[Any]) -> dict[str, int]:
    """Return the bytes of each field of a shard's drives; 0 for messages where the run has none."""
    return {
        "drive": cells * _PAIR,
        "sent": links if message.itemsize else 0,
        "message": links * message.itemsize,
    }


def _places(sizes: dict[str, int]) -> dict[str, FieldLayout]:
    return {name: Binary(size) for name, size in sizes.items()}


def _check_booleans(kind: str, name: str, values: bytes) -> None:
    """Raise WireError if a byte is neither 0 nor 1."""
    if values.translate(None, _BOOLEANS):
        raise WireError(kind, "type", f"{name} must be booleans")


def _finite_check(cells: int) -> Callable[[bytes], bool]:
    """Return a check whether all float64 of packed pairs, one a cell, are finite."""
    if cells > _FEW:
        return lambda pairs: codec.all_finite(np.frombuffer(pairs))
    unpack = Struct(f"<{2 * cells}d").unpack
    return lambda pairs: all(map(isfinite, unpack(pairs)))


# --- the plant's side -----------------------------------------------------------------------------


class _Driven(NamedTuple):
    """Drives of a shard's cells, or of all, and the messages that the cells send, all packed."""

    drive: codec.Contents
    sent: codec.Contents
    message: codec.Contents


@final
class RelayedCoordinator(PerShardCoordinator):
    """The plant's side: a unit is a shard."""

    def __init__(self, wiring: RunSchema) -> None:
        super().__init__(wiring)
        self._pack = codec.packer()
        partition, readings = wiring.partition, wiring.readings
        message = self._message = _NO_MESSAGE if wiring.message is None else wiring.message
        shards = range(partition.count)
        order = np.concatenate(self.unit_cells)
        self._order = slice(None) if np.all(order[1:] > order[:-1]) else order
        self.relays = wiring.message is not None
        outgoing = [partition.outgoing(s) for s in shards]
        incoming = [partition.incoming(s) for s in shards]
        self._sources, self._route = _routes(outgoing, incoming)
        counts = [len(cells) for cells in self.unit_cells]
        senses = [
            _sense_sizes(n, len(links), readings, message) for n, links in zip(counts, incoming, strict=True)
        ]
        self._fields = tuple(senses[0])
        self._cuts = [_cuts(sizes[name] for sizes in senses) for name in self._fields]
        no_picture: dict[str, FieldLayout] = {"picture": None} if readings.camera else {}
        self._senses = [FixedLayoutCodec(_places(sizes) | no_picture) for sizes in senses]
        self._silence = bytes(sum(sizes["sent"] for sizes in senses))
        self._no_messages = bytes(sum(sizes["message"] for sizes in senses))
        drives = [_drive_sizes(n, len(links), message) for n, links in zip(counts, outgoing, strict=True)]
        self.blank_drives = [_Driven(*map(bytes, sizes.values())) for sizes in drives]
        self._decoders = [_drive_decoder(sizes, message) for sizes in drives]
        self.decode_drive = self._decode_drive
        self._together: PayloadBatch | None = None
        if partition.count > 1 and max(counts) <= _FEW:
            self.batch = _Drives([FixedLayoutCodec(_places(sizes)) for sizes in drives], drives, message)
            if not readings.camera:
                self._together = PayloadBatch(self._senses)

    def sense_payloads(self, frame: wire.SenseFrame, relayed: RelayedLinks | None = None) -> list[bytes]:
        """A payload a shard."""
        order = self._order
        columns = (
            frame.presence[order].tobytes(),
            b"" if frame.encoder_m is None else frame.encoder_m[order].tobytes(),
            b"" if frame.level is None else frame.level[order].tobytes(),
            b"" if frame.label is None else codec.label_bytes(frame.label[order]),
            self._silence if relayed is None else relayed.sent.tobytes(),
            self._no_messages if relayed is None else relayed.message.tobytes(),
        )
        if self._together is not None:
            return self._together.write(frame.tick, columns)
        rows = zip(
            *([column[cut] for cut in cuts] for column, cuts in zip(columns, self._cuts, strict=True)),
            strict=True,
        )
        if frame.picture is not None:
            envelope = {"v": codec.VERSION, "tick": frame.tick}
            shown = {"picture": codec.picture_rows(frame.picture)}
            return [
                self._pack({**envelope, **dict(zip(self._fields, row, strict=True)), **shown}) for row in rows
            ]
        return [form.write(frame.tick, (row,))[0] for form, row in zip(self._senses, rows, strict=True)]

    def _decode_drive(self, unit: int, payload: bytes) -> tuple[int, Any]:
        """Tick, drives and messages of a shard."""
        return self._decoders[unit](unit, payload)

    def join_drives(self, values: list[Any]) -> codec.Values:
        """``(n, 2)`` from the packed drives of all shards."""
        joined: codec.Values = np.frombuffer(bytearray().join([value.drive for value in values])).reshape(
            -1, 2
        )
        if isinstance(self._order, slice):
            return joined
        drives = np.empty_like(joined)
        drives[self._order] = joined
        return drives

    def relay(self, values: list[Any], live: codec.Mask | None) -> RelayedLinks:
        """The messages of all shards, in the order of their receivers."""
        sent = np.frombuffer(b"".join([value.sent for value in values]), np.uint8)
        message = np.frombuffer(b"".join([value.message for value in values]), self._message)
        if live is not None:
            sent = sent & live[self._sources]
        return RelayedLinks(sent[self._route], message[self._route])


@final
class _Drives(DriveBatch):
    """Drives of all shards at once.

    Args:
        forms: Layout of each shard's drives.
        sizes: Bytes of each field of them.
        message: The protocol's message type.
    """

    def __init__(
        self, forms: Sequence[FixedLayoutCodec], sizes: Sequence[dict[str, int]], message: np.dtype[Any]
    ) -> None:
        self._payloads = PayloadBatch(forms)
        self.sizes, self.tick_at = self._payloads.sizes, self._payloads.tick_at
        self._drive_at, self._sent_at, self._message_at = self._payloads.fields
        assert list(sizes[0]) == ["drive", "sent", "message"], "this is a bug: other fields than expected"
        booleans = [self._sent_at]
        if message.itemsize:
            booleans += [
                self._message_at[place :: message.itemsize]
                for places in boolean_places(message).values()
                for place in places
            ]
        self._booleans_at = np.concatenate(booleans)
        self._listed = message if bounded_lists(message) else None

    def stamp(self, tick: int) -> bytes:
        """Return the bytes of a payload at ``tick_at``."""
        return self._payloads.stamp(tick)

    def decode(self, payloads: Sequence[bytes]) -> list[Any] | None:
        """Return the drives and messages of all shards as if they were of one; None where a payload is not valid."""
        joined = self._payloads.join(payloads)
        if joined is None or joined.take(self._booleans_at).tobytes().translate(None, _BOOLEANS):
            return None
        drive = joined.take(self._drive_at)
        if not codec.all_finite(drive.view(_NUMBER)):
            return None
        messages = joined.take(self._message_at)
        if self._listed is not None and overlong(messages.view(self._listed), self._listed).any():
            return None
        return [_Driven(drive.data, joined.take(self._sent_at).data, messages.data)]


def _routes(outgoing: Sequence[Links], incoming: Sequence[Links]) -> tuple[Index, Index]:
    """Return the source of each outgoing link, and the place among these links of each incoming one.

    Args:
        outgoing: Links out of each shard.
        incoming: Links into each shard.
    """
    out_names, in_names = (
        np.concatenate([links.source * len(SIDES) + links.source_side for links in ends])
        for ends in (outgoing, incoming)
    )
    order = np.argsort(out_names)
    return out_names // len(SIDES), order[np.searchsorted(out_names, in_names, sorter=order)]


def _cuts(sizes: Iterable[int]) -> list[slice]:
    """Return consecutive slices of given sizes."""
    return [slice(*ends) for ends in pairwise(accumulate(sizes, initial=0))]


def _drive_decoder(sizes: dict[str, int], message: np.dtype[Any]) -> Decode:
    """Return a decoder of one shard's drive payloads."""
    check_messages = _message_check("drive", message)
    is_finite = _finite_check(sizes["drive"] // _PAIR)

    def driven(drive: bytes, sent: bytes, messages: bytes) -> _Driven:
        if not is_finite(drive):
            raise WireError("drive", "finite", "every value must be finite")
        check_messages(sent, messages)
        return _Driven(drive, sent, messages)

    read = codec.reader("drive", sum(sizes.values()) + _NAMES, codec.layout(*sizes))

    def decode(unit: int, payload: bytes) -> tuple[int, _Driven]:  # noqa: ARG001 - one unit only
        tick, fields = read(payload)
        return tick, driven(*[codec.binary("drive", fields[name], size) for name, size in sizes.items()])

    return FixedLayoutCodec(_places(sizes)).decoder(driven, decode)


def _message_check(kind: str, message: np.dtype[Any]) -> Callable[[bytes, bytes], None]:
    """Return a check that raises WireError for marks of sent messages, or boolean fields, that are no booleans.

    So does a list longer than its bound.
    """
    places = [(name, place) for name, places in boolean_places(message).items() for place in places]
    has_lists = bool(bounded_lists(message))

    def check(sent: bytes, messages: bytes) -> None:
        _check_booleans(kind, "sent", sent)
        for name, place in places:
            _check_booleans(kind, name, messages[place :: message.itemsize])
        if has_lists:
            codec.check_lists(kind, np.frombuffer(messages, message), message)

    return check


# --- a shard's side -------------------------------------------------------------------------------


class _Sensed(NamedTuple):
    """Senses of a shard's cells, and the messages that the cells receive."""

    senses: Senses | None
    sent: codec.Mask
    message: codec.Message


@final
class RelayedParticipant(PerShardParticipant):
    """A shard's side: one unit, and no parts."""

    def __init__(self, wiring: RunSchema, shard: int) -> None:
        super().__init__(wiring, shard)
        partition = wiring.partition
        cells = partition.cells(shard)
        message = _NO_MESSAGE if wiring.message is None else wiring.message
        self.in_parts: dict[str, int] = {}
        self.in_sources = self.in_targets = self.out_sources = self.out_targets = ()
        self.blank_links: list[Any] = []
        self.out_keys = ()
        self.decode_link = _refuse
        self.relays = wiring.message is not None
        incoming = len(partition.incoming(shard)) if message.itemsize else 0
        self.decode_sense = _sense_decoder(len(cells), incoming, wiring.readings, message)
        self.blank_senses = [_Sensed(None, np.zeros(incoming, np.bool_), np.zeros(incoming, message))]
        self._zero = np.zeros((), message)
        self._drive = FixedLayoutCodec(
            _places(_drive_sizes(len(cells), len(partition.outgoing(shard)), message))
        )
        self._is_finite = _finite_check(len(cells))
        readings = wiring.readings
        self._layouts: tuple[PayloadLayout, PayloadLayout] | None = None
        if not (readings.levels or readings.labels or readings.camera):
            sense = FixedLayoutCodec(_places(_sense_sizes(len(cells), incoming, readings, message)))
            self._layouts = sense.layout(), self._drive.layout()

    def layouts(self, tick: int) -> tuple[PayloadLayout, PayloadLayout] | None:  # noqa: ARG002
        """Return the layouts of senses and drives, the same in all ticks; None with other senses than kernels read."""
        return self._layouts

    def join_senses(self, values: list[Any]) -> Senses:
        """Return the senses of the single unit."""
        return values[0].senses

    def join_links(self, values: list[Any], sensed: list[Any]) -> tuple[codec.Mask, codec.Message]:
        """Return the messages that came with the senses."""
        del values
        (one,) = sensed
        if 0 in one.sent.tobytes():
            one.message[~one.sent] = self._zero
        return one.sent, one.message

    def drive_payloads(self, frame: wire.DriveFrame, links: wire.LinkFrame | None = None) -> list[bytes]:
        """One payload, with the messages."""
        drive = frame.drive.tobytes()
        if not self._is_finite(drive):
            raise WireError("drive", "finite", "every value must be finite")
        sent, message = (b"", b"") if links is None else (links.sent.tobytes(), links.message.tobytes())
        return self._drive.write(frame.tick, ((drive, sent, message),))

    def link_payloads(self, frame: wire.LinkFrame) -> list[bytes]:
        """No payloads: messages go with the drive."""
        del frame
        return []


def _refuse(part: int, payload: bytes) -> tuple[int, Any]:  # noqa: ARG001 - as every decoder
    raise WireError("link", "key", "messages come with the senses")


def _sense_decoder(cells: int, links: int, readings: SensorSchema, message: np.dtype[Any]) -> Decode:
    """Return a decoder of one shard's sense payloads."""
    sizes, sensors = _sense_sizes(cells, links, readings, message), readings.sensors
    check_messages = _message_check("sense", message)
    is_finite, pairs = _finite_check(cells), (cells, 2)

    def sensed(
        presence: bytes,
        encoder_m: bytes,
        level: bytes,
        label: bytes,
        sent: bytes,
        messages: bytes,
        picture: CameraFrame | None = None,
    ) -> _Sensed:
        _check_booleans("sense", "presence", presence)
        check_messages(sent, messages)
        if encoder_m and not is_finite(encoder_m):
            raise WireError("sense", "finite", "every value must be finite")
        senses = Senses(
            np.ndarray((cells, sensors), _FLAG, bytearray(presence)),
            np.ndarray(pairs, _NUMBER, bytearray(encoder_m)) if encoder_m else None,
            codec.fractions("sense", level, cells, sensors) if readings.levels else None,
            codec.labels("sense", label, cells, readings.labels) if readings.labels else None,
            picture,
        )
        return _Sensed(
            senses, np.ndarray(links, _FLAG, bytearray(sent)), np.ndarray(links, message, bytearray(messages))
        )

    names, most, picture = list(sizes), readings.camera, dict[str, FieldLayout]()
    if most:
        names.append("picture")
        picture["picture"] = None
    limit = sum(sizes.values()) + _NAMES + most * codec.PICTURED_BYTES
    read = codec.reader("sense", limit, codec.layout(*names))

    def decode(unit: int, payload: bytes) -> tuple[int, _Sensed]:  # noqa: ARG001 - one unit only
        tick, fields = read(payload)
        values = [codec.binary("sense", fields[name], size) for name, size in sizes.items()]
        shown = codec.picture("sense", fields["picture"], most) if most else None
        return tick, sensed(*values, picture=shown)

    return FixedLayoutCodec(_places(sizes) | picture).decoder(sensed, decode)
