"""What a cell senses, in the form of one key a cell: maps that any tool reads."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any, Final, final

import numpy as np

from bus import codec, readings_codec, wire
from bus.fixed import Decode, Fixed, Place, flags
from bus.forms.form import Senses
from bus.readings import Picture, Readings

VALUE: Final = 80
"""Bytes that one named value of a payload may take, its name included up to four fifths of that."""
PAIR: Final = struct.Struct("<2d")
Sensed = tuple[bytes, bytes, bytes, int, Picture | None]
"""Of a cell: presence a byte each; travel and levels packed, empty where there are none; its label; a picture."""


def blank(readings: Readings) -> Sensed:
    """What stands for a cell that senses nothing."""
    return bytes(readings.sensors), bytes(PAIR.size), bytes(8 * readings.sensors), 0, None


def _places(readings: Readings) -> dict[str, Place]:
    """What stands under each name, in a tick without a picture."""
    places: dict[str, Place] = {
        "presence": readings.sensors,
        "encoder_m": ("d", "d") if readings.encoders else None,
    }
    if readings.levels:
        places["level"] = ("d",) * readings.sensors
    if readings.labels:
        places["label"] = "H"
    if readings.camera:
        places["picture"] = None
    return places


@final
class SenseWriter:
    """Makes a payload a cell; for one thread at a time.

    Args:
        readings: What there is to read.
    """

    def __init__(self, readings: Readings) -> None:
        self._readings = readings
        self._fixed = Fixed(_places(readings))
        self._pack = codec.packer()

    def write(self, frame: wire.SenseFrame) -> list[bytes]:
        """``{"presence": [bool, ...], "encoder_m": [x, y] | nil}``, and what else there is to read."""
        if frame.picture is not None:
            return self._write_pictured(frame, frame.picture)
        sensors, write = self._readings.sensors, self._fixed.write
        there = frame.presence.tobytes()
        presence = [there[i : i + sensors] for i in range(0, len(there), sensors)]
        rows: list[tuple[Any, ...]] = [(bits,) for bits in presence]
        numbers = [part for part in (frame.encoder_m, frame.level) if part is not None]
        for part in numbers:
            rows = [(*row, *more) for row, more in zip(rows, part.tolist(), strict=True)]
        if frame.label is not None:
            rows = [(*row, label) for row, label in zip(rows, frame.label.tolist(), strict=True)]
        if numbers:
            return write(frame.tick, rows)
        # Without numbers all cells that sense alike get the same bytes: encode each pattern once.
        patterns = list(set(rows))
        made = dict(zip(patterns, write(frame.tick, patterns), strict=True))
        return [made[row] for row in rows]

    def _write_pictured(self, frame: wire.SenseFrame, picture: Picture) -> list[bytes]:
        """In a tick in which a picture comes in: not the same places as ever."""
        n, shown = len(frame.presence), readings_codec.picture_rows(picture)
        columns: dict[str, list[Any]] = {
            "presence": frame.presence.tolist(),
            "encoder_m": [None] * n if frame.encoder_m is None else frame.encoder_m.tolist(),
        }
        if frame.level is not None:
            columns["level"] = frame.level.tolist()
        if frame.label is not None:
            columns["label"] = frame.label.tolist()
        envelope = {"v": codec.VERSION, "tick": frame.tick}
        return [
            self._pack(
                {**envelope, **{name: column[i] for name, column in columns.items()}, "picture": shown}
            )
            for i in range(n)
        ]


def joined(readings: Readings, values: list[Sensed]) -> Senses:
    """What so many cells sense; the picture is the first one's that has one: all are told the same."""
    bits, travel, levels, labels, pictures = zip(*values, strict=True)
    each = (len(values), readings.sensors)
    presence, encoder_m, level, label = np.ndarray(each, np.bool_, bytearray().join(bits)), None, None, None
    if readings.encoders:
        encoder_m = np.ndarray((len(values), 2), np.float64, bytearray().join(travel))
    if readings.levels:
        level = np.ndarray(each, np.float64, bytearray().join(levels))
    if readings.labels:
        label = np.array(labels, dtype=np.int64)
    picture = next((one for one in pictures if one is not None), None) if readings.camera else None
    return Senses(presence, encoder_m, level, label, picture)


def sense_decoder(readings: Readings) -> Decode:
    """From a sense payload to its tick and what the cell senses."""
    sensors, largest, most = readings.sensors, readings.labels, readings.camera
    names = list(_places(readings))
    limit = (len(names) - 1) * VALUE + most * readings_codec.PICTURED_BYTES
    read, pack = codec.reader("sense", limit, codec.layout(*names)), struct.Struct(f"<{sensors}d").pack

    def decode(unit: int, payload: bytes) -> tuple[int, Sensed]:  # noqa: ARG001 - all cells alike
        tick, fields = read(payload)
        presence = bytes(codec.booleans("sense", fields["presence"], sensors))
        travel, level, label, picture = b"", b"", 0, None
        if readings.encoders:
            travel = PAIR.pack(*codec.pair("sense", fields["encoder_m"]))
        else:
            codec.nothing("sense", "encoder_m", fields["encoder_m"])
        if readings.levels:
            level = pack(*codec.share_list("sense", fields["level"], sensors))
        if largest:
            label = readings_codec.label("sense", fields["label"], largest)
        if most:
            picture = readings_codec.picture("sense", fields["picture"], most)
        return tick, (presence, travel, level, label, picture)

    return Fixed(_places(readings)).decoder(_short(readings, pack), decode)


def _short(readings: Readings, pack: Callable[..., bytes]) -> Callable[..., Sensed | None]:
    """From the values as they come to what the cell senses; None if they are not what they should be."""
    encoders, levels, largest = readings.encoders, readings.levels, readings.labels

    def sensed(marks: bytes, *values: float) -> Sensed | None:
        presence, label = flags(marks), values[-1] if largest else 0
        numbers = values[:-1] if largest else values
        travel, shares = (finite_pair(*numbers[:2]), numbers[2:]) if encoders else (b"", numbers)
        fits = label <= largest and all(0.0 <= share <= 1.0 for share in shares)
        if presence is None or travel is None or not fits:
            return None
        return presence, travel, pack(*shares) if levels else b"", int(label), None

    if levels or largest:
        return sensed
    return _travelled if encoders else _present


def finite_pair(first: float, second: float) -> bytes | None:
    """Two numbers, packed; None if one is not finite."""
    # Only a finite number minus itself is zero.
    return PAIR.pack(first, second) if first - first == second - second == 0.0 else None


def _travelled(marks: bytes, x: float, y: float) -> Sensed | None:
    presence, travel = flags(marks), finite_pair(x, y)
    return None if presence is None or travel is None else (presence, travel, b"", 0, None)


def _present(marks: bytes) -> Sensed | None:
    presence = flags(marks)
    return None if presence is None else (presence, b"", b"", 0, None)
