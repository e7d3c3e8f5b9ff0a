"""All wire forms carry the same values; no payload breaks them."""

from __future__ import annotations

from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from bus.errors import WireError
from bus.partition import Partition
from bus.sensors import CameraFrame, SensorSchema
from bus.wire.format import CoordinatorCodec, ParticipantCodec, RunSchema
from bus.wire.formats import FORMATS, WireFormat
from bus.wire.frames import (
    Control,
    DriveFrame,
    LinkFrame,
    Report,
    SenseFrame,
    check_message,
    decode_control,
    decode_report,
    encode_control,
    encode_report,
)
from tests.bus.support import grid

MESSAGE = check_message(
    np.dtype([("u", "<f8"), ("w", "<f4"), ("n", "<i2"), ("m", "<u8"), ("there", "?"), ("h", "<f2")])
)
FORM_NAMES: list[WireFormat] = ["packed", "per_cell", "relayed"]
FINITE = st.floats(allow_nan=False, allow_infinity=False)


def sides(
    form: WireFormat,
    *,
    encoders: bool = True,
    sensors: int = 3,
    levels: bool = False,
    labels: int = 0,
    camera: int = 0,
) -> tuple[CoordinatorCodec, list[ParticipantCodec]]:
    partition = Partition.even(grid(2, 3), 2)
    readings = SensorSchema(sensors, encoders, levels, labels, camera)
    wiring = RunSchema("test", partition, readings, MESSAGE)
    return FORMATS[form].coordinator(wiring), [FORMATS[form].participant(wiring, shard) for shard in range(2)]


PICTURE = CameraFrame(np.array([0, 2]), np.array([[0.1, -0.2, 3.0], [-0.0, 1e-300, -7.5]]))


def over_the_wire(
    form: WireFormat, sense: SenseFrame, drives: list[DriveFrame], links: list[LinkFrame]
) -> tuple[list[Any], Any, list[Any]]:
    """What each member senses, what the host gathers, and what each member receives, after encoding and decoding."""
    host, members = sides(
        form,
        encoders=sense.encoder_m is not None,
        levels=sense.level is not None,
        labels=0 if sense.label is None else 4,
    )
    driven: list[Any] = list(host.blank_drives)
    for member, drive, frame in zip(members, drives, links, strict=True):
        for key, payload in zip(member.drive_keys, member.drive_payloads(drive, frame), strict=True):
            unit = host.drive_units[key]
            tick, driven[unit] = host.decode_drive(unit, payload)
            assert tick == drive.tick
    said: dict[str, bytes] = {}
    for member, frame in zip(members, links, strict=True):
        said.update(zip(member.out_keys, member.link_payloads(frame), strict=True))
    relayed = host.relay(driven, None) if host.relays else None
    sent = dict(zip(host.sense_keys, host.sense_payloads(sense, relayed), strict=True))
    sensed: list[Any] = []
    received: list[Any] = []
    for member in members:
        units = [member.decode_sense(unit, sent[key])[1] for key, unit in member.sense_units.items()]
        sensed.append(member.join_senses(units))
        values = [member.decode_link(part, said[key])[1] for key, part in member.in_parts.items()]
        received.append(member.join_links(values, units))
    return sensed, host.join_drives(driven), received


