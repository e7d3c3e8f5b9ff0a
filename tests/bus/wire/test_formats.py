"""All wire formats carry the same values."""

from __future__ import annotations

from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from bus.sensors import CameraFrame
from bus.wire.formats import WireFormat
from bus.wire.frames import DriveFrame, LinkFrame, SenseFrame
from tests.bus.support import FORMS
from tests.bus.wire.codecs import MESSAGE, PICTURE, sides

FINITE = st.floats(allow_nan=False, allow_infinity=False)


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
    for form in FORMS:
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


@pytest.mark.parametrize("form", FORMS)
def test_without_encoders_travel_is_nil(form: WireFormat) -> None:
    bits = np.eye(6, 3, dtype=np.bool_)
    drives = [DriveFrame(0, np.zeros((3, 2)))] * 2
    silence = [LinkFrame(0, np.zeros(3, np.bool_), np.zeros(3, MESSAGE))] * 2
    sensed, _, _ = over_the_wire(form, SenseFrame(0, bits, None), drives, silence)
    assert [one.encoder_m for one in sensed] == [None, None]
    assert np.concatenate([one.presence for one in sensed]).tolist() == bits.tolist()


@pytest.mark.parametrize("form", FORMS)
def test_a_run_without_levels_has_no_field_for_them(form: WireFormat) -> None:
    host, _ = sides(form)
    for payload in host.sense_payloads(SenseFrame(0, np.ones((6, 3), np.bool_), np.zeros((6, 2)))):
        fields = msgpack.unpackb(payload)
        links = {"sent", "message"} if form == "relayed" else set[str]()
        empty = {"level", "label"} if form == "relayed" else set[str]()
        assert fields.keys() == {"v", "tick", "presence", "encoder_m"} | links | empty
        assert {fields[name] for name in empty} <= {b""}


@pytest.mark.parametrize("form", FORMS)
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


@pytest.mark.parametrize("form", FORMS)
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


@pytest.mark.parametrize("form", FORMS)
def test_joined_arrays_may_be_written(form: WireFormat) -> None:
    sensed, driven, received = over_the_wire(
        form,
        SenseFrame(0, np.zeros((6, 3), np.bool_), np.zeros((6, 2)), np.zeros((6, 3)), np.zeros(6, np.int64)),
        [DriveFrame(0, np.zeros((3, 2)))] * 2,
        [LinkFrame(0, np.ones(3, np.bool_), np.zeros(3, MESSAGE))] * 2,
    )
    for array in (*sensed[0][:-1], driven, *received[0]):
        assert array.flags.writeable
