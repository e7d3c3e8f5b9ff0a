"""Vectors, nested records and bounded lists over every wire format, and what is refused of them."""

from __future__ import annotations

from typing import Any

import msgpack
import numpy as np
import pytest

from bus.errors import WireError
from bus.wire.formats import FORMATS
from bus.wire.frames import DriveFrame, LinkFrame, SenseFrame
from bus.wire.keys import WireFormat
from bus.wire.message_type import bounded_list, bounded_lists, clear_tails, leaves, overlong
from tests.bus.wire.codecs import sides

POSE = np.dtype([("x", "<f8"), ("turns", "<i2")])
MESSAGE = np.dtype(
    [
        ("small", "u1"),
        ("vector", "<f4", (3,)),
        ("flags", "?", (2,)),
        ("grid", "<f2", (2, 2)),
        ("pose", [("at", POSE), ("sure", "?")]),
        ("corners", POSE, (2,)),
        ("route", bounded_list("<i2", 300)),
        ("marks", bounded_list(POSE, 2)),
    ]
)


def messages(count: int, seed: int) -> np.ndarray:
    """Random messages, with lists up to their bounds."""
    draw = np.random.default_rng(seed)
    found = np.zeros(count, dtype=MESSAGE)
    for leaf in leaves(MESSAGE):
        shape = (count, *leaf.shape)
        leaf.of(found)[...] = draw.normal(size=shape) if leaf.type.kind == "f" else draw.integers(0, 2, shape)
    found["route"]["length"] = draw.integers(0, 301, count)
    found["marks"]["length"] = np.arange(count) % 3
    clear_tails(found, MESSAGE)
    return found


def put(form: WireFormat, message: np.ndarray) -> tuple[list[Any], list[Any]]:
    """What each of two shards receives of the other's messages, and the payloads that carried them."""
    host, members = sides(form, message=MESSAGE)
    driven: list[Any] = list(host.blank_drives)
    payloads: dict[str, bytes] = {}
    for shard, member in enumerate(members):
        links = LinkFrame(4, np.ones(3, np.bool_), message[3 * shard : 3 * shard + 3])
        drives = member.drive_payloads(DriveFrame(4, np.zeros((3, 2))), links)
        for key, payload in zip(member.drive_keys, drives, strict=True):
            driven[host.drive_units[key]] = host.decode_drive(host.drive_units[key], payload)[1]
            if host.relays:
                payloads[key] = payload
        payloads.update(zip(member.out_keys, member.link_payloads(links), strict=True))
    relayed = host.relay(driven, None) if host.relays else None
    frame = SenseFrame(5, np.zeros((6, 3), np.bool_), np.zeros((6, 2)))
    senses = dict(zip(host.sense_keys, host.sense_payloads(frame, relayed), strict=True))
    received: list[Any] = []
    for member in members:
        units = [member.decode_sense(unit, senses[key])[1] for key, unit in member.sense_units.items()]
        values = [member.decode_link(part, payloads[key])[1] for key, part in member.in_parts.items()]
        received.append(member.join_links(values, units)[1])
    return received, list(payloads.values())


@pytest.mark.parametrize("form", FORMATS)
def test_every_format_gives_back_what_was_put_in(form: WireFormat) -> None:
    for seed in range(5):
        message = messages(6, seed)
        received, _ = put(form, message)
        assert [one.tobytes() for one in received] == [message[3:].tobytes(), message[:3].tobytes()]


def test_per_cell_names_nested_fields_by_dots_and_has_vectors_as_lists() -> None:
    message = messages(6, 1)
    message["vector"], message["flags"][0], message["pose"]["at"]["turns"][0] = 0.5, (True, False), -7
    fields = msgpack.unpackb(put("per_cell", message)[1][0])
    assert list(fields) == ["v", "tick", *(leaf.name for leaf in leaves(MESSAGE))]
    assert fields["vector"] == [0.5, 0.5, 0.5]
    assert fields["flags"] == [True, False]
    assert fields["pose.at.turns"] == -7
    assert fields["corners.1.x"] == message["corners"]["x"][0, 1]
    assert fields["route.items"] == message["route"]["items"][0].tolist()
    assert len(fields["grid"]) == 4


def test_per_cell_reads_narrower_numbers_and_refuses_other_shapes() -> None:
    _, (member, _) = sides("per_cell", message=MESSAGE)
    good = msgpack.unpackb(put("per_cell", messages(6, 2))[1][0])
    good["vector"] = [1, 2, 3]
    _, packed = member.decode_link(0, msgpack.packb(good))
    assert np.frombuffer(packed, MESSAGE)["vector"].tolist() == [[1.0, 2.0, 3.0]]
    for name, value, problem in [
        ("vector", [1.0, 2.0], "vector must be a list of 3"),
        ("vector", 1.0, "vector must be a list of 3"),
        ("flags", [1, 0], "flags must be a boolean"),
        ("pose.at.turns", 40000, "pose.at.turns must be in -32768..32767"),
        ("route.length", 301, "route.length must be in 0..300"),
        ("marks.length", 3, "marks.length must be in 0..2"),
    ]:
        with pytest.raises(WireError, match=problem):
            member.decode_link(0, msgpack.packb({**good, name: value}))


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize(("name", "length"), [("route", 301), ("marks", 3)])
def test_a_list_longer_than_its_bound_is_refused(form: WireFormat, name: str, length: int) -> None:
    message = messages(6, 3)
    message[name]["length"][1] = length
    assert overlong(message, MESSAGE).tolist() == [False, True, False, False, False, False]
    with pytest.raises(WireError, match=r"must not be longer than its bound|length must be in 0"):
        put(form, message)


@pytest.mark.parametrize("form", [form for form in FORMATS if form != "per_cell"])
def test_booleans_in_vectors_and_records_are_checked(form: WireFormat) -> None:
    for path in ("flags", "pose.sure"):
        message = messages(6, 4)
        (leaf,) = (leaf for leaf in leaves(MESSAGE) if leaf.name == path)
        leaf.of(message).view(np.uint8)[2] = 2
        with pytest.raises(WireError, match=r"must be a boolean|booleans"):
            put(form, message)


def test_items_beyond_the_length_of_a_list_are_made_zero() -> None:
    message = np.ones(2, dtype=MESSAGE)
    message["route"]["length"] = [0, 2]
    clear_tails(message, MESSAGE)
    assert message["route"]["items"].sum(axis=1).tolist() == [0, 2]
    assert message["marks"]["items"].tolist() == [[(1.0, 1), (0.0, 0)]] * 2
    assert [one.most for one in bounded_lists(MESSAGE)] == [300, 2]
