"""Format of a recording: topics, header and messages.

Described in ``docs/recording.md``. The writer is ``writer.py``, the loader ``reader.py``.
"""

from __future__ import annotations

from typing import Any, TypedDict

FILE_NAME = "recording.mcap"
PROFILE = "mdms"
FORMAT = 2
"""Increased when a reader of the older format could no longer read the newer."""

TICK = "/tick"
PARCELS = "/parcels"
EVENTS = "/events"
FAULTS = "/faults"
CONTROL = "/control"
REGISTERS = "/registers"
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


_NUMBER = {"type": ["number", "null"]}
_POINT = {"type": "array", "items": {"type": "number"}}

PARCEL_NUMBERS = ("x_m", "y_m", "angle_rad", "velocity_x_m_s", "velocity_y_m_s", "angular_velocity_rad_s")
"""Names of a parcel's six numbers on the topic ``/parcels``, in the order of its state."""

_CELL = {"type": "array", "items": {"type": "integer"}}

SCHEMAS: dict[str, dict[str, Any]] = {
    PARCELS: _object(
        {
            "tick": {"type": "integer"},
            "time_s": {"type": "number"},
            "parcels": {
                "type": "array",
                "items": _object(dict.fromkeys(PARCEL_NUMBERS, _NUMBER), list(PARCEL_NUMBERS)),
            },
        },
        ["tick", "time_s", "parcels"],
    ),
    EVENTS: _object(
        {
            "time_s": {"type": "number"},
            "kind": {"type": "string"},
            "parcel": {"type": ["integer", "null"]},
            "cells": {"type": "array", "items": _CELL},
            "position_m": {"anyOf": [_POINT, {"type": "null"}]},
            "detail": {},
        },
        ["time_s", "kind"],
    ),
    FAULTS: _object(
        {
            "time_s": {"type": "number"},
            "kind": {"type": "string"},
            "cell": {"anyOf": [_CELL, {"type": "null"}]},
            "phase": {"enum": ["begins", "happens", "ends"]},
            "cells": {"type": "array", "items": _CELL},
            "number": {"type": "integer"},
            "detail": {},
        },
        ["time_s", "kind"],
    ),
    CONTROL: _object(
        {"time_s": {"type": "number"}, "kind": {"type": "string"}, "detail": {}}, ["time_s", "kind"]
    ),
    END: _object(
        {
            "status": {"type": "string"},
            "ticks": {"type": "integer"},
            "time_s": {"type": "number"},
            "digest": {"type": ["string", "null"]},
        },
        ["status", "ticks", "time_s", "digest"],
    ),
}
"""JSON Schema of every JSON topic; other keys are allowed and preserved."""
