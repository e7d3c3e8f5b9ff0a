"""Format of a recording: topics, header and messages.

Described in ``docs/recording.md``. The writer is ``writer.py``, the loader ``reader.py``, its result ``recording.py``.
"""

from __future__ import annotations

from typing import Any, TypedDict

FILE_NAME = "recording.mcap"
PROFILE = "mdms"
FORMAT = 3
"""Increased when a reader of the older format could no longer read the newer."""
READABLE = (2, FORMAT)
"""Formats that the loader reads. Up to 2, wheel speeds that are the drives before were written out."""

TICK = "/tick"
PARCELS = "/parcels"
EVENTS = "/events"
FAULTS = "/faults"
CONTROL = "/control"
REGISTERS = "/registers"
MESSAGES = "/messages"
TRACE = "/trace"
END = "/end"

HEADER_RECORD = "mdms.header"
"""Name of the metadata record at the start of the file; the header is JSON under its key ``json``."""


class RequiredHeader(TypedDict):
    """Header fields of every recording."""

    run: str
    """Name of the run; the RUN of its keys on the bus."""
    title: str
    scene_name: str
    """The bundled name or the file as given."""
    scene: dict[str, Any]
    """The whole scene in canonical form, defaults and overrides included."""
    versions: dict[str, str]
    """Versions of this package, Python and the libraries that decide the bits."""
    period_ns: int
    pitch_m: float
    cells: list[list[int]]
    """``[row, column]`` in row-major order: the order of every array in the recording."""
    positions_m: list[list[float]]
    """Centre of each cell."""
    sensors_m: list[list[float]]
    """Presence sensors relative to the cell's centre."""
    footprints_m: list[list[list[float]]]
    """Corners of each parcel about its centre of mass, in the parcel's axes; those that are fed follow the others."""


class Header(RequiredHeader, total=False):
    """Header of a recording, written once at the start, in JSON's types."""

    own_parcels: int
    """Number of parcels present from the start; later parcels appear with their event ``fed``. Absent: all parcels."""
    exits: list[dict[str, Any]]
    """``name`` and ``corners_m``, in world coordinates, of each exit. Absent: there are none."""


def _object(properties: dict[str, Any], required: list[str]) -> dict[str, Any]:
    return {"type": "object", "properties": properties, "required": required}


def _said(description: str, kind: str | list[str] = "number") -> dict[str, Any]:
    return {"type": kind, "description": description}


_TIME_S = _said("simulated time, s")
_NUMBER = {"type": ["number", "null"]}
_POINT = {"type": "array", "items": {"type": "number"}}

PARCEL_NUMBERS = ("x_m", "y_m", "angle_rad", "velocity_x_m_s", "velocity_y_m_s", "angular_velocity_rad_s")
"""Names of a parcel's six numbers on the topic ``/parcels``, in the order of its state."""

_CELL = {"type": "array", "items": {"type": "integer"}}

SCHEMAS: dict[str, dict[str, Any]] = {
    PARCELS: _object(
        {
            "tick": _said("number of the tick, from 0; the state at its start", "integer"),
            "time_s": _TIME_S,
            "parcels": {
                "type": "array",
                "description": "entries in the order of the scene; names end with the unit; null: not finite",
                "items": _object(dict.fromkeys(PARCEL_NUMBERS, _NUMBER), list(PARCEL_NUMBERS)),
            },
        },
        ["tick", "time_s", "parcels"],
    ),
    EVENTS: _object(
        {
            "time_s": _TIME_S,
            "kind": {"type": "string"},
            "parcel": _said("number of the parcel, from 0", ["integer", "null"]),
            "cells": {"type": "array", "items": _CELL, "description": "[row, column] of each cell"},
            "position_m": {"anyOf": [_POINT, {"type": "null"}]},
            "detail": {},
        },
        ["time_s", "kind"],
    ),
    FAULTS: _object(
        {
            "time_s": _TIME_S,
            "kind": {"type": "string"},
            "tick": _said("tick from which it acts", "integer"),
            "cell": {"anyOf": [_CELL, {"type": "null"}]},
            "phase": {"enum": ["begins", "happens", "ends"]},
            "cells": {"type": "array", "items": _CELL},
            "number": _said("number of the fault, alike in its begin and its end", "integer"),
            "fault": _said("the fault as a scene gives it", "object"),
            "detail": {},
        },
        ["time_s", "kind"],
    ),
    CONTROL: _object({"time_s": _TIME_S, "kind": {"type": "string"}, "detail": {}}, ["time_s", "kind"]),
    END: _object(
        {
            "status": {"type": "string"},
            "ticks": {"type": "integer"},
            "time_s": _TIME_S,
            "digest": _said("chained SHA-256 of the run, hexadecimal", ["string", "null"]),
            "motion_digest": _said(
                "the same of sensor bits, drives and parcel states alone, without the scene",
                ["string", "null"],
            ),
        },
        ["status", "ticks", "time_s", "digest"],
    ),
}
"""JSON Schema of every JSON topic; other keys are allowed and preserved."""

