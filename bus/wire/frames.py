"""Bus data types: frames, encoded differently by each wire format, and records, encoded alike by all."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final, Literal, NamedTuple, cast, final

from bus.errors import BusError, WireError
from bus.sensors import CameraFrame, Labels, SensorSchema
from bus.wire.msgpack_codec import TICK_LIMIT, VERSION, Mask, Message, Values, layout, packer, reader

TEXT_LIMIT: Final = 4096
"""Longest text in a control record or report, characters."""
COUNTER_LIMIT: Final = 64
"""Most numbers in a report's counters, and longest name of one, characters."""


class SenseFrame(NamedTuple):
    """Sensor readings at the start of a tick: presence ``(n, sensors)``, encoder travel ``(n, 2)`` m or None.

    ``level`` is ``(n, sensors)`` in [0, 1], None unless sensors are analogue. ``label`` is ``(n,)``, None without
    scanners. ``picture`` is a camera frame, None in ticks without one.
    """

    tick: int
    presence: Mask
    encoder_m: Values | None
    level: Values | None = None
    label: Labels | None = None
    picture: CameraFrame | None = None


class DriveFrame(NamedTuple):
    """Wheel commands for a tick: ``(n, 2)`` float64, m/s or volts."""

    tick: int
    drive: Values


class LinkFrame(NamedTuple):
    """Messages of a tick: ``sent`` ``(m,)`` marks links with a message; ``message`` ``(m,)`` is zero elsewhere."""

    tick: int
    sent: Mask
    message: Message


@final
@dataclass(frozen=True, slots=True)
class Control:
    """Control record of the plant to all shards; ``cells`` are ``(row, column)``.

    ``snapshot`` requests a snapshot before ``tick``. ``show`` requests the registers after the last tick, ``tick``,
    once more, for observers.
    """

    kind: Literal["start", "snapshot", "show", "lost", "rejoin_prepare", "rejoin_commit", "fault", "stop"]
    tick: int
    cells: tuple[tuple[int, int], ...] = ()
    detail: str = ""


@final
@dataclass(frozen=True, slots=True)
class Report:
    """Report of a shard to the plant.

    Kinds: cells ``failed``; a program is ``hung``; rejoining cells can be sent to (``rejoin_ready``); the shard
    is still ``busy`` with ``tick``; a debugger has ``held`` a cell in ``tick``; final ``counters``.
    """

    kind: Literal["failed", "hung", "rejoin_ready", "busy", "held", "counters"]
    tick: int
    cells: tuple[tuple[int, int], ...] = ()
    detail: str = ""
    counts: tuple[int, int, int, int] = (0, 0, 0, 0)
    """Payloads sent, delivered, lost, late."""
    counters: tuple[tuple[str, int], ...] = ()
    """Counters of the cells, by name."""


def check_sense(frame: SenseFrame, readings: SensorSchema, cells: int) -> None:
    """Check that a frame of ``cells`` cells has the fields of the sensor schema, and no others.

    Raises:
        BusError: It has not.
    """
    each = (cells, readings.sensors)
    expected = {
        "presence": each,
        "encoder travel": (cells, 2) if readings.encoders else None,
        "levels": each if readings.levels else None,
        "labels": (cells,) if readings.labels else None,
    }
    arrays = {
        "presence": frame.presence,
        "encoder travel": frame.encoder_m,
        "levels": frame.level,
        "labels": frame.label,
    }
    agreed = {name: shape for name, shape in expected.items() if shape is not None}
    found = {name: array.shape for name, array in arrays.items() if array is not None}
    if frame.picture is not None and not readings.camera:
        found["a picture"] = frame.picture.pose.shape
    if found != agreed:
        raise BusError(f"sense frame of tick {frame.tick}: must have {agreed}, has {found}")


def encode_control(control: Control) -> bytes:
    """The payload of a control record."""
    return packer()(
        {
            "v": VERSION,
            "tick": control.tick,
            "kind": control.kind,
            "cells": control.cells,
            "detail": control.detail[:TEXT_LIMIT],
        }
    )


