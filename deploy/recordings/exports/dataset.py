"""A recording as an xarray dataset, with names, units and coordinates."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bus.lattice import SIDES
from deploy.recordings.exports.extra import library
from deploy.recordings.format import PARCEL_NUMBERS
from deploy.recordings.trace import mask_absent

if TYPE_CHECKING:
    import xarray

    from deploy.recordings.exports.source import RecordingSource

_STATES = {
    "x": ("position of the centre of mass along x", "m"),
    "y": ("position of the centre of mass along y", "m"),
    "angle": ("orientation", "rad"),
    "velocity_x": ("velocity along x", "m s-1"),
    "velocity_y": ("velocity along y", "m s-1"),
    "angular_velocity": ("angular velocity", "rad s-1"),
}
"""Variable of each column of a parcel's state, with long name and units."""

assert len(_STATES) == len(PARCEL_NUMBERS)


def to_xarray(recording: RecordingSource) -> xarray.Dataset:
    """Return all that a recording holds as a dataset.

    Dimensions are ``time``, ``parcel``, ``cell``, ``wheel`` (``x``, ``y``), ``sensor``, ``corner``, and
    ``register_time``, ``message_time`` and ``trace_time`` with recorded registers, messages and the trace of messages,
    by ``side`` (north, east, south, west). Events, faults and commands are JSON texts, as they were recorded.

    Raises:
        InputError: xarray is not installed.
    """
    xarray_ = library("xarray", "recording.to_xarray()")
    return xarray_.Dataset(
        data_vars={
            **_parcels(recording),
            **_cells(recording),
            **_registers(recording),
            **_messages(recording),
            **_records(recording),
        },
        coords=_coordinates(recording),
        attrs={
            "title": recording.header["title"],
            "source": "MDMS emulator",
            "run": recording.header["run"],
            "scene": recording.header["scene_name"],
            "status": recording.status or "cut",
            "digest": recording.digest or "",
            "motion_digest": recording.motion_digest or "",
            "period_ns": np.int64(recording.header["period_ns"]),
            "pitch_m": recording.header["pitch_m"],
        },
    )


def present(recording: RecordingSource) -> NDArray[np.bool_]:
    """Return whether each parcel is there, neither waiting to be fed nor gone through an exit, ``(T, m)``."""
    own = recording.header.get("own_parcels", recording.parcels.shape[1])
    shown = mask_absent(np.zeros_like(recording.parcels), recording.time_s, own, recording.events)
    return ~np.isnan(shown[:, :, 0])


def _about(long_name: str, units: str = "1") -> dict[str, str]:
    return {"long_name": long_name, "units": units}


def _coordinates(recording: RecordingSource) -> dict[str, Any]:
    header = recording.header
    cells = np.array(header["cells"], dtype=np.int64).reshape(-1, 2)
    positions = np.array(header["positions_m"], dtype=np.float64).reshape(-1, 2)
    sides = len(recording.message_tick) or len(recording.trace_tick)
    return {
        **({"side": ("side", list(SIDES), {"long_name": "side of the cell"})} if sides else {}),
        "time": ("time", recording.time_s, _about("simulated time", "s")),
        "time_ns": ("time", recording.time_ns, _about("simulated time", "ns")),
        "tick": ("time", recording.tick, _about("number of the tick that begins")),
        "parcel": ("parcel", np.arange(recording.parcels.shape[1]), _about("number of the parcel")),
        "cell": ("cell", np.arange(len(cells)), _about("number of the cell, row-major")),
        "row": ("cell", cells[:, 0], _about("row of the cell, from the bottom")),
        "column": ("cell", cells[:, 1], _about("column of the cell, from the left")),
        "cell_x": ("cell", positions[:, 0], _about("centre of the cell along x", "m")),
        "cell_y": ("cell", positions[:, 1], _about("centre of the cell along y", "m")),
        "wheel": ("wheel", ["x", "y"], {"long_name": "direction in which the wheel moves parcels"}),
    }


