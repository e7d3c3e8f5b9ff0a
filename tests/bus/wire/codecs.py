"""Both sides of each wire format, for a run of two shards."""

from __future__ import annotations

from typing import Any

import msgpack
import numpy as np
import pytest

from bus.errors import WireError
from bus.partition import Partition
from bus.sensors import CameraFrame, SensorSchema
from bus.wire.format import CoordinatorCodec, ParticipantCodec, RunSchema
from bus.wire.formats import FORMATS, WireFormat
from bus.wire.message_type import check_message
from tests.bus.support import grid

MESSAGE = check_message(
    np.dtype([("u", "<f8"), ("w", "<f4"), ("n", "<i2"), ("m", "<u8"), ("there", "?"), ("h", "<f2")])
)
PICTURE = CameraFrame(np.array([0, 2]), np.array([[0.1, -0.2, 3.0], [-0.0, 1e-300, -7.5]]))


def sides(
    form: WireFormat,
    *,
    encoders: bool = True,
    sensors: int = 3,
    levels: bool = False,
    labels: int = 0,
    camera: int = 0,
    message: np.dtype[Any] = MESSAGE,
) -> tuple[CoordinatorCodec, list[ParticipantCodec]]:
    partition = Partition.even(grid(2, 3), 2)
    readings = SensorSchema(sensors, encoders, levels, labels, camera)
    wiring = RunSchema("test", partition, readings, message)
    return FORMATS[form].coordinator(wiring), [FORMATS[form].participant(wiring, shard) for shard in range(2)]


def refusal(decode: Any, fields: object) -> str:
    with pytest.raises(WireError) as caught:
        decode(fields if isinstance(fields, bytes) else msgpack.packb(fields))
    return caught.value.name
