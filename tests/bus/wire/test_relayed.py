"""The wire format ``relayed``: checks of its payloads, and messages that find their receivers."""

from __future__ import annotations

from typing import Any

import msgpack
import numpy as np
import pytest

from bus.partition import Partition
from bus.sensors import SensorSchema
from bus.wire.format import RunSchema
from bus.wire.formats import FORMATS
from bus.wire.frames import DriveFrame, LinkFrame, SenseFrame
from bus.wire.message_type import check_message
from tests.bus.support import grid
from tests.bus.wire.codecs import MESSAGE, refusal, sides


def test_a_relayed_payload_whose_booleans_sizes_or_drives_are_wrong_is_refused() -> None:
    host, (member, _) = sides("relayed")
    links = LinkFrame(0, np.ones(3, np.bool_), np.zeros(3, MESSAGE))
    drive = msgpack.unpackb(member.drive_payloads(DriveFrame(0, np.zeros((3, 2))), links)[0])
    sense = msgpack.unpackb(
        host.sense_payloads(SenseFrame(0, np.ones((6, 3), np.bool_), np.zeros((6, 2))))[0]
    )
    odd = bytearray(drive["message"])
    odd[MESSAGE.fields["there"][1] + MESSAGE.itemsize] = 7  # type: ignore[index]

    def refused_drive(**changed: object) -> set[str]:
        """Names of the errors: with the tick as wide as the emulator writes it, and narrower."""
        wide = msgpack.packb({**drive, **changed}).replace(b"\xa4tick\x00", b"\xa4tick\xcf" + bytes(8))
        return {refusal(lambda p: host.decode_drive(0, p), p) for p in (wide, {**drive, **changed})}

    assert refused_drive(drive=b"\xff" * 48) == {"drive: finite"}
    assert refused_drive(drive=b"\x00" * 47) == {"drive: size"}
    assert refused_drive(sent=b"\x01\x02\x01") == {"drive: type"}
    assert refused_drive(sent=b"\x01\x01") == {"drive: size"}
    assert refused_drive(message=bytes(odd)) == {"drive: type"}
    assert refused_drive(message=None) == {"drive: size"}
    assert refused_drive(more=1) == {"drive: fields"}

    def refused_sense(**changed: object) -> str:
        return refusal(lambda payload: member.decode_sense(0, payload), {**sense, **changed})

    assert refused_sense(presence=b"\x02" * 9) == "sense: type"
    assert refused_sense(sent=b"\x02" * 3) == "sense: type"
    assert refused_sense(message=bytes(odd)) == "sense: type"
    assert refused_sense(encoder_m=b"") == "sense: size"
    assert refused_sense(label=b"\x00\x00") == "sense: size"


def test_messages_of_dead_cells_are_not_relayed() -> None:
    host, members = sides("relayed")
    links = LinkFrame(0, np.ones(3, np.bool_), np.ones(3, MESSAGE))
    drives = [member.drive_payloads(DriveFrame(0, np.zeros((3, 2))), links)[0] for member in members]
    values = [host.decode_drive(unit, payload)[1] for unit, payload in enumerate(drives)]
    live = np.array([True, False, True, True, True, True])
    relayed = host.relay(values, live)
    payloads = host.sense_payloads(SenseFrame(1, np.ones((6, 3), np.bool_), np.zeros((6, 2))), relayed)
    heard = [
        member.join_links([], [member.decode_sense(0, payload)[1]])
        for member, payload in zip(members, payloads, strict=True)
    ]
    assert [sent.tolist() for sent, _ in heard] == [[True] * 3, [True, False, True]]
    assert [bool(one["there"]) for one in heard[1][1]] == [True, False, True]


@pytest.mark.parametrize("shards", [[[0, 2, 4], [1, 3, 5]], [[5], [3], [0, 1, 2], [4]]])
def test_messages_find_their_receivers_whatever_the_order_of_shards_and_cells(
    shards: list[list[int]],
) -> None:
    partition = Partition(grid(2, 3), shards)
    wiring = RunSchema("test", partition, SensorSchema(1), check_message(np.dtype([("name", "<i8")])))
    host = FORMATS["relayed"].coordinator(wiring)
    members = [FORMATS["relayed"].participant(wiring, shard) for shard in range(len(shards))]
    values: list[Any] = []
    for shard, member in enumerate(members):
        out, cells = partition.outgoing(shard), partition.cells(shard)
        message = np.zeros(len(out), wiring.message)
        message["name"] = 10 * out.source + out.source_side
        drive = DriveFrame(0, np.stack([cells, -cells], axis=1).astype(np.float64))
        payload = member.drive_payloads(drive, LinkFrame(0, np.ones(len(out), np.bool_), message))[0]
        values.append(host.decode_drive(shard, payload)[1])
    assert host.join_drives(values).tolist() == [[i, -i] for i in range(6)]
    there = np.arange(6).reshape(6, 1) % 2 == 0
    payloads = host.sense_payloads(SenseFrame(1, there, None), host.relay(values, None))
    for shard, (member, payload) in enumerate(zip(members, payloads, strict=True)):
        sensed = member.decode_sense(0, payload)[1]
        assert member.join_senses([sensed]).presence.tolist() == there[partition.cells(shard)].tolist()
        incoming = partition.incoming(shard)
        _, message = member.join_links([], [sensed])
        assert message["name"].tolist() == (10 * incoming.source + incoming.source_side).tolist()