@settings(max_examples=60)
@given(
    bits=hnp.arrays(np.bool_, (6, 3)),
    travel=hnp.arrays(np.float64, (6, 2), elements=FINITE),
    level=st.none() | hnp.arrays(np.float64, (6, 3), elements=st.floats(0.0, 1.0)),
    drive=hnp.arrays(np.float64, (6, 2), elements=FINITE),
    message=hnp.arrays(MESSAGE, (6,)),
    sent=hnp.arrays(np.bool_, (6,)),
    tick=st.integers(0, 2**62 - 1),
)
def test_all_forms_give_back_what_was_put_in_to_the_bit(
    bits: Any, travel: Any, level: Any, drive: Any, message: Any, sent: Any, tick: int
) -> None:
    expected = np.where(sent, message, np.zeros((), MESSAGE))
    for form in FORM_NAMES:
        sensed, driven, received = over_the_wire(
            form,
            SenseFrame(tick, bits, travel, level),
            [DriveFrame(tick, drive[:3]), DriveFrame(tick, drive[3:])],
            [LinkFrame(tick, sent[:3], message[:3]), LinkFrame(tick, sent[3:], message[3:])],
        )
        assert [one.presence.tolist() for one in sensed] == [bits[:3].tolist(), bits[3:].tolist()]
        assert b"".join(one.encoder_m.tobytes() for one in sensed) == travel.tobytes()
        if level is None:
            assert [one.level for one in sensed] == [None, None]
        else:
            assert b"".join(one.level.tobytes() for one in sensed) == level.tobytes()
        assert driven.tobytes() == drive.tobytes()
        # What shard 0 sends, shard 1 receives, and vice versa; NaN payloads are compared as bytes.
        for shard, (there, values) in enumerate(received):
            theirs = slice(3, 6) if shard == 0 else slice(0, 3)
            assert there.tolist() == sent[theirs].tolist()
            assert _canonical(values) == _canonical(expected[theirs])


def _canonical(message: Any) -> list[Any]:
    """Values as text, so that NaN equals NaN and -0 differs from 0."""
    return [tuple(map(repr, row)) for row in message.tolist()]


@pytest.mark.parametrize("form", FORM_NAMES)
def test_without_encoders_travel_is_nil(form: WireFormat) -> None:
    bits = np.eye(6, 3, dtype=np.bool_)
    drives = [DriveFrame(0, np.zeros((3, 2)))] * 2
    silence = [LinkFrame(0, np.zeros(3, np.bool_), np.zeros(3, MESSAGE))] * 2
    sensed, _, _ = over_the_wire(form, SenseFrame(0, bits, None), drives, silence)
    assert [one.encoder_m for one in sensed] == [None, None]
    assert np.concatenate([one.presence for one in sensed]).tolist() == bits.tolist()


@pytest.mark.parametrize("form", FORM_NAMES)
def test_a_run_without_levels_has_no_field_for_them(form: WireFormat) -> None:
    host, _ = sides(form)
    for payload in host.sense_payloads(SenseFrame(0, np.ones((6, 3), np.bool_), np.zeros((6, 2)))):
        fields = msgpack.unpackb(payload)
        links = {"sent", "message"} if form == "relayed" else set[str]()
        empty = {"level", "label"} if form == "relayed" else set[str]()
        assert fields.keys() == {"v", "tick", "presence", "encoder_m"} | links | empty
        assert {fields[name] for name in empty} <= {b""}


@pytest.mark.parametrize("form", FORM_NAMES)
def test_levels_go_without_encoders(form: WireFormat) -> None:
    host, members = sides(form, encoders=False, levels=True)
    level = np.linspace(0.0, 1.0, 18).reshape(6, 3)
    sent = dict(
        zip(host.sense_keys, host.sense_payloads(SenseFrame(3, level > 0.5, None, level)), strict=True)
    )
    for member, rows in zip(members, (slice(0, 3), slice(3, 6)), strict=True):
        values = [member.decode_sense(unit, sent[key])[1] for key, unit in member.sense_units.items()]
        sensed = member.join_senses(values)
        assert sensed.encoder_m is None
        assert sensed.level is not None
        assert sensed.level.tobytes() == level[rows].tobytes()


