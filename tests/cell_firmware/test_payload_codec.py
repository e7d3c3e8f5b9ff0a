"""Payloads that kernels read and write: the same as those of the wire format, and refused alike."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bus.partition import Partition
from bus.sensors import SensorSchema
from bus.wire.format import RelayedLinks, RunSchema
from bus.wire.formats import FORMATS, WireFormat
from bus.wire.frames import DriveFrame, LinkFrame, SenseFrame
from bus.wire.message_type import bounded_list
from cell_firmware import payload_codec
from cell_firmware.payload_codec import PayloadCodec
from cell_firmware.shard_kernel import TickBuffers
from cell_firmware.shard_links import ShardLinks
from tests.bus.support import grid

MESSAGE = np.dtype(
    [
        ("u", "<f8"),
        ("there", "?"),
        ("hops", "<u2"),
        ("seen", "?", (3,)),
        ("route", bounded_list([("n", "<i2")], 4)),
    ]
)
SENSORS = 2
TICK = 7


class Side:
    """The plant's payloads for the first shard of two, and both codecs of that shard."""

    def __init__(self, *, encoders: bool = True) -> None:
        partition = Partition.even(grid(2, 3), 2)
        schema = RunSchema("r", partition, SensorSchema(SENSORS, encoders=encoders), MESSAGE)
        self.host = FORMATS["relayed"].coordinator(schema)
        self.member = FORMATS["relayed"].participant(schema, 0)
        self.buffers = TickBuffers.of(ShardLinks.of(partition, 0), MESSAGE, SENSORS)
        self.codec = PayloadCodec(self.member.layouts, self.buffers)
        self.draw = np.random.default_rng(3)
        self.encoders = encoders
        self.links = sum(len(partition.incoming(shard)) for shard in range(2))

    def payload(self) -> bytes:
        """Senses of the first shard in a tick."""
        message = np.zeros(self.links, dtype=MESSAGE)
        message["u"], message["there"] = self.draw.normal(size=self.links), self.draw.random(self.links) < 0.5
        travel = self.draw.normal(size=(6, 2)) if self.encoders else None
        sent = (self.draw.random(self.links) < 0.7).astype(np.uint8)
        frame = SenseFrame(TICK, self.draw.random((6, SENSORS)) < 0.5, travel)
        return self.host.sense_payloads(frame, RelayedLinks(sent, message))[0]


@pytest.mark.parametrize("encoders", [True, False])
def test_senses_are_read_as_by_the_wire_format(encoders: bool) -> None:
    side = Side(encoders=encoders)
    for _ in range(20):
        payload = side.payload()
        tick, sensed = side.member.decode_sense(0, payload)
        assert side.codec.read(tick, payload)
        senses = side.member.join_senses([sensed])
        assert side.buffers.presence.tobytes() == senses.presence.tobytes()
        assert side.buffers.received.tobytes() == sensed.sent.tobytes()
        assert side.buffers.border.tobytes() == sensed.message.tobytes()
        if senses.encoder_m is not None:
            assert side.buffers.encoder_m.tobytes() == senses.encoder_m.tobytes()


