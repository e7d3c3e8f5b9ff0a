"""A cell's payloads in the wire format ``per_cell`` are maps that any tool reads and writes."""

from __future__ import annotations

import msgpack
import numpy as np

from bus.wire.frames import DriveFrame, LinkFrame, SenseFrame
from tests.bus.wire.codecs import MESSAGE, PICTURE, sides


def test_a_cell_receives_its_label_and_the_camera_frame_as_plain_numbers() -> None:
    host, _ = sides("per_cell", encoders=False, labels=4, camera=3)
    bits, label = np.eye(6, 3, dtype=np.bool_), np.arange(6) % 5
    record = {"v": 2, "tick": 0, "presence": [False, True, False], "encoder_m": None, "label": 1}
    assert msgpack.unpackb(host.sense_payloads(SenseFrame(0, bits, None, None, label))[1]) == {
        **record,
        "picture": None,
    }
    assert msgpack.unpackb(host.sense_payloads(SenseFrame(0, bits, None, None, label, PICTURE))[1]) == {
        **record,
        "picture": [[0, 0.1, -0.2, 3.0], [2, -0.0, 1e-300, -7.5]],
    }


def test_a_cell_s_payloads_are_maps_that_any_tool_reads() -> None:
    host, (member, _) = sides("per_cell", encoders=False)
    bits = np.array([[True, False, True]] + [[False] * 3] * 5)
    assert msgpack.unpackb(host.sense_payloads(SenseFrame(7, bits, None))[0]) == {
        "v": 2,
        "tick": 7,
        "presence": [True, False, True],
        "encoder_m": None,
    }
    levelled, _ = sides("per_cell", encoders=False, levels=True)
    assert msgpack.unpackb(levelled.sense_payloads(SenseFrame(7, bits, None, 0.25 * bits))[0]) == {
        "v": 2,
        "tick": 7,
        "presence": [True, False, True],
        "encoder_m": None,
        "level": [0.25, 0.0, 0.25],
    }
    drive = DriveFrame(7, np.array([[0.5, -0.25]] * 3))
    assert msgpack.unpackb(member.drive_payloads(drive)[0]) == {"v": 2, "tick": 7, "drive": [0.5, -0.25]}
    message = np.zeros(3, MESSAGE)
    message[0] = (0.1, 0.5, -3, 9, True, 2.0)
    payloads = member.link_payloads(LinkFrame(7, np.array([True, False, False]), message))
    assert msgpack.unpackb(payloads[0]) == {
        "v": 2, "tick": 7, "u": 0.1, "w": 0.5, "n": -3, "m": 9, "there": True, "h": 2.0,
    }  # fmt: skip
    assert msgpack.unpackb(payloads[1]) == {"v": 2, "tick": 7}


def test_a_tool_may_write_whole_numbers_where_floats_are_meant() -> None:
    host, (member, _) = sides("per_cell")
    payload = msgpack.packb({"v": 2, "tick": 0, "drive": [1, -2]})
    assert host.join_drives([host.decode_drive(0, payload)[1]]).tolist() == [[1.0, -2.0]]
    fields = {"u": 3, "w": 1, "n": 1, "m": 1, "there": False, "h": 1}
    _, packed = member.decode_link(0, msgpack.packb({"v": 2, "tick": 0, **fields}))
    assert np.frombuffer(packed, MESSAGE).tolist() == [(3.0, 1.0, 1, 1, False, 1.0)]