@pytest.mark.parametrize("form", FORM_NAMES)
@pytest.mark.parametrize("encoders", [False, True])
@pytest.mark.parametrize("levels", [False, True])
@pytest.mark.parametrize("picture", [None, PICTURE, CameraFrame(np.zeros(0, np.int64), np.zeros((0, 3)))])
def test_labels_and_pictures_survive_the_wire_whatever_else_there_is(
    form: WireFormat, encoders: bool, levels: bool, picture: CameraFrame | None
) -> None:
    host, members = sides(form, encoders=encoders, levels=levels, labels=2**16 - 1, camera=3)
    bits, label = np.eye(6, 3, dtype=np.bool_), np.array([0, 1, 255, 256, 2**16 - 1, 7])
    travel = np.linspace(-1.0, 1.0, 12).reshape(6, 2) if encoders else None
    level = np.linspace(0.0, 1.0, 18).reshape(6, 3) if levels else None
    frame = SenseFrame(3, bits, travel, level, label, picture)
    sent = dict(zip(host.sense_keys, host.sense_payloads(frame), strict=True))
    for member, rows in zip(members, (slice(0, 3), slice(3, 6)), strict=True):
        values = [member.decode_sense(unit, sent[key])[1] for key, unit in member.sense_units.items()]
        sensed = member.join_senses(values)
        assert sensed.presence.tolist() == bits[rows].tolist()
        assert sensed.label is not None
        assert (sensed.label.tolist(), sensed.label.dtype) == (label[rows].tolist(), np.int64)
        for found, expected in ((sensed.encoder_m, travel), (sensed.level, level)):
            assert (found is None) == (expected is None)
            assert found is None or expected is None or found.tobytes() == expected[rows].tobytes()
        assert (sensed.picture is None) == (picture is None)
        if picture is not None and sensed.picture is not None:
            assert sensed.picture.parcel.tolist() == picture.parcel.tolist()
            assert sensed.picture.pose.shape == picture.pose.shape
            assert sensed.picture.pose.tobytes() == picture.pose.tobytes()


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


@pytest.mark.parametrize("form", FORM_NAMES)
def test_joined_arrays_may_be_written(form: WireFormat) -> None:
    sensed, driven, received = over_the_wire(
        form,
        SenseFrame(0, np.zeros((6, 3), np.bool_), np.zeros((6, 2)), np.zeros((6, 3)), np.zeros(6, np.int64)),
        [DriveFrame(0, np.zeros((3, 2)))] * 2,
        [LinkFrame(0, np.ones(3, np.bool_), np.zeros(3, MESSAGE))] * 2,
    )
    for array in (*sensed[0][:-1], driven, *received[0]):
        assert array.flags.writeable


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


# --- payloads that are not what they should be ------------------------------------------------------


def good_payloads(form: WireFormat) -> list[tuple[Any, bytes]]:
    """Each kind of decoder with a payload that it accepts."""
    host, (member, _) = sides(form)
    travel, there = np.full((6, 2), 0.1), np.ones((6, 3), np.bool_)
    sense = host.sense_payloads(SenseFrame(5, there, travel))[0]
    seeing, (feeling, _) = sides(form, levels=True)
    levels = seeing.sense_payloads(SenseFrame(5, there, travel, np.full((6, 3), 0.1)))[0]
    drive = member.drive_payloads(DriveFrame(5, np.full((3, 2), 0.1)))[0]
    links = LinkFrame(5, np.ones(3, np.bool_), np.ones(3, MESSAGE))
    silence = LinkFrame(5, np.zeros(3, np.bool_), np.ones(3, MESSAGE))
    control = encode_control(Control("lost", 5, ((0, 1), (1, 2)), "timed_out"))
    report = encode_report(Report("failed", 5, ((0, 1),), "trace", (1, 2, 3, 4), (("lost", 5),)))
    return [
        (lambda payload: member.decode_sense(0, payload), sense),
        (lambda payload: host.decode_drive(0, payload), drive),
        *_of_links(form, links, silence),
        (lambda payload: decode_control(payload, 6), control),
        (lambda payload: decode_report(payload, 6), report),
        (lambda payload: feeling.decode_sense(0, payload), levels),
        *_of_scanners_and_camera(form),
    ]


def _of_links(form: WireFormat, *frames: LinkFrame) -> list[tuple[Any, bytes]]:
    """Of what brings messages: payloads of their own, or drives."""
    host, (member, _) = sides(form)
    drive = DriveFrame(5, np.full((3, 2), 0.1))
    if host.relays:
        return [
            (lambda payload: host.decode_drive(0, payload), member.drive_payloads(drive, links)[0])
            for links in frames
        ]
    return [
        (lambda payload: member.decode_link(0, payload), member.link_payloads(links)[0]) for links in frames
    ]