_CONTROLS: Final = ("start", "snapshot", "show", "lost", "rejoin_prepare", "rejoin_commit", "fault", "stop")
_REPORTS: Final = ("failed", "hung", "rejoin_ready", "busy", "held", "counters")
_CONTROL: Final = layout("kind", "cells", "detail")
_REPORT: Final = layout("kind", "cells", "detail", "counts", "counters")


def decode_control(payload: bytes, cells: int) -> Control:
    """A control record that names at most ``cells`` cells.

    Raises:
        WireError: Anything else.
    """
    tick, fields = reader("control", _text_limit(cells), _CONTROL)(payload)
    kind = fields["kind"]
    if kind not in _CONTROLS:
        raise WireError("control", "kind", f"must be one of {', '.join(_CONTROLS)}")
    return Control(kind, tick, _places("control", fields["cells"], cells), _text("control", fields["detail"]))


def encode_report(report: Report) -> bytes:
    """The payload of a report."""
    return packer()(
        {
            "v": VERSION,
            "tick": report.tick,
            "kind": report.kind,
            "cells": report.cells,
            "detail": report.detail[:TEXT_LIMIT],
            "counts": report.counts,
            "counters": report.counters,
        },
    )


def decode_report(payload: bytes, cells: int) -> Report:
    """A report that names at most ``cells`` cells.

    Raises:
        WireError: Anything else.
    """
    limit = _text_limit(cells) + COUNTER_LIMIT * (4 * COUNTER_LIMIT + 16)
    tick, fields = reader("report", limit, _REPORT)(payload)
    kind = fields["kind"]
    if kind not in _REPORTS:
        raise WireError("report", "kind", f"must be one of {', '.join(_REPORTS)}")
    counts = fields["counts"]
    if (
        type(counts) is not list
        or len(cast("list[object]", counts)) != 4
        or not all(_is_count(c) for c in cast("list[object]", counts))
    ):
        raise WireError("report", "type", "counts must be four integers")
    a, b, c, d = cast("list[int]", counts)
    places = _places("report", fields["cells"], cells)
    text, counters = _text("report", fields["detail"]), _counters(fields["counters"])
    return Report(kind, tick, places, text, (a, b, c, d), counters)


def _is_count(value: object) -> bool:
    return type(value) is int and 0 <= value < TICK_LIMIT


def _counters(value: object) -> tuple[tuple[str, int], ...]:
    if type(value) is list and len(cast("list[object]", value)) <= COUNTER_LIMIT:
        pairs = cast("list[list[Any]]", value)
        if all(type(pair) is list and len(pair) == 2 for pair in pairs) and all(
            type(name) is str and len(name) <= COUNTER_LIMIT and _is_count(number) for name, number in pairs
        ):
            return tuple((name, number) for name, number in pairs)
    raise WireError("report", "type", f"counters must be a list of at most {COUNTER_LIMIT} names and numbers")


def _text_limit(cells: int) -> int:
    return 4 * TEXT_LIMIT + 11 * cells + 128


def _text(kind: str, value: object) -> str:
    if type(value) is not str or len(value) > TEXT_LIMIT:
        raise WireError(kind, "type", f"detail must be text of at most {TEXT_LIMIT} characters")
    return value


def _places(kind: str, value: object, most: int) -> tuple[tuple[int, int], ...]:
    if type(value) is not list or len(cast("list[object]", value)) > most:
        raise WireError(kind, "type", f"cells must be a list of at most {most} pairs")
    return tuple(_place(kind, item) for item in cast("Iterable[object]", value))


def _place(kind: str, value: object) -> tuple[int, int]:
    if type(value) is list and len(cast("list[object]", value)) == 2:
        row, column = cast("list[object]", value)
        if type(row) is int and type(column) is int:
            return row, column
    raise WireError(kind, "type", "a cell must be a list of its row and column")
