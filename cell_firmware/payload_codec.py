"""Payloads of a shard's ticks, read into and written from the buffers of its kernel."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import chain
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from bus.wire.fixed_layout import Layouts, PayloadLayout
from bus.wire.message_type import boolean_places, bounded_lists, overlong
from cell_firmware.kernels import payload as kernels
from cell_firmware.kernels.arguments import message_bytes
from cell_firmware.shard_kernel import TickBuffers

_LARGE: Final = 65_536
"""Bytes of a payload from which copying it once more takes longer than a few objects of Python."""


@final
class PayloadCodec:
    """Codec of a shard's only payload each way in a tick, by kernels.

    Args:
        layouts: Layouts of the payload that arrives and of the one that is sent, by tick.
        buffers: Inputs and outputs of the shard's ticks.
    """

    def __init__(self, layouts: Layouts, buffers: TickBuffers) -> None:
        self._layouts, self._buffers = layouts, buffers
        self._border = buffers.border
        booleans = boolean_places(self._border.dtype) if self._border.dtype.names else {}
        self._booleans = np.array([*chain.from_iterable(booleans.values())], dtype=np.int64)
        self._has_lists = bool(bounded_lists(self._border.dtype))
        self._end_tick = 0
        """First tick whose payloads have other layouts than the last."""

    def _lay_out(self, tick: int) -> None:
        """Follow the layouts of the payloads of a tick."""
        buffers, layouts = self._buffers, self._layouts(tick)
        assert layouts is not None, "this is a bug: there are payloads of several kinds"
        sense, drive = layouts
        given = {
            "presence": buffers.presence,
            "encoder_m": buffers.encoder_m,
            "sent": buffers.received,
            "message": buffers.border,
        }
        done = {"drive": buffers.drive, "sent": buffers.sent, "message": buffers.message}
        self._size = len(sense.constant)
        self._constant = np.frombuffer(sense.constant, np.uint8)
        self._sense_tick, self._drive_tick = sense.places["tick"], drive.places["tick"]
        self._sense_fields, self._drive_fields = _fields(sense, given), _fields(drive, done)
        self._payload = np.frombuffer(bytearray(drive.constant), np.uint8)
        self._parts = _parts(drive, done)
        self._end_tick = min(sense.end_tick, drive.end_tick)

    def read(self, tick: int, payload: bytes) -> bool:
        """Read a sense payload into the buffers; False if it isn't a valid one of this tick in this layout.

        Args:
            tick: Its tick; ticks ascend.
            payload: The payload.
        """
        if tick >= self._end_tick:
            self._lay_out(tick)
        if len(payload) != self._size:
            return False
        is_valid = kernels.read_payload(
            tick, np.frombuffer(payload, np.uint8), self._constant, *self._sense_tick, self._sense_fields,
            self._booleans,
        )  # fmt: skip
        if is_valid and self._has_lists:
            return not overlong(self._border, self._border.dtype).any()
        return is_valid

    def write(self, tick: int) -> bytes:
        """Return the drive payload of the buffers; drives must be finite. Ticks ascend."""
        if tick >= self._end_tick:
            self._lay_out(tick)
        if self._payload.size > _LARGE:
            self._parts[1] = tick.to_bytes(self._drive_tick[1], "big")
            return b"".join(self._parts)
        kernels.write_payload(tick, *self._drive_tick, self._drive_fields, self._payload)
        return self._payload.tobytes()


def _parts(layout: PayloadLayout, buffers: Mapping[str, NDArray[Any]]) -> list[bytes | memoryview]:
    """Return what a payload consists of: constant bytes before each place, and what is in the place, or nothing yet."""
    parts, end = list[bytes | memoryview](), 0
    for name, (start, size) in layout.places.items():
        # without messages there are none in a payload, but links that could bring some
        is_empty = name == "tick" or not size
        parts += [layout.constant[end:start], b"" if is_empty else message_bytes(buffers[name]).data]
        end = start + size
    return [*parts, layout.constant[end:]]


def _fields(layout: PayloadLayout, buffers: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
    """Return the fields of a payload that have bytes, as records of ``kernels.FIELD``."""
    rows: list[tuple[int, int, int, bool, bool, int, int]] = []
    for name, (start, size) in layout.places.items():
        if name == "tick" or not size:
            continue
        buffer = buffers[name]
        bits = layout.bits.get(name, 0)
        assert buffer.nbytes == (bits or size), f"this is a bug: {size} bytes of {name} for {buffer.nbytes}"
        item = buffer.dtype.itemsize if buffer.dtype.names else 0
        rows.append(
            (start, size, buffer.ctypes.data, buffer.dtype.kind == "b", buffer.dtype.kind == "f", item, bits)
        )
    return np.array(rows, dtype=kernels.FIELD)