def _of_scanners_and_camera(form: WireFormat) -> list[tuple[Any, bytes]]:
    host, (member, _) = sides(form, labels=4, camera=3)
    frame = SenseFrame(5, np.ones((6, 3), np.bool_), np.full((6, 2), 0.1), None, np.arange(6) % 5)
    return [
        (lambda payload: member.decode_sense(0, payload), host.sense_payloads(one)[0])
        for one in (frame, frame._replace(picture=PICTURE))
    ]


GOOD = [(form, i) for form in FORM_NAMES for i in range(9)]


@pytest.mark.parametrize(("form", "which"), GOOD)
@settings(max_examples=150)
@given(data=st.data())
def test_a_mutated_payload_is_read_or_refused_and_nothing_else(
    form: WireFormat, which: int, data: Any
) -> None:
    decode, good = good_payloads(form)[which]
    payload = bytearray(good)
    for _ in range(data.draw(st.integers(1, 4))):
        kind = data.draw(st.sampled_from(["flip", "cut", "insert", "splice"]))
        at = data.draw(st.integers(0, max(len(payload) - 1, 0)))
        if kind == "flip" and payload:
            payload[at] = data.draw(st.integers(0, 255))
        elif kind == "cut":
            del payload[at : at + data.draw(st.integers(1, 8))]
        elif kind == "insert":
            payload[at:at] = data.draw(st.binary(min_size=1, max_size=6))
        else:
            payload[at:at] = payload[: data.draw(st.integers(0, len(payload)))]
    _read_or_refused(decode, bytes(payload))


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text(max_size=5)
    | st.binary(max_size=60),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=8,
)  # fmt: skip


@pytest.mark.parametrize(("form", "which"), GOOD)
@settings(max_examples=100)
@given(data=st.data())
def test_a_payload_with_other_values_is_read_or_refused_and_nothing_else(
    form: WireFormat, which: int, data: Any
) -> None:
    decode, good = good_payloads(form)[which]
    fields = msgpack.unpackb(good)
    for name in data.draw(st.lists(st.sampled_from(sorted(fields)), min_size=1, max_size=3)):
        fields[name] = data.draw(VALUES)
    _read_or_refused(decode, msgpack.packb(fields))


@pytest.mark.parametrize("form", FORM_NAMES)
@given(payload=st.binary(max_size=200))
def test_any_bytes_are_read_or_refused_and_nothing_else(form: WireFormat, payload: bytes) -> None:
    for decode, _ in good_payloads(form):
        _read_or_refused(decode, payload)


def _read_or_refused(decode: Any, payload: bytes) -> None:
    try:
        decode(payload)
    except WireError as error:
        said = error
    else:
        return
    assert said.kind in said.name
    assert len(str(said)) < 500


def refusal(decode: Any, fields: object) -> str:
    with pytest.raises(WireError) as caught:
        decode(fields if isinstance(fields, bytes) else msgpack.packb(fields))
    return caught.value.name


def test_every_refusal_has_a_name() -> None:
    host, (member, _) = sides("per_cell")
    drive = {"v": 2, "tick": 0, "drive": [0.0, 0.0]}

    def decode(payload: bytes) -> object:
        return host.decode_drive(0, payload)

    assert refusal(decode, b"\xc1") == "drive: encoding"
    assert refusal(decode, b"\x00" * 500) == "drive: length"
    assert refusal(decode, [1, 2]) == "drive: type"
    assert refusal(decode, {**drive, "v": 1}) == "drive: version"
    assert refusal(decode, {"tick": 0, "drive": [0.0, 0.0]}) == "drive: version"
    assert refusal(decode, {**drive, "more": 1}) == "drive: fields"
    assert refusal(decode, {**drive, "tick": -1}) == "drive: tick"
    assert refusal(decode, {**drive, "tick": 1.0}) == "drive: tick"
    assert refusal(decode, {**drive, "tick": True}) == "drive: tick"
    assert refusal(decode, {**drive, "drive": [0.0]}) == "drive: type"
    assert refusal(decode, {**drive, "drive": [0.0, "1"]}) == "drive: type"
    assert refusal(decode, {**drive, "drive": [0.0, float("nan")]}) == "drive: finite"
    assert refusal(decode, {**drive, "drive": [float("inf"), 0.0]}) == "drive: finite"

    link = {"v": 2, "tick": 0, "u": 0.0, "w": 0.0, "n": 0, "m": 0, "there": True, "h": 0.0}

    def decode_link(payload: bytes) -> object:
        return member.decode_link(0, payload)

    assert refusal(decode_link, {**link, "n": 40_000}) == "link: range"
    assert refusal(decode_link, {**link, "m": -1}) == "link: range"
    assert refusal(decode_link, {**link, "w": 1e300}) == "link: range"
    assert refusal(decode_link, {**link, "h": 1e6}) == "link: range"
    assert refusal(decode_link, {**link, "n": 1.5}) == "link: type"
    assert refusal(decode_link, {**link, "there": 1}) == "link: type"
    assert refusal(decode_link, {**link, "u": "0"}) == "link: type"
    assert refusal(decode_link, {"v": 2, "tick": 0, "u": 0.0}) == "link: fields"