def _parcels(recording: RecordingSource) -> dict[str, Any]:
    found: dict[str, Any] = {
        name: (("time", "parcel"), recording.parcels[:, :, column], _about(*words))
        for column, (name, words) in enumerate(_STATES.items())
    }
    found["present"] = (
        ("time", "parcel"),
        present(recording),
        {"long_name": "whether the parcel is there: fed, and not gone through an exit"},
    )
    footprints = recording.header["footprints_m"]
    corners = np.full((len(footprints), max(map(len, footprints), default=0), 2), np.nan)
    for parcel, footprint in enumerate(footprints):
        corners[parcel, : len(footprint)] = footprint
    found["footprint"] = (
        ("parcel", "corner", "axis"),
        corners,
        _about("corners about the centre of mass, in the parcel's axes x and y", "m"),
    )
    return found


def _cells(recording: RecordingSource) -> dict[str, Any]:
    effects: dict[str, Any] = recording.header["scene"].get("effects") or {}
    unit = "V" if effects.get("motors") is not None else "m s-1"
    sensors = np.array(recording.header["sensors_m"], dtype=np.float64).reshape(-1, 2)
    return {
        "presence": (
            ("time", "cell", "sensor"),
            recording.held_presence.all(),
            {"long_name": "whether the presence sensor is covered"},
        ),
        "drives": (
            ("time", "cell", "wheel"),
            recording.held_drives.all(),
            _about("command that acts from the instant on", unit),
        ),
        "wheel_speed": (
            ("time", "cell", "wheel"),
            recording.held_wheel_speeds.all(),
            _about("surface speed of the wheel", "m s-1"),
        ),
        "sensor_position": (
            ("sensor", "axis"),
            sensors,
            _about("sensor relative to the cell's centre, x and y", "m"),
        ),
    }


def _registers(recording: RecordingSource) -> dict[str, Any]:
    about = "tick after which it was read"
    return _by_tick("register", ("cell",), about, recording.register_tick, recording.registers)


def _messages(recording: RecordingSource) -> dict[str, Any]:
    """Return recorded messages and the trace of messages, each with the ticks of its own."""
    sides = ("cell", "side")
    sent = _by_tick("message", sides, "tick in which it was sent", recording.message_tick, recording.messages)
    numbers = {name: values for name, values in recording.trace.items() if values.ndim == 2}
    by_side = {name: values for name, values in recording.trace.items() if name not in numbers}
    about = "tick of the program's step"
    traced = _by_tick("trace", ("traced_cell",), about, recording.trace_tick, numbers)
    return sent | traced | _by_tick("trace", ("traced_cell", "side"), about, recording.trace_tick, by_side)


def _by_tick(
    kind: str,
    dimensions: tuple[str, ...],
    about: str,
    ticks: NDArray[np.int64],
    arrays: Mapping[str, NDArray[Any]],
) -> dict[str, Any]:
    """Return variables that are recorded in some ticks, and these ticks; none where nothing was recorded.

    Args:
        kind: Prefix of the names.
        dimensions: After that of the ticks.
        about: What a tick means.
        ticks: ``(K,)``.
        arrays: ``(K, ...)`` by name.
    """
    if not len(ticks):
        return {}
    found: dict[str, Any] = {f"{kind}_tick": (f"{kind}_time", ticks, _about(about))}
    for name, values in arrays.items():
        safe = name.replace("/", "_")  # which names no variable of a netCDF file
        more = [f"{safe}_{axis}" for axis in range(values.ndim - 1 - len(dimensions))]
        found[f"{kind} {safe}"] = ((f"{kind}_time", *dimensions, *more), values, {"long_name": name})
    return found


def _records(recording: RecordingSource) -> dict[str, Any]:
    kinds = {"event": recording.events, "fault": recording.faults, "command": recording.control}
    header = json.dumps(recording.header)  # a variable, because attributes of a file hold 64 kB
    found: dict[str, Any] = {"header": ((), header, {"long_name": "header of the recording, JSON"})}
    return found | {
        f"{name}s": (
            name,
            np.array([json.dumps(record) for record in records], dtype=object),
            {"long_name": f"recorded {name}s, JSON"},
        )
        for name, records in kinds.items()
        if records
    }