_BINARY = (
    "A message is a MessagePack map (https://msgpack.org). A value with the keyword ndarray is a MessagePack binary: "
    "the elements of an array in row-major order, with dtype in NumPy's notation. With bits = little an element is a "
    "bit: element i is bit i mod 8 of byte i div 8."
)


def _ndarray(dtype: str, shape: list[int], description: str, **more: str) -> dict[str, Any]:
    return {"description": description, "ndarray": {"dtype": dtype, "shape": shape, **more}}


def _arrays(key: str, tick: str, description: str) -> dict[str, Any]:
    """Return the schema of a tick and of arrays by name."""
    return _object(
        {
            "tick": _said(tick, "integer"),
            key: {
                "type": "object",
                "description": description,
                "additionalProperties": {
                    "type": "array",
                    "description": "dtype in NumPy's notation, shape, and the elements as a MessagePack binary",
                    "prefixItems": [
                        {"type": "string"},
                        {"type": "array", "items": {"type": "integer"}, "description": "cells first"},
                        {},
                    ],
                    "minItems": 3,
                    "maxItems": 3,
                },
            },
        },
        ["tick", key],
    )


def binary_schemas(header: Header) -> dict[str, dict[str, Any]]:
    """JSON Schema of every MessagePack topic, for the array and the parcels of a header.

    JSON Schema has no binary type. Readers of the schema find it by the keyword ``ndarray``, which is explained in the
    schema's description and which validators ignore.
    """
    cells, sensors, parcels = len(header["cells"]), len(header["sensors_m"]), len(header["footprints_m"])
    tick = _object(
        {
            "tick": _said("number of the tick, from 0; the state at its start", "integer"),
            "presence": _ndarray(
                "|b1", [cells, sensors], "whether each presence sensor of a cell is covered", bits="little"
            ),
            "drives": _ndarray(
                "<f8",
                [cells, 2],
                "commands of the wheels along x and y from this instant on: m/s, or volts with motors",
            ),
            "wheel_speeds": _ndarray(
                "<f8",
                [cells, 2],
                "surface speeds of the wheels along x and y at this instant, m/s; null: equal to the drives of the "
                "message before",
            ),
            "parcels": _ndarray("<f8", [parcels, 6], "x, y (m), angle (rad), and their rates per second"),
            "end": {"const": True, "description": "in the last message, which has no drives"},
        },
        ["tick"],
    )
    absent = " A key that is absent has the value of the message before."
    return {
        TICK: {"description": _BINARY + absent, **tick},
        REGISTERS: {
            "description": _BINARY,
            **_arrays(
                "registers",
                "number of the tick after which the registers were read",
                "by name of the register",
            ),
        },
        TRACE: {
            "description": _BINARY + " Sides are north, east, south, west.",
            **_arrays(
                "trace",
                "number of the tick",
                "cell: index of each traced cell; stepped: whether its program ran; received, sent: whether the "
                "program read and sent a message on each side; read.NAME, sent.NAME: fields of these messages, by side",
            ),
        },
        MESSAGES: {
            "description": _BINARY
            + " Sides are north, east, south, west. A message sent in tick k is read in tick k + 1, unless a fault "
            "or a bad link keeps it.",
            **_arrays(
                "messages",
                "number of the tick in which the messages were sent",
                "sent: whether a cell sent a message on each side; the others: the messages' fields, by side",
            ),
        },
    }