def test_packed_bits_beyond_the_last_and_odd_sizes_are_refused() -> None:
    host, (member, _) = sides("packed")
    sense = msgpack.unpackb(
        host.sense_payloads(SenseFrame(0, np.zeros((6, 3), np.bool_), np.zeros((6, 2))))[0]
    )

    def decode(payload: bytes) -> object:
        return member.decode_sense(0, payload)

    assert refusal(decode, {**sense, "presence": b"\x00\x02"}) == "sense: bits"
    assert refusal(decode, {**sense, "presence": b"\x00"}) == "sense: size"
    assert refusal(decode, {**sense, "encoder_m": None}) == "sense: size"
    assert refusal(decode, {**sense, "encoder_m": b"\xff" * 48}) == "sense: finite"
    link = msgpack.unpackb(member.link_payloads(LinkFrame(0, np.ones(3, np.bool_), np.zeros(3, MESSAGE)))[0])
    odd = bytearray(link["message"])
    odd[MESSAGE.fields["there"][1]] = 7  # type: ignore[index]
    assert refusal(lambda p: member.decode_link(0, p), {**link, "message": bytes(odd)}) == "link: type"


def test_a_level_that_is_no_share_is_refused_and_so_is_one_where_none_was_agreed() -> None:
    there, travel, level = np.ones((6, 3), np.bool_), np.zeros((6, 2)), np.full((6, 3), 0.5)
    for form in FORM_NAMES:
        host, (member, _) = sides(form, levels=True)
        _, (plain, _) = sides(form)
        good = host.sense_payloads(SenseFrame(0, there, travel, level))[0]
        unasked = {"packed": "sense: length", "per_cell": "sense: fields", "relayed": "sense: size"}
        bare = msgpack.packb(
            {name: value for name, value in msgpack.unpackb(good).items() if name != "level"}
        )
        assert refusal(lambda p, m=member: m.decode_sense(0, p), bare) == "sense: fields"
        assert refusal(lambda p, m=plain: m.decode_sense(0, p), good) == unasked[form]
        for bad in (-1e-9, np.nextafter(1.0, 2.0), np.inf, np.nan):
            wrong = level.copy()
            wrong[0, 2] = bad
            payload = host.sense_payloads(SenseFrame(0, there, travel, wrong))[0]
            assert refusal(lambda p, m=member: m.decode_sense(0, p), payload) == "sense: range"
    # whole numbers, and lists that are none
    host, (member, _) = sides("per_cell", levels=True)
    fields = {"v": 2, "tick": 0, "presence": [True] * 3, "encoder_m": [0, 0]}
    assert member.decode_sense(0, msgpack.packb({**fields, "level": [0, 1, 0.5]}))[0] == 0
    assert refusal(lambda p: member.decode_sense(0, p), {**fields, "level": [0.5, 0.5]}) == "sense: type"
    assert (
        refusal(lambda p: member.decode_sense(0, p), {**fields, "level": [0.5, True, 0.5]}) == "sense: type"
    )
    host, (member, _) = sides("packed", levels=True)
    sense = msgpack.unpackb(host.sense_payloads(SenseFrame(0, there, travel, level))[0])
    assert refusal(lambda p: member.decode_sense(0, p), {**sense, "level": b"\x00" * 24}) == "sense: size"