@pytest.mark.parametrize("is_large", [False, True])
def test_drives_are_written_as_by_the_wire_format(is_large: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(payload_codec, "_LARGE", 0 if is_large else 1e9)
    side = Side()
    buffers, draw = side.buffers, side.draw
    for tick in (0, 1, 255, 256, 2**40 + 5):
        buffers.drive[...] = draw.normal(size=buffers.drive.shape)
        buffers.sent[...] = draw.random(buffers.sent.shape) < 0.5
        buffers.message["u"] = draw.normal(size=buffers.message.shape)
        frame, links = DriveFrame(tick, buffers.drive), LinkFrame(tick, buffers.sent, buffers.message)
        assert [side.codec.write(tick)] == side.member.drive_payloads(frame, links)


@pytest.mark.parametrize("form", ["relayed", "packed"])
@pytest.mark.parametrize("is_large", [False, True])
def test_drives_of_programs_without_messages_are_written_as_by_the_wire_format(
    form: WireFormat, is_large: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(payload_codec, "_LARGE", 0 if is_large else 1e9)
    partition = Partition.even(grid(2, 3), 2)
    schema = RunSchema("r", partition, SensorSchema(SENSORS, encoders=True), None)
    member = FORMATS[form].participant(schema, 0)
    buffers = TickBuffers.of(ShardLinks.of(partition, 0), np.dtype(np.bool_), SENSORS)
    codec = PayloadCodec(member.layouts, buffers)
    for tick in (0, 300):
        buffers.drive[...] = np.random.default_rng(tick).normal(size=buffers.drive.shape)
        assert [codec.write(tick)] == member.drive_payloads(DriveFrame(tick, buffers.drive), None)


def _place(side: Side, name: str) -> int:
    layouts = side.member.layouts(TICK)
    assert layouts is not None
    return layouts[0].places[name][0]


NOT_FINITE = [float("nan"), float("inf"), -float("inf")]


@pytest.mark.parametrize(
    ("where", "offset", "raw"),
    [
        ("presence", 0, b"\x02"),
        ("sent", 1, b"\xff"),
        ("message", MESSAGE.fields["there"][1] + MESSAGE.itemsize, b"\x02"),  # type: ignore[index]
        ("tick", 7, b"\x08"),
        ("tick", 0, b"\x80"),
        *[("encoder_m", 24, np.float64(value).tobytes()) for value in NOT_FINITE],
    ],
)
def test_a_payload_with_a_wrong_value_is_not_read(where: str, offset: int, raw: bytes) -> None:
    side = Side()
    payload = bytearray(side.payload())
    at = _place(side, where) + offset
    payload[at : at + len(raw)] = raw
    assert not side.codec.read(TICK, bytes(payload))


def test_numbers_at_the_end_of_the_range_are_finite() -> None:
    side = Side()
    payload, at = bytearray(side.payload()), _place(side, "encoder_m")
    for value in (np.finfo(np.float64).max, -np.finfo(np.float64).max, 5e-324, -0.0):
        payload[at : at + 8] = np.float64(value).tobytes()
        assert side.codec.read(TICK, bytes(payload))
        assert side.buffers.encoder_m[0, 0] == value


def test_a_payload_in_another_layout_is_not_read() -> None:
    side = Side()
    payload = side.payload()
    assert not side.codec.read(TICK, payload[:-1])
    assert not side.codec.read(TICK, payload + b"\x00")
    assert not side.codec.read(TICK, b"")
    values: set[int] = set()
    layouts = side.member.layouts(TICK)
    assert layouts is not None
    for start, size in layouts[0].places.values():
        values.update(range(start, start + size))
    for k in sorted(set(range(len(payload))) - values):
        other: Any = bytearray(payload)
        other[k] ^= 1
        assert not side.codec.read(TICK, bytes(other)), k


TICKS = (0, 1, 127, 128, 255, 256, 65_535, 65_536, 2**32 - 1, 2**32, 2**40 + 5)
"""Ticks before and after each at which MessagePack takes another byte."""


class PackedSide:
    """The payloads of a packed run of one shard, and the codec of that shard."""

    def __init__(self, rows: int, *, encoders: bool) -> None:
        partition = Partition.even(grid(rows, 3), 1)
        schema = RunSchema("r", partition, SensorSchema(SENSORS, encoders=encoders), MESSAGE)
        self.host = FORMATS["packed"].coordinator(schema)
        self.member = FORMATS["packed"].participant(schema, 0)
        self.buffers = TickBuffers.of(ShardLinks.of(partition, 0), MESSAGE, SENSORS)
        self.codec = PayloadCodec(self.member.layouts, self.buffers)
        self.draw, self.cells, self.encoders = np.random.default_rng(5), 3 * rows, encoders

    def payload(self, tick: int) -> bytes:
        """Senses of a tick."""
        travel = self.draw.normal(size=(self.cells, 2)) if self.encoders else None
        frame = SenseFrame(tick, self.draw.random((self.cells, SENSORS)) < 0.5, travel)
        return self.host.sense_payloads(frame)[0]


@pytest.mark.parametrize(("rows", "encoders"), [(1, True), (3, False), (4, True), (800, True)])
def test_packed_payloads_are_read_and_written_as_by_the_wire_format(
    rows: int, encoders: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(payload_codec, "_LARGE", 500)  # which some of them are
    side = PackedSide(rows, encoders=encoders)
    for tick in TICKS:
        payload = side.payload(tick)
        assert side.codec.read(tick, payload)
        found, sensed = side.member.decode_sense(0, payload)
        senses = side.member.join_senses([sensed])
        assert (found, side.buffers.presence.tobytes()) == (tick, senses.presence.tobytes())
        if encoders:
            assert side.buffers.encoder_m.tobytes() == senses.encoder_m.tobytes()
        side.buffers.drive[...] = side.draw.normal(size=side.buffers.drive.shape)
        assert [side.codec.write(tick)] == side.member.drive_payloads(DriveFrame(tick, side.buffers.drive))


def test_packed_payloads_in_another_layout_are_not_read() -> None:
    side = PackedSide(1, encoders=True)  # six bits: two beyond the last
    payload = side.payload(TICK)
    layouts = side.member.layouts(TICK)
    assert layouts is not None
    places = layouts[0].places
    values = {k for start, size in places.values() for k in range(start, start + size)}
    for k in [*sorted(set(range(len(payload))) - values), places["tick"][0]]:
        other: Any = bytearray(payload)
        other[k] ^= 1
        assert not side.codec.read(TICK, bytes(other)), k
    other = bytearray(payload)
    other[places["presence"][0]] |= 0x40
    assert not side.codec.read(TICK, bytes(other))


def test_packed_payloads_of_shards_with_borders_are_left_to_the_wire_format() -> None:
    partition = Partition.even(grid(2, 3), 2)
    schema = RunSchema("r", partition, SensorSchema(SENSORS), MESSAGE)
    assert FORMATS["packed"].participant(schema, 0).layouts(TICK) is None
    mute = RunSchema("r", partition, SensorSchema(SENSORS), None)
    assert FORMATS["packed"].participant(mute, 0).layouts(TICK) is not None
