"""No payload breaks a wire format: each is read, or refused under a name."""

from __future__ import annotations

from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bus.errors import WireError
from bus.wire.formats import WireFormat
from bus.wire.frames import (
    Control,
    DriveFrame,
    LinkFrame,
    Report,
    SenseFrame,
    decode_control,
    decode_report,
    encode_control,
    encode_report,
)
from tests.bus.support import FORMS
from tests.bus.wire.codecs import MESSAGE, PICTURE, refusal, sides


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


GOOD = [(form, i) for form in FORMS for i in range(9)]


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


@pytest.mark.parametrize("form", FORMS)
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
    for form in FORMS:
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


@pytest.mark.parametrize("form", FORMS)
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