@pytest.mark.parametrize("form", FORM_NAMES)
def test_labels_and_pictures_that_no_run_can_have_are_refused(form: WireFormat) -> None:
    host, (member, _) = sides(form, labels=4, camera=3)
    frame = SenseFrame(0, np.ones((6, 3), np.bool_), np.zeros((6, 2)), None, np.zeros(6, np.int64), PICTURE)

    def refused(**changed: object) -> str:
        good = msgpack.unpackb(host.sense_payloads(frame)[0])
        return refusal(lambda payload: member.decode_sense(0, payload), {**good, **changed})

    too_large = host.sense_payloads(frame._replace(label=np.full(6, 5), picture=None))[0]
    assert refusal(lambda payload: member.decode_sense(0, payload), too_large) == "sense: range"
    assert refused(label=b"\x00" * 5) == ("sense: type" if form == "per_cell" else "sense: size")
    assert refused(label=True) == ("sense: type" if form == "per_cell" else "sense: size")
    row = [1, 0.0, 0.0, 0.0]
    for picture in (1, [1], [row[:3]], [[*row, 0.0]], [[1.0, *row[1:]]], [[True, *row[1:]]], [row] * 4):
        assert refused(picture=picture) == "sense: type"
    for picture in ([row, row], [[2, *row[1:]], row], [[3, *row[1:]]], [[-1, *row[1:]]]):
        assert refused(picture=picture) == "sense: range"
    assert refused(picture=[[1, 0.0, float("nan"), 0.0]]) == "sense: finite"
    plain, _ = sides(form)[1]
    pictured = host.sense_payloads(frame)[0]
    assert refusal(lambda payload: plain.decode_sense(0, payload), pictured) in (
        "sense: length",
        "sense: fields",
    )


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


def test_records_survive_the_wire() -> None:
    control = Control("lost", 12, ((0, 1), (3, 4)), "disconnected")
    assert decode_control(encode_control(control), 2) == control
    counters = tuple((f"{i:064}", i) for i in range(64))
    report = Report("failed", 12, ((0, 1),), "ZeroDivisionError", (5, 6, 7, 8), counters)
    assert decode_report(encode_report(report), 1) == report


@pytest.mark.parametrize(
    "counters",
    [
        tuple((f"{i}", i) for i in range(65)),
        (("x" * 65, 1),),
        (("lost", -1),),
        (("lost", True),),
        (("lost",),),
        ((1, 1),),
    ],
)
def test_counters_that_are_none_are_refused(counters: Any) -> None:
    report = Report("counters", 12, (), "", (5, 6, 7, 8), counters)
    assert refusal(lambda p: decode_report(p, 1), encode_report(report)) == "report: type"


def test_a_record_names_no_more_cells_than_there_are() -> None:
    payload = encode_control(Control("lost", 0, ((0, 0), (0, 1))))
    assert refusal(lambda p: decode_control(p, 1), payload) == "control: type"


@pytest.mark.parametrize(
    "dtype",
    [
        np.dtype("<f8"),
        np.dtype([("tick", "<f8")]),
        np.dtype([("v", "<f8")]),
        np.dtype([("u", "<f8", (2,))]),
        np.dtype([("u", "O")]),
        np.dtype([("u", "S4")]),
        np.dtype([("u", "<c16")]),
        np.dtype([("u", "<M8[s]")]),
        np.dtype([("u", np.dtype([("x", "<f8")]))]),
        np.dtype([(f"u{i}", "<f8") for i in range(65)]),
    ],
)
def test_a_message_type_that_can_t_go_over_the_wire_is_refused(dtype: np.dtype[Any]) -> None:
    with pytest.raises(WireError, match="message payload: type"):
        check_message(dtype)


def test_a_message_type_is_made_packed_and_little_endian() -> None:
    loose = np.dtype([("n", ">i2"), ("u", "=f8")], align=True)
    packed = check_message(loose)
    assert packed.itemsize == 10
    assert packed == np.dtype([("n", "<i2"), ("u", "<f8")])
