"""Frames for viewers: encoded and decoded, and refused where they are none."""

from __future__ import annotations

import random
from dataclasses import replace

import msgpack
import numpy as np
import pytest

from deploy.errors import DeployError
from deploy.live.frame import RunFrame, decode

RNG = np.random.default_rng(4)
FRAME = RunFrame(
    tick=12,
    time_s=0.05,
    parcels=RNG.normal(size=(3, 6)),
    in_play=np.array([True, False, True]),
    status=("moving", "waiting", "tipped"),
    wheel_speeds=RNG.normal(size=(7, 2)).astype(np.float32),
    presence=RNG.random((7, 5)) < 0.5,
    health=np.array([0, 1, 2, 0, 0, 0, 0], dtype=np.uint8),
    state="paused",
    speed=None,
    real_time_factor=0.5,
    lag_s=0.1,
    events=({"time_s": 0.1, "kind": "tipped"},),
    faults=(),
    first_event=3,
)


@pytest.mark.parametrize(
    "frame", [FRAME, replace(FRAME, parcels=np.zeros((0, 6)), in_play=np.zeros(0, bool), status=())]
)
def test_a_frame_is_decoded_as_it_was(frame: RunFrame) -> None:
    found, header = decode(frame.encode({"run": "one"}))
    assert header == {"run": "one"}
    for name in RunFrame.__slots__:
        value, expected = getattr(found, name), getattr(frame, name)
        if isinstance(expected, np.ndarray):
            assert value.dtype == expected.dtype
            np.testing.assert_array_equal(value, expected)
        else:
            assert value == expected


def test_nothing_but_a_frame_is_decoded() -> None:
    payload, draws = FRAME.encode(), random.Random("frames with other bytes")
    for _ in range(2_000):
        changed = bytearray(payload[: draws.randrange(len(payload) + 1)])
        for _ in range(draws.randrange(4)):
            if changed:
                changed[draws.randrange(len(changed))] = draws.randrange(256)
        try:
            decode(bytes(changed))
        except DeployError as error:
            assert "not a frame" in str(error)  # noqa: PT017


def test_presence_bits_that_are_not_there_are_refused_before_room_is_made_for_them() -> None:
    fields = msgpack.unpackb(FRAME.encode())
    fields["presence"][0] = 10**12
    with pytest.raises(DeployError, match="5 bytes of presence bits for 7 cells with 1000000000000 sensors"):
        decode(msgpack.packb(fields))
